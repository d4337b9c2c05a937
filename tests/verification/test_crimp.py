"""Crimp interchange against a search for the least energy, and what fabrics show of it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import pi, sqrt

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from scipy.optimize import minimize_scalar

import wovenfab
from tests import scenes
from wovenfab.case import Case
from wovenfab.forms.kinematics import Point
from wovenfab.stepping.stability import StabilityLostError

#: Stiffness (N/m) and crimp of warp and weft, and resistance (N/m).
FABRICS = [
    ((2e5, 1e5), (0.08, 0.04), 50.0),
    ((2e5, 1e5), (0.02, 0.1), 5.0),
    ((1e6, 1e6), (0.005, 0.005), 1.0),
]
Evaluate = Callable[[float, float], tuple[float, np.ndarray, np.ndarray]]


@pytest.fixture(scope="module")
def effect() -> Callable[[tuple, float, float], tuple[float, np.ndarray, np.ndarray]]:
    """Return energy, forces and stiffnesses as a function of fabric and stretches."""
    mesh = scenes.sheet(0.2, 0.1, 0.1).mesh
    given = fem.Constant(mesh, np.ones(7))
    f = (ufl.variable(ufl.as_vector([given[0], 0.0])), ufl.variable(ufl.as_vector([0.0, given[1]])))
    point = Point(f, None, None, (ufl.as_vector([1.0, 0.0]), ufl.as_vector([0.0, 1.0])))
    pairs = {"stiffness": (given[2], given[3]), "crimp": (given[4], given[5])}
    energy = scenes.effect("crimp").stored(point, {**pairs, "resistance": given[6]})
    forces = [ufl.diff(energy, f[a])[a] for a in range(2)]
    rates = [ufl.diff(ufl.diff(energy, f[a]), f[b])[a, b] for a in range(2) for b in range(2)]
    all_of_them = ufl.as_vector([energy, *forces, *rates])
    compiled = fem.Expression(all_of_them, np.array([[0.3, 0.3]]), mesh.comm)

    def evaluate(fabric: tuple, warp: float, weft: float) -> tuple[float, np.ndarray, np.ndarray]:
        given.value[:] = warp, weft, *fabric[0], *fabric[1], fabric[2]
        found = compiled.eval(mesh, np.array([0], dtype=np.int32)).ravel()
        return found[0], found[1:3], found[3:].reshape(2, 2)

    return evaluate


@pytest.fixture(scope="module", params=FABRICS, ids=["apparel", "one straight", "technical"])
def fabric(request: pytest.FixtureRequest, effect: Callable) -> tuple[tuple, Evaluate]:
    return request.param, partial(effect, request.param)


def least(fabric: tuple, stretches: tuple[float, float]) -> float:
    """Return the least energy (J/m^2) over the interchange, found by a search."""

    def energy(t: float) -> float:
        total = fabric[2] / 2 * t**2
        for side, k, c, x in zip((-1, 1), *fabric[:2], stretches, strict=True):
            length = x**2 + ((1 + c) ** 2 - 1) * (1 + side * t) ** 2  # squared, over p^2
            e = (length / (1 + c) ** 2 - 1) / 2
            b = fabric[2] / (k * (1 - (1 + c) ** -2))
            total += k / 4 * e**2 * (1 + e / (b + sqrt(b**2 + e**2)))
        return total

    return minimize_scalar(energy, bounds=(-2, 2), method="bounded", options={"xatol": 1e-9}).fun


def test_the_energy_is_the_least_over_the_interchange(fabric: tuple[tuple, Evaluate]) -> None:
    given, evaluate = fabric
    for warp, weft in np.random.default_rng(1).uniform(0.98, 1.12, (40, 2)):
        assert evaluate(warp, weft)[0] == pytest.approx(least(given, (warp, weft)), rel=1e-7)


def test_forces_and_stiffnesses_are_derivatives_of_the_energy(
    fabric: tuple[tuple, Evaluate],
) -> None:
    _, evaluate = fabric
    step = 1e-5
    for at in np.random.default_rng(2).uniform(0.99, 1.1, (20, 2)):
        _, forces, rates = evaluate(*at)
        for a, e in enumerate(np.eye(2) * step):
            above, below = evaluate(*(at + e)), evaluate(*(at - e))
            size = np.abs(rates).max()
            assert forces[a] == pytest.approx((above[0] - below[0]) / (2 * step), abs=1e-4 * size)
            assert rates[a] == pytest.approx((above[1] - below[1]) / (2 * step), abs=0.02 * size)


def test_a_fabric_at_rest_has_no_force(fabric: tuple[tuple, Evaluate]) -> None:
    energy, forces, _ = fabric[1](1.0, 1.0)
    assert abs(energy) < 1e-12 and np.abs(forces).max() < 1e-9


def test_the_energy_is_as_convex_as_stated_and_hardly_more(effect: Callable) -> None:
    """A random search over fabrics and all stretches."""
    stated, rng, lowest = scenes.effect("crimp").stretch_stiffness, np.random.default_rng(3), []
    assert stated is not None
    for i in range(2500):
        fabric = (
            10 ** rng.uniform(3, 7, 2),
            10 ** rng.uniform(-3, -0.3, 2),
            10 ** rng.uniform(-1, 3),
        )
        names = ("stiffness", "crimp", "resistance")
        least = np.array(stated(dict(zip(names, fabric, strict=True))))
        stretches = rng.uniform(0, 1.5, 2) if i % 2 else rng.normal(1, 0.05, 2)
        rates = effect(fabric, *stretches)[2]
        size = np.abs(rates).max()
        assert rates[0, 1] == pytest.approx(rates[1, 0], abs=1e-7 * size)
        scaled = np.sqrt(np.outer(least, least))
        lowest.append(np.linalg.eigvalsh(rates / scaled)[0])
        assert lowest[-1] > -1 - 1e-8 * (1 + (np.abs(rates) / scaled).max())
    assert min(lowest) < -0.9999


@pytest.mark.slow
@pytest.mark.parametrize(("share", "told"), [(0.5, True), (1.01, False)])
def test_what_is_accepted_can_be_compressed_and_what_is_told_cannot(
    share: float, told: bool
) -> None:
    """Both families by a tenth, with held edges: the uniform state is stable, or it is told."""
    needed = FABRICS[0][2] * np.array([1 / ((1 + c) ** 2 - 1) / 4 for c in FABRICS[0][1]])
    case = Case(
        sheet={"length": 0.1, "width": 0.1, "fibres": [0, pi / 2]},
        effects={
            "crimp": dict(zip(("stiffness", "crimp", "resistance"), FABRICS[0], strict=True)),
            "stretch": {"stiffness": [float(share * k) for k in needed]},
            "shear": {"stiffness": 400.0},
            "bending": {"stiffness": 0.2},
        },
        boundary={
            "left": {"displacement": [0, "program*y/0.1 m"]},
            "right": {"displacement": ["program", "program*y/0.1 m"]},
            "bottom": {"displacement": ["program*x/0.1 m", 0]},
            "top": {"displacement": ["program*x/0.1 m", "program"]},
        },
        program={"type": "ramp", "to": -0.01, "steps": 4, "velocity": 0.01},
        discretisation={"degree": 2, "mesh_size": 0.025},
        output={"pictures": False},
    )  # fmt: skip
    assert bool(case.remarks()) == told
    if told:
        with pytest.raises(StabilityLostError):
            list(wovenfab.steps(case, comm=MPI.COMM_SELF))
        return
    *_, last = wovenfab.steps(case, comm=MPI.COMM_SELF)
    assert last.displacement == -0.01 and last.force < 0


def test_a_crimped_yarn_is_soft_until_it_is_straight(effect: Callable) -> None:
    (stiffness, crimps, resistance), evaluate = FABRICS[0], partial(effect, FABRICS[0])

    def tension(warp: float) -> float:
        """Return the force with a weft that is free to contract."""
        free = minimize_scalar(
            lambda weft: evaluate(warp, weft)[0], bounds=(0.7, 1.1), method="bounded",
            options={"xatol": 1e-10},
        )  # fmt: skip
        return evaluate(warp, free.x)[1][0]

    slopes = [(tension(x + 1e-3) - tension(x)) / 1e-3 for x in (1.01, 1 + 2 * crimps[0])]
    toe = resistance / ((1 + crimps[0]) ** 2 - 1) ** 2
    assert tension(1.002) / 0.002 == pytest.approx(toe, rel=0.1)
    assert slopes[0] < 0.05 * slopes[1]
    assert slopes[1] == pytest.approx(stiffness[0], rel=0.1)


def test_a_family_that_is_pulled_takes_crimp_from_the_other(effect: Callable) -> None:
    evaluate = partial(effect, FABRICS[0])
    alone, together = evaluate(1.03, 1.0)[1], evaluate(1.03, 1.02)[1]
    assert alone[1] > 0  # a weft that is held is pulled by the warp
    assert together[0] > 1.5 * alone[0]
