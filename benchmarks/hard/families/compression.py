"""Compression: a sheet that is pushed buckles in its plane, or it does not."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from benchmarks.hard.families.contrasts import AUTO, FEW, WHOLE
from benchmarks.hard.measurement import Measurement
from benchmarks.hard.pictures import draw_compression
from benchmarks.hard.row import Bound, Family, Figures, Row, Setting
from wovenfab.case import Case, Rectangle
from wovenfab.stepping.step import Step

#: Yarns along the axis: each is Euler's hinged column.
ALONG = Setting("compression")
#: Yarns across the corners, as in all other tests.
BIAS = Setting(
    "bonded-1x3",
    (
        AUTO,
        "discretisation.mesh=fibres",
        "discretisation.degree=3",
        "discretisation.mesh_size=100 mm",
        "program.to=-40 mm",
        "program.steps=8",
        "solver.stability=stop",
    ),
)


def euler(case: Case) -> float:
    """Return the load (N) at which extensible hinged yarns along the axis buckle.

    A straight yarn of stretch 1 - u carries K_e u for each width; w ~ sin(pi x / L) costs
    K_b w''²/(1-u)² + S w'²/(1-u)² - K_e u w'²/(1-u), where S is the shear stiffness in series
    with that of the cross yarns, which turn with the section if the yarns stretch.
    """
    sheet, (stretch, shear, bending) = case.sheet, stiffnesses(case)
    assert isinstance(sheet, Rectangle)
    wave = pi / sheet.length
    section = stretch * sheet.width**2 / 12 * wave**2
    resistance = bending * wave**2 + 1 / (1 / shear + 1 / section)
    u = brentq(lambda u: stretch * u * (1 - u) - resistance, 0.0, 0.1, xtol=1e-18)
    return float(stretch * u * sheet.width)


def stiffnesses(case: Case) -> tuple[float, float, float]:
    """Return K_e (N/m), K_s (N/m) and K_b (N m) of the first family."""
    values: dict[str, Any] = {term.name: term.values["stiffness"] for term in case.scene}
    e, s, b = (float(np.ravel(values[n])[0]) for n in ("stretch", "shear", "bending"))
    return e, s, b


def pushed(setting: Setting) -> Figures:
    """Run; return losses of stability and the lowest eigenvalue at each step; serial."""
    measurement = Measurement(setting)
    softest: list[float] = []

    def observe(step: Step) -> None:
        softest.append(softness(measurement))

    measurement.run(observe)
    losses = [s.loss for s in measurement.steps if s.loss] + (
        [measurement.loss] if measurement.loss else []
    )
    negatives = [s.negatives for s in measurement.steps]
    figures = measurement.figures(
        losses=float(len(losses)),
        negative_eigenvalues=float(max(negatives)),
        softest_over_rest=min(softest) / softest[0],
    )
    series = {**figures.series, "softest": softest, "negatives": negatives}
    if losses:
        load = abs(losses[0].reactions["right"][0])
        figures = figures.with_checks(
            error_of_the_load=abs(load / euler(setting.case) - 1),
            negative_at_the_saddle=float(losses[0].negatives),
        )
        series |= {"mode": shape(measurement, losses[0].mode), "load": load}
    return Figures(**{**vars(figures), "series": series})


def straight(setting: Setting) -> Figures:
    """Run, and compare the force with that of yarns that are kept straight; serial."""
    figures, sheet = pushed(setting), setting.case.sheet
    assert isinstance(sheet, Rectangle)
    stretch, _, _ = stiffnesses(setting.case)
    exact = stretch * figures.series["displacement"][-1] / sheet.length * sheet.width
    return figures.with_checks(off_the_straight_force=abs(figures.series["force"][-1] / exact - 1))


def softness(measurement: Measurement) -> float:
    """Return the lowest eigenvalue (N/m) of the tangent in the present state; serial."""
    own = measurement.equilibrium.spectrum.mode()
    matrix = measurement.equilibrium.tangent()
    mode, image = matrix.createVecs()
    mode.array_w[:] = own
    matrix.mult(mode, image)
    value = mode.dot(image) / mode.dot(mode)
    mode.destroy()
    image.destroy()
    return float(value)


def shape(measurement: Measurement, mode: NDArray[np.float64]) -> dict[str, Any]:
    """Return a mode of one placement at the corners of the cells; serial."""
    corners = measurement.model.placements.blocks[:, :3, 0]
    vertices, cells = np.unique(corners, return_inverse=True)
    return {
        "points": measurement.model.placements.positions[vertices].tolist(),
        "cells": cells.reshape(-1, 3).tolist(),
        "displacement": mode.reshape(-1, 2)[vertices].tolist(),
    }


LOAD = Bound("error of the load", most=2e-3)
ONE = (Bound("losses", least=1, most=1), Bound("negative at the saddle", least=1, most=1))
MINIMA = Bound("negative eigenvalues", most=0)
QUICK = ("discretisation.mesh_size=150 mm", "discretisation.corner_size=150 mm")

FAMILY = Family(
    number=6,
    title="Compression",
    text=(
        "The 1:3 sheet with yarns at ±45°, pushed by 40 mm, does *not* buckle in its plane, and "
        "must not be said to: it gives way in shear, the lowest eigenvalue of its tangent "
        "stays positive, and that is what the first row checks. With yarns along the axis it "
        "buckles at 0.025 mm; Euler's load of the extensible hinged yarn, with the shear "
        "stiffness in series with the turning of the section, is the measure. `stop` ends there "
        "with the load and the mode, `follow` takes the branch from a seeded mode and every "
        "accepted step is a minimum, `ignore` stays on the straight sheet, which is a saddle, and "
        "says so. Sheets here are plane: buckling out of the plane is not simulated."
    ),
    rows=(
        Row(
            name="compression-bias",
            title="bonded 1:3 at ±45° pushed by 40 mm: no loss of stability",
            hard="a loss that is no loss must not be reported",
            remedy="inertia of the factor at each solution",
            setting=BIAS,
            measure=pushed,
            bounds=(
                FEW,
                WHOLE,
                MINIMA,
                Bound("losses", most=0),
                Bound("softest over rest", least=0.1),
            ),
            quick=(*QUICK, "program.steps=4"),
        ),
        Row(
            name="compression-stop",
            title="yarns along the axis, `stability: stop`",
            hard="the straight sheet stays an equilibrium for ever",
            remedy="inertia of the factor, bisection",
            setting=ALONG.but("solver.stability=stop"),
            measure=pushed,
            bounds=(LOAD, MINIMA, *ONE),
            quick=QUICK,
            stops="the sheet loses its stability",
        ),
        Row(
            name="compression-follow",
            title="yarns along the axis pushed by 40 mm, `stability: follow`",
            hard="1600 times the critical displacement; the force all but stays as it is",
            remedy="the mode with the lowest potential, tangent shifted until it is definite",
            setting=ALONG.but("solver.stability=follow"),
            measure=pushed,
            bounds=(LOAD, MINIMA, *ONE),
            quick=(*QUICK, "program.to=-5 mm", "program.steps=2"),
        ),
        Row(
            name="compression-ignore",
            title="yarns along the axis pushed by 0.2 mm, `stability: ignore`",
            hard="beyond the critical load the solution is a saddle",
            remedy="its negative eigenvalues are reported with each step",
            setting=ALONG.but("solver.stability=ignore", "program.to=-0.2 mm"),
            measure=straight,
            bounds=(
                FEW,
                WHOLE,
                Bound("negative eigenvalues", least=1),
                Bound("off the straight force", most=1e-6),
            ),
            quick=(*QUICK, "program.steps=2"),
        ),
    ),
    draw=draw_compression,
)
