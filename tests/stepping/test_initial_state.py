"""Programs that begin under a load, or change it: state, work and losses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import pi

import numpy as np
import pytest
from mpi4py import MPI

from tests import scenes
from wovenfab.model.constraints import EdgeLoad, Grip, Held
from wovenfab.model.model import Model, Numerics
from wovenfab.solver.problem import SolverOptions
from wovenfab.stepping.program import cycle, program_of, ramp
from wovenfab.stepping.schemes import SCHEMES
from wovenfab.stepping.step import StartFailedError, Step

HOLD = program_of([ramp(0.0, 0.0, 1.0, 4)])
HELD = (Grip("left", scenes.CLAMP),)
#: A weight of 60 N along the top edge of the sheet, downwards.
WEIGHT = EdgeLoad("top", (0, 1), (0.0, -60.0 / 0.9))
TIGHT = SolverOptions(tolerance=1e-12)


def model_with(
    loads: Sequence[EdgeLoad],
    names: Sequence[str] = (*scenes.BONDED, "spin_friction"),
    fibres: tuple[float, float] = scenes.BIAS,
    comm: MPI.Comm = MPI.COMM_WORLD,
    scheme: str = "bdf2",
    mesh_size: float = 0.15,
) -> Model:
    sheet = scenes.sheet(mesh_size=mesh_size, fibres=fibres, comm=comm)
    numerics = Numerics(2, history=max(2, SCHEMES[scheme].memory))
    return scenes.model(sheet, names, numerics, loads=loads)


def imbalances(steps: list[Step]) -> np.ndarray:
    """Return work less stored and lost energy (J) since the first step."""
    return np.array([scenes.imbalance(s) + scenes.stored(steps[0]) for s in steps])


@pytest.mark.parametrize(
    "scheme",
    [
        "bdf2",
        *(pytest.param(s, marks=pytest.mark.slow) for s in ("backward-euler", "midpoint", "bdf3")),
    ],
)
def test_a_hold_under_a_weight_is_the_elastic_equilibrium_and_loses_nothing(scheme: str) -> None:
    names = (*scenes.COUPLED, "slip_friction", "spin_friction")
    model = model_with([WEIGHT], names, scheme=scheme)
    steps = scenes.march(model, HOLD, scheme, HELD, TIGHT)
    elastic = model_with([WEIGHT], scenes.COUPLED)
    scenes.force(elastic, HELD, 0.0, TIGHT)
    assert model.field.x.array == pytest.approx(elastic.field.x.array, abs=1e-9)
    assert elastic.field.x.array.min() < -5e-3
    assert scenes.stored(steps[0]) == pytest.approx(sum(elastic.stored_energy().values()), rel=1e-9)
    for step in steps:
        assert step.reactions["left"] == pytest.approx((0.0, 60.0), abs=1e-6)
        assert scenes.stored(step) == pytest.approx(scenes.stored(steps[0]), rel=1e-9)
        assert abs(step.work) < 1e-9 * scenes.stored(steps[0])
        assert all(0 <= lost < 1e-9 * scenes.stored(steps[0]) for lost in step.dissipated.values())


def test_an_offset_is_there_from_the_start_too() -> None:
    grips = (*HELD, Grip("right", (Held(1.0, 0.01), Held())))
    steps = scenes.march(model_with([]), HOLD, "bdf2", grips, TIGHT)
    pulled = scenes.force(model_with([], scenes.BONDED), scenes.PULL, 0.01, TIGHT)
    assert steps[0].reactions["right"] == pytest.approx(pulled["right"], rel=1e-8, abs=1e-6)
    assert steps[0].iterations > 0 and steps[-1].work == 0
    assert steps[-1].dissipated == {"spin_friction": pytest.approx(0.0, abs=1e-9)}


@pytest.mark.parametrize("scheme", ["bdf2", pytest.param("midpoint", marks=pytest.mark.slow)])
def test_cycles_under_a_weight_close_their_energy_balance(scheme: str) -> None:
    """The imbalance falls by four as the steps are halved, and is none to speak of."""
    worst, grips = [], (*HELD, Grip("right", (Held(1.0), None)))
    for count in (20, 40, 80):
        program = program_of(cycle(0.0, 0.02, 0.2, count))
        steps = scenes.march(model_with([WEIGHT]), program, scheme, grips, TIGHT)
        assert scenes.lost(steps[-1]) > 0.1
        assert scenes.stored(steps[0]) > 0.04
        worst.append(np.abs(imbalances(steps)).max() / scenes.lost(steps[-1]))
    print(f"\n{scheme}: imbalance over dissipated energy {np.array(worst)} with 20, 40, 80 steps")
    assert worst[2] < 0.01
    assert worst[0] > 3 * worst[1] > 9 * worst[2]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_load_that_follows_the_program_stretches_a_strip_linearly(scheme: str) -> None:
    """Linear, so that the trapezoid is exact: work = F u/2."""
    load = EdgeLoad("right", (0, 1), (lambda x, program, _: 1e6 * program, 0.0))
    model = model_with([load], ("stretch", "shear"), (0.0, pi / 2))
    steps = scenes.march(model, program_of([ramp(0.0, 0.5, 1.0, 5)]), scheme, HELD, TIGHT)
    assert scenes.stored(steps[0]) == steps[0].work == 0
    for step in steps[1:]:
        per_length = 1e6 * step.displacement
        stretch = per_length / scenes.TABLE_1["stretch"]["stiffness"][0]
        assert step.reactions["left"][0] == pytest.approx(-0.3 * per_length, rel=1e-9)
        assert step.work == pytest.approx(0.3 * per_length * 0.9 * stretch / 2, rel=1e-9)
        assert step.work == pytest.approx(scenes.stored(step), rel=1e-9)


def test_a_load_that_follows_the_program_against_friction_closes_its_balance() -> None:
    """Straight lines and a hold: friction jumps with the velocity, the elastic force does not."""
    load = EdgeLoad("right", (0, 1), (lambda x, program, _: 2e4 * program, 0.0))
    last = []
    for n in (10, 20, 40):
        way = [ramp(0.0, 0.04, 0.1, n), ramp(0.04, 0.04, 0.05, n), ramp(0.04, 0.0, 0.1, n)]
        of = model_with([load], mesh_size=0.3)
        steps = scenes.march(of, program_of(way), "bdf2", HELD, TIGHT)
        assert scenes.lost(steps[-1]) > 0.05
        last.append(abs(imbalances(steps)[-1]) / scenes.lost(steps[-1]))
    print(f"\nimbalance over dissipated energy {np.array(last)} with 30, 60, 120 steps")
    assert last[0] > 3 * last[1] > 9 * last[2]
    assert last[2] < 1e-3


def test_the_first_step_of_a_line_has_no_more_imbalance_than_the_others() -> None:
    model = model_with([], scenes.BONDED)
    steps = scenes.march(model, program_of([ramp(0.0, 0.04, 1.0, 20)]), "bdf2", options=TIGHT)
    changes = np.abs(np.diff(imbalances(steps)))
    assert changes[0] < 2 * changes[1:].max()
    assert imbalances(steps)[-1] == pytest.approx(0.0, abs=1e-3 * scenes.stored(steps[-1]))


def pulled_hard() -> Model:
    return model_with([EdgeLoad("right", (0, 1), (8e3, 0.0))], scenes.BONDED)


@pytest.mark.slow
def test_a_start_that_takes_more_than_one_step_ends_in_the_same_state() -> None:
    few, many = (
        scenes.run(pulled_hard(), HOLD, replace(TIGHT, max_iterations=n), scheme="bdf2", grips=HELD)
        for n in (5, 99)
    )
    assert few.failure is many.failure is None
    assert few.steps[0].cutbacks > many.steps[0].cutbacks and few.steps[1].cutbacks == 0
    assert few.fields[-1] == pytest.approx(many.fields[-1], abs=1e-8)


def test_a_start_without_equilibrium_is_named_and_leaves_the_sheet_at_rest() -> None:
    model = pulled_hard()
    failure = scenes.run(model, HOLD, SolverOptions(max_iterations=1), 0.5, "bdf2", HELD).failure
    assert isinstance(failure, StartFailedError)
    assert "at the start, even with steps of 0.5 of" in str(failure)
    assert failure.cutbacks == 2 and failure.result.reason == "DIVERGED_MAX_IT"
    assert not model.field.x.array.any()
    assert float(model.friction.value) == 1.0


def test_a_start_that_would_buckle_is_refused() -> None:
    """A column of 0.9 m with a free end: twice what it bears at most, and a tenth of that."""
    bears = 0.3 * (pi**2 * 254.1 / (4 * 0.81) + 400)
    heavy, light = (
        model_with(
            [EdgeLoad("right", (0, 1), (-share * bears / 0.3, 0.0))], scenes.BONDED, scenes.ALONG
        )
        for share in (2, 0.2)
    )
    with pytest.raises(StartFailedError, match=r"it would not be stable \(\d negative eigenv"):
        scenes.march(heavy, HOLD, "bdf2", HELD, smallest_step=1 / 4)
    assert scenes.march(light, HOLD, "bdf2", HELD)[0].negatives == 0


@pytest.mark.mpi
@pytest.mark.mpi4
def test_ranks_agree_on_loads_and_their_work() -> None:
    load = EdgeLoad("right", (0, 1), (lambda x, program, _: 2e4 * program * (1 + x[1]), 0.0))
    program = program_of(cycle(0.0, 0.04, 0.2, 8))
    together, alone = (
        scenes.march(model_with([WEIGHT, load], comm=comm), program, "bdf2", HELD, TIGHT)
        for comm in (MPI.COMM_WORLD, MPI.COMM_SELF)
    )
    for one, all_ranks in zip(alone, together, strict=True):
        assert all_ranks.work == pytest.approx(one.work, rel=1e-8, abs=1e-10)
        assert scenes.stored(all_ranks) == pytest.approx(scenes.stored(one), rel=1e-8)
        assert all_ranks.iterations == one.iterations
