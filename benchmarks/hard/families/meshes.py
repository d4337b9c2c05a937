"""Meshes of poor quality, and the penalty on them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from mpi4py import MPI

from benchmarks.hard.coercivity import Coercivity
from benchmarks.hard.families.contrasts import AUTO, FEW, QUICK, WHOLE, finer
from benchmarks.hard.grids import Grid, crossed, write
from benchmarks.hard.measurement import Measurement, last_force, measured
from benchmarks.hard.pictures import draw_meshes
from benchmarks.hard.row import Bound, Family, Figures, Row, Setting, together
from wovenfab.case import Rectangle
from wovenfab.stepping.step import Step

STEPS = ("program.to=40 mm", "program.steps=4", AUTO, "discretisation.degree=3")
PULL = Setting("bonded-1x3", STEPS)
#: Size of the reference's cells, and of those at the singular corners, over that of the cells.
COARSER, FINEST = 2.0, 1 / 125
UNSTRUCTURED = "discretisation.mesh=unstructured"
#: P3 sees singular corners within 5 % only from this size on; at 100 mm it is up to 18 %.
SMALL = ("discretisation.mesh_size=50 mm", "program.steps=2")


def reference(setting: Setting) -> float:
    """Return the force (N) on P4 that resolves the singular corners, whatever the fibres."""
    size = setting.case.discretisation.mesh_size
    assert size is not None
    return last_force(
        setting.but(
            UNSTRUCTURED,
            "discretisation.degree=4",
            f"discretisation.mesh_size={COARSER * size}",
            f"discretisation.corner_size={FINEST * size}",
        )
    )


def refined(setting: Setting) -> float:
    """Return the force (N) on the same mesh with cells of half the size."""
    return last_force(finer(setting))


def compared(exact: Callable[[Setting], float], setting: Setting) -> Figures:
    """Run and compare the force with another mesh's."""
    figures = measured(setting)
    force = figures.series["force"][-1]
    return figures.with_checks(difference=abs(force / exact(setting) - 1))


def _own(path: Path) -> tuple[str, ...]:
    """Return the changes that put a mesh file in place of the rectangle."""
    gone = ("sheet.shape=null", "sheet.length=null", "sheet.width=null")
    return (
        *gone,
        "discretisation.mesh=null",
        "discretisation.mesh_size=null",
        f"sheet.file={path}",
    )


def _grid(setting: Setting, angle: float = 45.0) -> Grid:
    sheet, size = setting.case.sheet, setting.case.discretisation.mesh_size
    assert isinstance(sheet, Rectangle) and size is not None
    return crossed(sheet.length, sheet.width, size, angle)


def slivers(setting: Setting) -> Figures:
    """Run on a mesh with angles of 1°, and compare with a good one."""
    grid = _grid(setting, 1.0)
    with TemporaryDirectory() as folder:
        figures = measured(setting.but(*_own(write(grid, Path(folder) / "slivers.msh"))))
    series = {**figures.series, "points": grid.points.tolist(), "cells": grid.cells.tolist()}
    return Figures(**{**vars(figures), "series": series}).with_checks(
        difference=abs(figures.series["force"][-1] / reference(setting) - 1),
        least_angle=grid.least_angle,
    )


def shuffled(setting: Setting) -> Figures:
    """Run on a mesh file in order and on the same one with all numbers shuffled."""
    grid, parts = _grid(setting), []
    with TemporaryDirectory() as folder:
        for seed in (None, 1, 2):
            path = write(grid, Path(folder) / f"mesh-{seed}.msh", seed)
            parts.append(measured(setting.but(*_own(path))))
    forces = np.array([figures.series["force"] for figures in parts])
    return together(parts, parts[0].series).with_checks(
        difference=float(np.abs(forces - forces[0]).max() / np.abs(forces).max())
    )


def on_ranks(setting: Setting) -> Figures:
    """Run on 1, 2, … ranks, as many as there are, and compare; collective."""
    world, parts = MPI.COMM_WORLD, []
    for count in range(1, world.size + 1):
        some = world.Split(world.rank >= count)
        if world.rank < count:
            parts.append(Measurement(setting, some).run().figures())
        world.barrier()
    if world.rank:
        return parts[-1]
    forces = np.array([figures.series["force"] for figures in parts])
    return together(parts, parts[0].series).with_checks(
        difference=float(np.abs(forces - forces[0]).max() / np.abs(forces).max()),
        ranks=float(world.size),
    )


def coercive(setting: Setting) -> Figures:
    """Run, with the smallest eigenvalue of the facet-cell form at each step; serial."""
    parts = []
    curves: dict[str, list[float]] = {}
    for mesh in ("crossed", "unstructured"):
        measurement = Measurement(setting.but(f"discretisation.mesh={mesh}"))
        form = Coercivity(measurement.model)
        values = curves.setdefault(mesh, [])
        parts.append(measurement.run(partial(_note, form, values)).figures())
    least = min(min(values) for values in curves.values())
    series = {**curves, "displacement": parts[0].series["displacement"]}
    return together(parts, series).with_checks(least_eigenvalue=least)


