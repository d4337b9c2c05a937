"""Tabulated laws: the curve through the rows, its energy, and what is beyond the table."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from math import cos, pi, sin
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from scipy.interpolate import PchipInterpolator

import wovenfab
from tests import scenes
from tests.verification.test_conjugate_force import picture_frame
from wovenfab.forms.kinematics import Point
from wovenfab.forms.table import TABLE, ForceTable, least_slope
from wovenfab.model.assembly import compile_expressions
from wovenfab.model.constraints import Grip, Held
from wovenfab.model.model import build_model
from wovenfab.model.spline import LEAST_SLOPE, pieces_of

#: Uneven rows: a toe, a steep part, nearly a plateau, and a steep end.
ROWS = ForceTable((0.02, 0.05, 0.3, 0.5, 0.6), (0.1, 2.0, 2.5, 2.500001, 4.0))
EVEN = ForceTable(tuple(np.linspace(0, 0.6, 6)), tuple(np.tan(np.linspace(0, 0.6, 6))))
SHEET = scenes.sheet(0.2, 0.1, 0.1)
Curve = Callable[[float], tuple[float, float, float]]


@cache
def curve(name: str, table: ForceTable, rest: float = 0.0) -> Curve:
    """Return energy, force and stiffness of a law as functions of its strain.

    Args:
        name: Of the effect.
        table: Its table.
        rest: Shear angle between the families at rest, rad.
    """
    first = scenes.effect(f"{name}:table")
    mesh = SHEET.mesh
    strain = fem.Constant(mesh, 0.0)
    fibres = [fem.Constant(mesh, d) for d in ((1.0, 0.0), (sin(rest), cos(rest)))]
    start = fem.Constant(mesh, rest)
    at = ufl.variable(strain)
    if first.table.per_family:  # the first family alone is stretched
        f = (fibres[0] * (1 + at), fibres[1])
    else:  # the second family turns towards the first
        f = (fibres[0], ufl.as_vector([ufl.sin(start + at), ufl.cos(start + at)]))
    pieces, scale = fem.Constant(mesh, pieces_of(table)), 1.0
    pair = first.table.per_family
    values = {
        TABLE: (pieces, pieces) if pair else pieces,
        "scale": (scale, scale) if pair else scale,
    }
    energy = first.stored(Point(f, None, None, tuple(fibres)), values)
    orders = [energy, ufl.diff(energy, at), ufl.diff(ufl.diff(energy, at), at)]
    compiled = compile_expressions(orders, np.array([[0.3, 0.3]]))

    def evaluate(value: float) -> tuple[float, float, float]:
        strain.value = value
        return tuple(float(e.eval(mesh, np.array([0], dtype=np.int32))[0, 0]) for e in compiled)

    return evaluate


@pytest.fixture(scope="module", params=["shear", "stretch"])
def law(request: pytest.FixtureRequest) -> Curve:
    """Return either law with the uneven table."""
    return curve(request.param, ROWS)


def signs(law: Curve) -> tuple[int, ...]:
    """Return the signs of strain for which the rows hold."""
    return (1, -1) if law(-0.3)[0] == law(0.3)[0] else (1,)


def test_the_force_passes_through_the_rows(law: Curve) -> None:
    for sign in signs(law):
        for strain, force in zip(ROWS.strains, ROWS.forces, strict=True):
            assert law(sign * strain)[1] == pytest.approx(sign * force, rel=1e-12, abs=1e-15)


def test_between_rows_the_force_is_the_monotone_interpolant(law: Curve) -> None:
    reference = PchipInterpolator(ROWS.strains, ROWS.forces)
    for strain in np.linspace(ROWS.strains[1], ROWS.strains[-1], 101):  # rest has another slope
        energy, force, stiffness = law(strain)
        assert force == pytest.approx(reference(strain), rel=1e-12)
        assert energy > 0 and stiffness > 0


def test_force_and_stiffness_are_derivatives_of_the_energy(law: Curve) -> None:
    """Gauss' rule with three points is exact for the polynomials between rows."""
    points, weights = np.polynomial.legendre.leggauss(3)
    limits = [*(-s for s in ROWS.strains[:0:-1]), *ROWS.strains]
    for a, b in pairwise(limits):
        inside = [law(a + (b - a) * (p + 1) / 2) for p in points]
        for order in (0, 1):
            growth = (
                (b - a) / 2 * sum(w * v[order + 1] for w, v in zip(weights, inside, strict=True))
            )
            assert law(b)[order] - law(a)[order] == pytest.approx(growth, rel=1e-10, abs=1e-14)


