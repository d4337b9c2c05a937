"""Crimp interchange against a search for the least energy, and what fabrics show of it."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np
import pytest
import ufl
from dolfinx import fem
from scipy.optimize import minimize_scalar

from tests import scenes
from wovenfab.forms.kinematics import Point

#: Stiffness (N/m) and crimp of warp and weft, and resistance (N/m).
FABRICS = [
    ((2e5, 1e5), (0.08, 0.04), 50.0),
    ((2e5, 1e5), (0.02, 0.1), 5.0),
    ((1e6, 1e6), (0.005, 0.005), 1.0),
]
Evaluate = Callable[[float, float], tuple[float, np.ndarray, np.ndarray]]


def law(fabric: tuple) -> Evaluate:
    """Return energy, forces and stiffnesses of the effect as a function of both stretches."""
    mesh = scenes.sheet(0.2, 0.1, 0.1).mesh
    given = fem.Constant(mesh, [1.0, 1.0])
    f = (ufl.variable(ufl.as_vector([given[0], 0.0])), ufl.variable(ufl.as_vector([0.0, given[1]])))
    point = Point(f, None, None, (ufl.as_vector([1.0, 0.0]), ufl.as_vector([0.0, 1.0])))
    values = dict(zip(("stiffness", "crimp", "resistance"), fabric, strict=True))
    energy = scenes.effect("crimp").stored(point, values)
    forces = [ufl.diff(energy, f[a])[a] for a in range(2)]
    rates = [ufl.diff(ufl.diff(energy, f[a]), f[b])[a, b] for a in range(2) for b in range(2)]
    all_of_them = ufl.as_vector([energy, *forces, *rates])
    compiled = fem.Expression(all_of_them, np.array([[0.3, 0.3]]), mesh.comm)

    def evaluate(warp: float, weft: float) -> tuple[float, np.ndarray, np.ndarray]:
        given.value[:] = warp, weft
        found = compiled.eval(mesh, np.array([0], dtype=np.int32)).ravel()
        return found[0], found[1:3], found[3:].reshape(2, 2)

    return evaluate


@pytest.fixture(scope="module", params=FABRICS, ids=["apparel", "one straight", "technical"])
def fabric(request: pytest.FixtureRequest) -> tuple[tuple, Evaluate]:
    return request.param, law(request.param)


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


def test_the_sheet_is_stable_with_the_stiffness_that_is_stated(
    fabric: tuple[tuple, Evaluate],
) -> None:
    (_, crimps, resistance), evaluate = fabric
    shares = 1 - (1 + np.array(crimps)) ** -2.0
    stated = (resistance * (1 - shares) / (4 * shares)).max()
    lowest = []
    for at in np.random.default_rng(3).uniform(0.9, 1.15, (200, 2)):
        rates = evaluate(*at)[2]
        assert rates[0, 1] == pytest.approx(rates[1, 0], abs=1e-7 * np.abs(rates).max())
        lowest.append(np.linalg.eigvalsh(rates)[0] + 1e-9 * np.abs(rates).max())
    assert min(lowest) > -stated


def test_a_crimped_yarn_is_soft_until_it_is_straight() -> None:
    (stiffness, crimps, resistance), evaluate = FABRICS[0], law(FABRICS[0])

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


def test_a_family_that_is_pulled_takes_crimp_from_the_other() -> None:
    evaluate = law(FABRICS[0])
    alone, together = evaluate(1.03, 1.0)[1], evaluate(1.03, 1.02)[1]
    assert alone[1] > 0  # a weft that is held is pulled by the warp
    assert together[0] > 1.5 * alone[0]