def _note(form: Coercivity, values: list[float], step: Step) -> None:
    values.append(form.least())


def _coercive(degree: int) -> Row:
    return Row(
        name=f"mesh-coercive-p{degree}",
        title=f"penalty auto, P{degree}, bonded 1:2 to 100 mm",
        hard="proven for the linear problem; the sheet shears by 60°",
        remedy="local penalty, twice the proven one",
        setting=Setting(
            "bonded-1x3",
            (
                AUTO, f"discretisation.degree={degree}", "sheet.length=600 mm",
                "program.to=100 mm", "program.steps=5", "discretisation.mesh_size=100 mm",
            ),
        ),
        measure=coercive,
        bounds=(FEW, WHOLE, Bound("least eigenvalue", least=0.1)),
        quick=("discretisation.mesh_size=150 mm", "program.steps=2"),
    )  # fmt: skip


def _turned(degrees: int) -> Row:
    return Row(
        name=f"mesh-{degrees}deg",
        title=f"fibres at {degrees}° to the lines of the grid, P3",
        hard="no edge of the mesh runs along a fibre, so that every kink is cut",
        remedy="facet terms weighted by (D·n)²",
        setting=PULL.but(f"sheet.fibres=[{45 + degrees} deg, {degrees - 45} deg]"),
        measure=partial(compared, reference),
        bounds=(FEW, WHOLE, Bound("difference", most=0.02)),
        quick=SMALL,
        quick_bounds=(Bound("difference", most=0.06),),
    )


FAMILY = Family(
    number=7,
    title="Meshes",
    text=(
        "Bonded 1:3 at 40 mm. The reference is an unstructured mesh of P4 graded to 0.2 mm at the "
        "singular corners; differences are those of the force and belong to the coarse corners. "
        "The smallest eigenvalue is that of the bending form (cells, consistency and penalty, "
        "linearised about the deformed sheet) against the same without the consistency terms: "
        "positive means coercive; 1 - 1/sqrt(2) = 0.29 is proven at rest."
    ),
    rows=(
        Row(
            name="mesh-unstructured",
            title="unstructured, cells of 25 mm, P3",
            hard="no structure, no symmetry",
            remedy="local penalty",
            setting=PULL.but(UNSTRUCTURED),
            measure=partial(compared, reference),
            bounds=(FEW, WHOLE, Bound("difference", most=0.02)),
            quick=SMALL,
            quick_bounds=(Bound("difference", most=0.06),),
        ),
        _turned(7),
        _turned(23),
        Row(
            name="mesh-slivers",
            title="triangles with angles of 1°, P3",
            hard="cells 115 times as long as high, neighbours of very unequal area",
            remedy="local penalty from both areas",
            setting=PULL,
            measure=slivers,
            bounds=(FEW, WHOLE, Bound("difference", most=0.02), Bound("least angle", most=1.001)),
            quick=SMALL,
            quick_bounds=(Bound("difference", most=0.06),),
        ),
        Row(
            name="mesh-hole",
            title="circular hole, mesh along the fibres, P3, against cells of half the size",
            hard="curved free edge, stress concentration",
            remedy="mesh along the fibres",
            setting=PULL.but(*_own(Path("../meshes/hole.geo")), "discretisation.mesh_size=30 mm"),
            measure=partial(compared, refined),
            bounds=(FEW, WHOLE, Bound("difference", most=0.02)),
            quick=("discretisation.mesh_size=120 mm", "program.steps=2"),
            quick_bounds=(Bound("difference", most=0.1),),
        ),
        Row(
            name="mesh-shuffled",
            title="a mesh file in order and twice with all numbers shuffled, P3",
            hard="nodes, elements and corners in random order with gaps",
            remedy="none needed",
            setting=PULL,
            measure=shuffled,
            bounds=(FEW, WHOLE, Bound("difference", most=1e-9)),
            quick=QUICK,
        ),
        Row(
            name="mesh-ranks",
            title="1, 2, 3 and 4 ranks, slip friction",
            hard="facets, history and reactions across ranks",
            remedy="none needed",
            setting=Setting(
                "bias-1x3",
                (
                    "program.amplitudes=[40 mm]",
                    "time.steps_per_cycle=20",
                    "discretisation.degree=2",
                ),
            ),
            measure=on_ranks,
            bounds=(FEW, WHOLE, Bound("difference", most=1e-8), Bound("ranks", least=4)),
            quick=("discretisation.mesh_size=150 mm", "time.steps_per_cycle=4"),
            quick_bounds=(Bound("ranks", least=1),),
            ranks=4,
        ),
        _coercive(2),
        _coercive(3),
        _coercive(4),
        Row(
            name="mesh-penalty",
            title="penalty: 0.3 where 1.5 is proven, P2",
            hard="a user's number that makes bending unbounded from below",
            remedy="inertia of the sheet at rest; the cause is named",
            setting=Setting("bonded-1x3", ("discretisation.penalty=0.3", *QUICK)),
            measure=measured,
            bounds=(Bound("steps", most=0),),
            stops="discretisation.penalty = 0.3 is too small",
        ),
    ),
    draw=draw_meshes,
)