def test_the_energy_has_continuous_second_derivatives(law: Curve) -> None:
    step = 1e-9
    for strain in (*ROWS.strains, *(-s for s in ROWS.strains)):
        below, above = law(strain - step), law(strain + step)
        assert below == pytest.approx(above, rel=1e-4, abs=1e-5)


def test_a_yarn_in_compression_has_the_stiffness_of_the_first_rows() -> None:
    law, stiffness = curve("stretch", ROWS), ROWS.forces[1] / ROWS.strains[1]
    for strain in (-1e-6, -0.1):
        energy, force, tangent = law(strain)
        assert (force, tangent) == pytest.approx((stiffness * strain, stiffness), rel=1e-12)
        assert energy == pytest.approx(stiffness / 2 * strain**2, rel=1e-12)


def test_beyond_the_table_the_tension_goes_on_along_its_tangent() -> None:
    law = curve("stretch", ROWS)
    end, force, slope = law(0.6)[0], *law(0.6)[1:]
    assert slope > 0
    assert law(0.9) == pytest.approx(
        (end + 0.3 * force + 0.045 * slope, force + 0.3 * slope, slope)
    )


@pytest.mark.parametrize("rest", [0.0, 0.4, -0.7])
def test_beyond_the_table_the_shear_torque_grows_without_bound(rest: float) -> None:
    law = curve("shear", ROWS, rest)
    for sign in (1, -1):
        lock = pi / 2 - sign * rest  # where the yarns align
        angles = lock - np.geomspace(lock - 0.6, 1e-4, 40)[:-1]
        torques = sign * np.array([law(sign * a)[1] for a in angles])
        assert np.all(np.diff(torques) > 0)
        distances = lock - angles[-10:]  # the torque of a squared tangent is as its third power
        powers = np.diff(np.log(torques[-10:])) / np.diff(np.log(distances))
        assert powers == pytest.approx(-3, abs=0.02)


def test_a_curve_that_flattens_quickly_keeps_a_slope_at_its_end() -> None:
    flat = ForceTable((0.1, 0.2, 0.3), (1.0, 2.0, 2.001))
    assert pieces_of(flat)[-1, 3] == pytest.approx(LEAST_SLOPE * 0.01)


@pytest.mark.parametrize("table", [ROWS, EVEN], ids=["uneven", "even"])
def test_the_least_slope_is_found_between_the_rows(table: ForceTable) -> None:
    law, step = curve("stretch", table), table.strains[-1] / 2000
    slopes = [law(strain)[2] for strain in np.arange(-0.1, 1.2 * table.strains[-1], step)]
    assert least_slope(pieces_of(table)) == pytest.approx(min(slopes), rel=2e-3)
    assert least_slope(pieces_of(table)) <= min(slopes) * (1 + 1e-12)


def test_more_rows_of_a_closed_law_give_its_force_on_a_picture_frame() -> None:
    """The error of the rows falls with the square of their distance at least."""

    def forces(shear: dict[str, Any]) -> np.ndarray:
        effects = {"stretch": {"stiffness": 1e7}, "shear": shear}
        program = {"type": "ramp", "to": "150 mm", "steps": 5, "velocity": "1 m/s"}
        return np.array(
            [s.force for s in wovenfab.steps(picture_frame(effects=effects, program=program))]
        )

    def table(rows: int) -> dict[str, Any]:
        angles = np.linspace(0, 1.0, rows)
        torques = 400 * np.tan(angles) / np.cos(angles) ** 2
        return {"law": "table", "table": {"angle": list(angles), "force": list(torques)}}

    closed = forces({"stiffness": 400.0})
    errors = [np.abs(forces(table(rows)) - closed).max() / closed.max() for rows in (11, 21)]
    assert errors[-1] < 1e-4
    assert scenes.orders(errors).min() > 1.9


def test_a_pull_along_a_fibre_meets_the_table_of_that_family() -> None:
    on = scenes.sheet(0.9, 0.3, 0.15, fibres=scenes.ALONG)
    terms = [
        wovenfab.stretch(law="table", table=(EVEN, ROWS), scale=(3.0, 1.0)),
        wovenfab.shear(law="table", table=EVEN),
    ]
    grips = (
        Grip("left", (Held(), None)),
        Grip("bottom", (None, Held())),
        Grip("right", (Held(1.0), None)),
    )
    strain = 0.45
    reaction = scenes.force(build_model(on, terms), grips, strain * 0.9)["right"][0]
    assert reaction == pytest.approx(3 * 0.3 * curve("stretch", EVEN)(strain)[1], rel=1e-8)
