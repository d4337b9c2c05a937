"""The interior-point method without a sheet: dense quadratic problems with known minima."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.optimize import brentq

from wovenfab.solver.interior_point import CentralPathTarget, Direction, InteriorPoint

Array = NDArray[np.float64]
Creep = Callable[[Array], tuple[Array, Array]]
#: Without the corrections that a solver adds.
MOST = 25


def no_creep(stress: Array) -> tuple[Array, Array]:
    return np.zeros_like(stress), np.zeros_like(stress)


def points(bound: Array) -> InteriorPoint:
    """Return the method for points of unit area without a mesh."""
    fields = {"put": lambda *_: None, "stress": None, "tangent": None, "varies": False}
    friction = SimpleNamespace(areas=np.ones_like(bound), strengths=lambda: bound, **fields)
    return InteriorPoint([friction], MPI.COMM_SELF, SimpleNamespace(value=1.0))


def solve(
    stiffness: Array, force: Array, bound: Array, creep: Creep = no_creep
) -> tuple[Array, Array, int]:
    """Minimise b·K b/2 - f·b + sum zeta |b|; return b, the stress and the iterations."""
    interior = points(bound)
    size = np.abs(force).max() / np.diag(stiffness).max()
    b = np.zeros_like(bound)
    interior.start_stress(force, b)
    interior.start_split(b, np.full_like(bound, 0.1 * size), near=False)
    for iteration in range(1, 40):
        value, slope = creep(interior.stress)
        tangent = interior.tangent(slope, np.full_like(bound, 1e3 * np.diag(stiffness).max()))

        def step(target: CentralPathTarget, tangent: Array = tangent) -> tuple[Array, Direction]:
            """Newton's step of the balance with the linearised law."""
            excess = tangent * (b - target.increment)  # noqa: B023 - used at once
            out = force - stiffness @ b - interior.stress - excess  # noqa: B023
            db = np.linalg.solve(stiffness + np.diag(tangent), out)
            return db, interior.direction(excess + tangent * db, target)

        _, predictor = step(interior.target(value, 0.0))
        length = min(1.0, interior.longest(predictor))
        now = interior.gap()
        mu = (interior.gap(predictor, length) / now) ** 3 * now / (2 * len(b))
        db, direction = step(interior.target(value, mu, predictor))
        length = min(1.0, 0.995 * interior.longest(direction))
        interior.take_step(direction, length)
        b = b + length * db
        missed = np.abs(force - stiffness @ b - interior.stress).max()
        most = 1e-11 * max(interior.loss(), size * bound.sum())
        if interior.gap() < most and missed < 1e-10 * np.abs(force).max():
            return b, interior.stress, iteration
    raise AssertionError("no solution")


@pytest.mark.parametrize("force", [0.0, 0.3, -0.999, 1.001, 2.5, -1e3])
@pytest.mark.parametrize("stiffness", [1e-3, 1.0, 1e4])
def test_one_point_sticks_below_its_bound_and_slides_beyond(force: float, stiffness: float) -> None:
    b, stress, iterations = solve(np.array([[stiffness]]), np.array([force or 1e-9]), np.ones(1))
    excess = max(abs(force) - 1, 0.0) * np.sign(force)
    assert stiffness * b[0] == pytest.approx(excess, abs=1e-8 * max(abs(force), 1))
    assert stress[0] == pytest.approx(force - excess, abs=1e-8 * max(abs(force), 1))
    assert abs(stress[0]) <= 1
    assert iterations <= MOST


def brute_force(stiffness: Array, force: Array, bound: Array) -> Array:
    """Return the minimiser by trying all states of all points: sticking, sliding either way."""
    for states in product((-1, 0, 1), repeat=len(force)):
        state = np.array(states)
        slides = state != 0
        b = np.zeros_like(force)
        part = stiffness[np.ix_(slides, slides)]
        b[slides] = np.linalg.solve(part, (force - bound * state)[slides])
        stress = force - stiffness @ b
        if (b * state >= 0)[slides].all() and (np.abs(stress) <= bound * (1 + 1e-6)).all():
            return b
    raise AssertionError("a convex problem has a minimum")


@pytest.mark.parametrize("seed", range(20))
def test_points_that_stiff_springs_tie_together_find_the_state_that_brute_force_finds(
    seed: int,
) -> None:
    """The springs' stiffnesses differ by up to 1e5, so that one point's state hangs on others'."""
    random = np.random.default_rng(seed)
    size = 6
    ties = random.standard_normal((size, size))
    stiffness = ties @ np.diag(10.0 ** random.uniform(0, 5, size)) @ ties.T
    bound = 10.0 ** random.uniform(-1, 1, size)
    force = 3 * bound * random.standard_normal(size)
    b, stress, iterations = solve(stiffness, force, bound)
    exact = brute_force(stiffness, force, bound)
    assert stiffness @ (b - exact) == pytest.approx(0, abs=1e-6 * np.abs(force).max())
    assert b == pytest.approx(exact, abs=1e-6 * np.abs(exact).max() + 1e-12)
    assert (np.abs(stress) <= bound).all()
    assert iterations <= MOST


@pytest.mark.parametrize(
    ("stress", "increment", "meets"),
    [(2.0, 1.0, True), (-2.0, -3.0, True), (0.7, 0.0, True), (5.0, 1.0, True), (2.0, -1.0, False)],
)
def test_a_start_near_the_law_has_small_products_where_it_is_met(
    stress: float, increment: float, meets: bool
) -> None:
    """Points that slide, stick, are beyond their bound of 2, and slide against their stress."""
    interior = points(np.array([2.0]))
    b, slip = np.array([increment]), np.array([0.01])
    interior.start_stress(np.array([stress]), b, slip)
    interior.start_split(b, slip, near=True)
    assert abs(interior.stress[0]) < 2
    assert interior.stress[0] == pytest.approx(np.clip(stress, -2, 2), abs=0.03)
    assert interior.loss() >= 2 * abs(increment)
    level = 2 * 0.01
    assert 2 * level <= interior.gap() * (1 + 1e-9)
    assert (interior.gap() <= 4 * level) == meets


@pytest.mark.parametrize("slope", [1.0, 1e3, 1e6, 1e12])
def test_a_law_that_creeps_is_met_however_sharp_it_is(slope: float) -> None:
    """artanh(tau)/slope + tau/K = f/K for a slider that is pushed at both its sides."""

    def creep(stress: Array) -> tuple[Array, Array]:
        return np.arctanh(stress) / slope, 1 / (1 - stress**2) / slope

    force = np.array([0.2, -0.9, 0.999999, 1.3, -40.0])
    stiffness = np.diag([1.0, 10.0, 0.1, 100.0, 3.0])
    b, stress, iterations = solve(stiffness, force, np.ones(5), creep)
    assert stiffness @ b + stress == pytest.approx(force, rel=1e-9)
    balance = [
        brentq(lambda t, f=f, k=k: np.arctanh(t) * k / slope + t - f, -1 + 1e-16, 1 - 1e-16)
        if abs(f) - 20 * k / slope < 1
        else np.sign(f)
        for f, k in zip(force, np.diag(stiffness), strict=True)
    ]
    assert stress == pytest.approx(balance, abs=1e-5)
    assert iterations <= MOST
