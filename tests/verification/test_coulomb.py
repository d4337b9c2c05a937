"""Coulomb's law against closed forms, its independence of the speed, and the way to it.

The second placement of a slider is held everywhere, so that the first slides on it.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from tests import scenes
from tests.verification.test_closed_forms import (
    AREA,
    COULOMB,
    DRIVE,
    K_C,
    SECOND_AT_REST,
    STROKE,
    ZETA,
    pushed_slider,
    slider,
)
from wovenfab.forms import effects
from wovenfab.model.model import Model, Numerics
from wovenfab.solver.interior_point import InteriorPoint
from wovenfab.stepping.program import Program, cycle, program_of, ramp
from wovenfab.stepping.schemes import SCHEMES
from wovenfab.stepping.time_stepper import TimeStepper

#: Most iterations of a step.
MOST = 12
#: Out, a hold, an instant reversal, a jump in velocity, and on.
ROUTE = ((0.0, 0.02, 0.2, 4), (0.02, 0.02, 0.1, 1), (0.02, 0.005, 0.15, 4), (0.005, 0.015, 0.01, 2))
KINDS = {"slip_friction": 2e4, "spin_friction": 100.0}


def route(speed: float = 1.0) -> Program:
    return program_of([ramp(a, b, time / speed, count) for a, b, time, count in ROUTE])


def sheet_with(kind: str, law: str = "coulomb", slope: float = 1.0, **numerics: int) -> Model:
    values = {**scenes.TABLE_1, kind: {"strength": KINDS[kind], "slope": slope}}
    names = (*scenes.COUPLED, f"{kind}:{law}")
    return scenes.model(scenes.sheet(), names, Numerics(2, **numerics), values)


@pytest.mark.parametrize("count", [4, 160])
@pytest.mark.parametrize("scheme", ["backward-euler", "midpoint"])
def test_a_driven_slider_loses_four_zeta_amplitudes_a_cycle(count: int, scheme: str) -> None:
    """Per area and component, however few the steps; 8 amplitudes from rest in two cycles."""
    model = slider(friction="slip_friction:coulomb")
    program = program_of([*cycle(0.0, 1.0, 2.0, count), *cycle(0.0, 1.0, 2.0, count)])
    steps = scenes.march(model, program, scheme, DRIVE)
    assert scenes.lost(steps[-1]) == pytest.approx(2 * COULOMB, rel=1e-9)
    assert (np.diff([*map(scenes.lost, steps)]) > 0).all()
    missing = np.array([scenes.imbalance(s) for s in steps])
    assert missing == pytest.approx(0, abs=1e-8 * scenes.lost(steps[-1]))
    for before, now in pairwise(steps):
        way = np.sign(now.displacement - before.displacement)
        force = (K_C * now.displacement * STROKE + ZETA * way) * AREA
        assert np.array(now.reactions["first"]) == pytest.approx(force, abs=1e-7 * ZETA * AREA)
    assert max(s.iterations for s in steps) <= MOST


def test_a_pushed_slider_is_elastic_and_plastic() -> None:
    """K_c b + zeta sign(db/dt) = f, and at rest while the spring needs less than zeta."""
    loads = [0.5, 0.9, 1.5, 3.0, 2.0, 1.1, 0.5, 0.0, 0.5, 2.5, 4.0]  # of zeta
    model = pushed_slider("slip_friction:coulomb", 0.2, lambda _, t, __: ZETA * 0.2 * t)
    program = program_of([ramp(a, b, 1.0, 1) for a, b in pairwise([0.0, *loads])])
    run = scenes.run(model, program, grips=(SECOND_AT_REST,))
    assert run.failure is None
    moved = [field.reshape(-1, 2)[:, 0] for field in run.fields]
    slips = [float(along.max() + along.min()) for along in moved]
    b, exact = 0.0, []
    for load_of_zeta in loads:
        b = min(max(b, (load_of_zeta - 1) * ZETA / K_C), (load_of_zeta + 1) * ZETA / K_C)
        exact.append(b)
    assert slips[1:] == pytest.approx(exact, abs=1e-6 * ZETA / K_C)
    assert max(s.iterations for s in run.steps) <= MOST


@pytest.mark.parametrize("kind", KINDS)
def test_the_speed_does_not_matter(kind: str) -> None:
    loops = []
    for speed in (1.0, 1000.0):
        steps = scenes.march(sheet_with(kind), route(speed))
        loops.append([*scenes.forces(steps), *map(scenes.lost, steps)])
        assert max(s.iterations for s in steps) <= MOST
        assert sum(s.cutbacks for s in steps) == 0
    size = np.abs(loops[0]).max()
    for loop in loops[1:]:
        assert loop == pytest.approx(loops[0], rel=0, abs=1e-10 * size)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(
    "kind", ["slip_friction", pytest.param("spin_friction", marks=pytest.mark.slow)]
)
def test_stress_stays_bounded_and_no_step_gains_energy(kind: str, scheme: str) -> None:
    model = sheet_with(kind, history=max(2, SCHEMES[scheme].memory))
    equilibrium = scenes.solver(model)
    steps, largest = [], []
    for step in TimeStepper(equilibrium, route(), SCHEMES[scheme], 1 / 64).steps():
        steps.append(step)
        largest += [np.abs(one.stress.x.array).max() for one in model.friction_stresses]
    equilibrium.destroy()
    assert max(largest) <= KINDS[kind]
    assert max(largest) > 0.99 * KINDS[kind]  # somewhere it slides
    assert np.diff([*map(scenes.lost, steps)]).min() >= 0
    assert max(s.iterations for s in steps) <= MOST


@pytest.mark.parametrize(
    "kind", ["slip_friction", pytest.param("spin_friction", marks=pytest.mark.slow)]
)
def test_a_step_that_goes_on_as_the_last_one_takes_less_and_ends_the_same(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = program_of([ramp(0.0, 0.02, 0.2, 24), ramp(0.02, 0.01, 0.1, 12)])
    near = scenes.march(sheet_with(kind), program)
    missed = InteriorPoint._share_missed
    # As much as is lost: none goes on.
    monkeypatch.setattr(InteriorPoint, "_share_missed", lambda self: (1.0, missed(self)[1]))
    far = scenes.march(sheet_with(kind), program)
    size = np.abs(scenes.forces(far)).max()
    assert scenes.forces(near) == pytest.approx(scenes.forces(far), rel=0, abs=1e-6 * size)
    assert scenes.lost(near[-1]) == pytest.approx(scenes.lost(far[-1]), rel=1e-5)
    assert sum(s.iterations for s in near) < 0.85 * sum(s.iterations for s in far)


def test_the_energy_balances_the_better_the_shorter_the_steps() -> None:
    """Second order: the work of the elastic part is summed by the trapezoidal rule."""
    missing = []
    for share in (1, 2, 4):
        parts = [ramp(0.0, 0.02, 1.0, 4 * share), ramp(0.02, 0.0, 1.0, 4 * share)]
        last = scenes.march(sheet_with("slip_friction"), program_of(parts))[-1]
        missing.append(abs(scenes.imbalance(last)) / scenes.lost(last))
    assert missing[2] < missing[0] / 6
    assert missing[2] < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_loop_of_the_smooth_law_tends_to_coulombs_as_its_slope_grows(kind: str) -> None:
    """By an order in 1/eta that comes near one.

    Where yarns stick they creep by artanh(tau/zeta)/eta; that points near their bound do so
    the longer the nearer is why the order is not one at once.
    """
    slopes = np.array([1e3, 1e4, 1e5, 1e6]) * (30 if kind == "slip_friction" else 1)

    def loop(law: str, slope: float = 1.0) -> NDArray[np.float64]:
        model = sheet_with(kind, law, slope, friction=4)  # the same points for both laws
        return scenes.forces(scenes.march(model, route()))

    exact = loop("coulomb")
    away = [np.abs(loop("smooth", eta) - exact).max() / np.abs(exact).max() for eta in slopes]
    orders = -np.diff(np.log(away)) / np.diff(np.log(slopes))
    print(f"\n{kind}: difference from Coulomb's loop {away}, orders {orders}")
    assert away[-1] < 1e-3
    assert (np.diff(orders) > 0).all()
    assert orders[-1] > 0.65


@pytest.mark.slow
def test_a_sheet_that_sticks_comes_near_a_bonded_one_with_each_degree() -> None:
    """What slips between the quadrature points is lost; that must shrink with each degree."""
    program = program_of([ramp(0.0, 0.01, 1.0, 2)])
    values = {**scenes.TABLE_1, "slip_friction": {"strength": 1e12}}

    def force(degree: int, *names: str) -> float:
        model = scenes.model(scenes.sheet(), names, Numerics(degree), values)
        return float(scenes.forces(scenes.march(model, program))[-1])

    stuck = (*scenes.COUPLED, "slip_friction:coulomb")
    shares = [force(d, *stuck) / force(d, *scenes.BONDED) for d in (2, 3, 4, 5)]
    print(f"\nforce of a sheet that sticks over that of a bonded one, degrees 2 to 5: {shares}")
    assert (np.diff(shares) > 0).all()
    assert 0.97 < shares[-1] < 1


@pytest.mark.parametrize(
    "degree", [2, *(pytest.param(d, marks=pytest.mark.slow) for d in (3, 4, 5))]
)
def test_friction_has_no_more_points_than_ways_to_slip(degree: int) -> None:
    """In a large mesh a cell has degree**2 / 2 unknowns of each component."""
    many = scenes.sheet(mesh_size=0.05)
    cells = many.mesh.topology.index_map(2).size_local
    model = scenes.model(many, (*scenes.COUPLED, "slip_friction:coulomb"), Numerics(degree))
    points = model.friction_stresses[0].stress.x.array.size / 2
    assert points / cells <= degree**2 / 2
    assert points / cells > 0.4 * degree**2 / 2


def test_a_scene_without_it_builds_nothing_of_it() -> None:
    plain = scenes.model(scenes.sheet(), (*scenes.COUPLED, "slip_friction"))
    assert (plain.friction_stresses, plain.friction_force, plain.loss) == ((), {}, {})
    assert len(sheet_with("slip_friction").friction_stresses) == 1
    assert {e.law for e in effects()["slip_friction"].all_laws} >= {"smooth", "coulomb"}
