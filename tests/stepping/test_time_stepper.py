"""Steps that fail: restored, cut and retried, and named in the end."""

from __future__ import annotations

import re
from itertools import count, pairwise
from operator import attrgetter

import numpy as np
import pytest

from tests import scenes
from wovenfab.compat import NOT_FINITE
from wovenfab.model.model import Model
from wovenfab.solver import problem as solver_module
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.problem import SolveResult, SolverOptions
from wovenfab.stepping.program import Program, cycle, program_of, ramp
from wovenfab.stepping.step import StepFailedError

SHORT = 0.6  # 1:2, locks at 0.124 m
#: Elastic first, then beyond all reach.
TOO_FAR = program_of([ramp(0.0, 0.01, 1.0, 4), ramp(0.01, 5.0, 1.0, 1)])


def bonded(length: float = 0.9) -> Model:
    return scenes.model(scenes.sheet(length), scenes.BONDED, scenes.PROTOTYPE)


def pull(displacement: float, steps: int) -> Program:
    return program_of([ramp(0.0, displacement, 1.0, steps)])


@pytest.mark.parametrize(
    ("length", "displacement", "iterations"),
    [(0.9, 0.1, 3), (SHORT, 0.2, 8)],
    ids=["too few iterations", "beyond locking"],
)
def test_cut_steps_end_like_small_ones(length: float, displacement: float, iterations: int) -> None:
    model, few = bonded(length), SolverOptions(max_iterations=iterations)
    run = scenes.run(model, pull(displacement, 1), few)
    assert run.failure is None
    cut = run.steps
    assert sum(s.cutbacks for s in cut) > 0
    assert [s.number for s in cut] == list(range(len(cut)))
    assert [s.milestone is not None for s in cut] == [True] + [False] * (len(cut) - 2) + [True]
    same = [ramp(a.displacement, b.displacement, b.time - a.time, 1) for a, b in pairwise(cut)]
    gentle = scenes.run(model, program_of(same))
    small = gentle.steps
    assert not any(s.cutbacks for s in small)
    assert cut[-1].displacement == small[-1].displacement == displacement
    assert run.fields[-1] == pytest.approx(gentle.fields[-1], abs=1e-8 * displacement)
    for step, other in zip(cut[1:], small[1:], strict=True):
        force = other.reactions["right"]
        assert step.reactions["right"] == pytest.approx(force, rel=1e-8, abs=1e-8 * force[0])
        assert step.stored == pytest.approx(other.stored, rel=1e-8)


def test_cut_backs_hardly_change_the_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    names = (*scenes.COUPLED, "slip_friction")
    model = scenes.model(scenes.sheet(mesh_size=0.3), names, scenes.PROTOTYPE_TWO_STEPS)
    program = program_of(cycle(0.0, 0.04, 1.0, 40))
    smooth = scenes.march(model, program, "bdf2")
    refuse, whole = count(), EquilibriumSolver.solve

    def solve(self: EquilibriumSolver, allow_fallback: bool = True) -> object:
        """Pretend that every seventh solve did not converge."""
        result = whole(self, allow_fallback)
        failed = next(refuse) % 7 == 3
        return SolveResult(False, "REFUSED", 1, 1.0) if failed else result

    monkeypatch.setattr(EquilibriumSolver, "solve", solve)
    rough = scenes.march(model, program, "bdf2")
    assert sum(s.cutbacks for s in rough) >= 5
    assert [s.milestone for s in rough if s.milestone] == [s.milestone for s in smooth]
    assert sum(s.cutbacks for s in rough) == next(refuse) - (len(rough) - 1)
    assert scenes.lost(rough[-1]) == pytest.approx(scenes.lost(smooth[-1]), rel=0.01)
    for a, b in zip(smooth, [s for s in rough if s.milestone], strict=True):  # up to 400 N
        assert b.reactions["right"][0] == pytest.approx(a.reactions["right"][0], abs=8.0)


def test_after_the_smallest_step_the_last_state_is_restored_bit_for_bit() -> None:
    model = bonded(SHORT)
    whole = scenes.run(model, pull(0.01, 4))
    assert whole.failure is None
    run = scenes.run(model, TOO_FAR, SolverOptions(max_iterations=6), 0.3)
    assert run.failure is not None
    assert (model.field.x.array == run.fields[-1]).all()
    assert np.abs(run.fields[-1]).max() > 0
    answer = attrgetter("time", "displacement", "reactions", "stored", "work")
    assert all(answer(a) == answer(b) for a, b in zip(run.steps, whole.steps, strict=False))
    assert len(run.steps) >= 5


def test_every_rejected_attempt_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    solves, whole = count(), EquilibriumSolver.solve

    def solve(self: EquilibriumSolver, allow_fallback: bool = True) -> object:
        next(solves)
        return whole(self, allow_fallback)

    monkeypatch.setattr(EquilibriumSolver, "solve", solve)
    run = scenes.run(bonded(SHORT), TOO_FAR, SolverOptions(max_iterations=6), 0.3)
    assert isinstance(run.failure, StepFailedError) and run.failure.cutbacks == 2
    accepted, rejected = len(run.steps) - 1, sum(s.cutbacks for s in run.steps) + 2
    assert accepted + rejected == next(solves)


def test_a_failure_says_when_where_and_why() -> None:
    run = scenes.run(bonded(), pull(0.1, 1), SolverOptions(max_iterations=1), 0.2)
    failure = run.failure
    assert len(run.steps) == 1
    assert isinstance(failure, StepFailedError)
    assert failure.result.reason == "DIVERGED_MAX_IT"
    assert failure.result.iterations == 1
    assert (failure.time, failure.displacement, failure.step) == (0.25, 0.025, 0.25)
    assert re.fullmatch(
        r"no equilibrium at t = 0\.25 s \(displacement 25 mm\) even with a step of 0\.25 s: "
        r"DIVERGED_MAX_IT after 1 iterations?, residual [\d.e+-]+ N\. "
        r"Probable cause: the step is too large: .* \(iterations: 1\)\. "
        r"Worst point: x = [\d.]+ mm, y = [\d.]+ mm \(at rest\), where the last "
        r"equilibrium has shear angle 0°, stretches 0 % and 0 %\. Remedy: plan more steps, or .*",
        str(failure),
    )


@pytest.mark.parametrize("everywhere", [True, False], ids=["everywhere", "at the grip alone"])
def test_a_nan_that_stays_ends_as_a_failure(
    monkeypatch: pytest.MonkeyPatch, everywhere: bool
) -> None:
    model = bonded()
    held = 2 * model.placements.on_facets(model.sheet.edge_facets("right"), 0)
    scenes.spoil_residuals(monkeypatch, range(12, 10**6), slice(None) if everywhere else held)
    run = scenes.run(model, pull(0.04, 8))
    assert isinstance(run.failure, StepFailedError)
    assert run.failure.result.reason == NOT_FINITE
    assert 1 < len(run.steps) < 9
    assert np.isfinite(run.fields).all()
    for step in run.steps:
        forces = (*step.reactions["left"], *step.reactions["right"])
        assert np.isfinite([*forces, step.work, *step.stored.values()]).all()


def test_a_nan_that_passes_costs_one_cut_back(monkeypatch: pytest.MonkeyPatch) -> None:
    model = bonded()
    clean = scenes.run(model, pull(0.04, 8))
    scenes.spoil_residuals(monkeypatch, range(12, 13), slice(None))
    run = scenes.run(model, pull(0.04, 8))
    assert run.failure is None
    assert sum(s.cutbacks for s in run.steps) == 1 and len(run.steps) == len(clean.steps) + 1
    assert run.fields[-1] == pytest.approx(clean.fields[-1], abs=1e-10)


def test_a_singular_tangent_ends_as_a_failure_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solver_module, "assemble_matrix", lambda matrix, *_: matrix.zeroEntries())
    run = scenes.run(bonded(), pull(0.04, 2), smallest_step=0.5)
    assert len(run.steps) == 1
    assert isinstance(run.failure, StepFailedError)
    assert run.failure.result.reason.startswith("DIVERGED")


def test_without_predictor_a_step_starts_from_the_last_state_and_ends_the_same() -> None:
    model = bonded()
    with_it, without = (
        scenes.run(model, pull(0.04, 8), smallest_step=0.5, predict=predict)
        for predict in (True, False)
    )
    assert with_it.steps[-1].iterations < without.steps[-1].iterations
    assert without.fields[-1] == pytest.approx(with_it.fields[-1], abs=1e-9)


@pytest.mark.parametrize(
    ("names", "is_known"), [(scenes.BONDED, True), ((*scenes.COUPLED, "slip_friction"), False)]
)
def test_the_way_back_is_known_only_where_nothing_depends_on_the_past(
    names: tuple[str, ...], is_known: bool
) -> None:
    """A solve starts from the state at the same displacement: one tangent shows that it is one."""
    model = scenes.model(scenes.sheet(mesh_size=0.3), names, scenes.PROTOTYPE)
    program = program_of(cycle(0.0, 0.04, 1.0, 12))
    steps = scenes.run(model, program).steps[1:]
    there, back = steps[:6], steps[6:]
    assert (sum(s.iterations for s in back) <= len(back)) == is_known
    forces = [s.reactions["right"][0] for s in (*there, *back)]
    if is_known:
        assert forces[-2:5:-1] == pytest.approx(forces[:5], rel=1e-6)
    else:
        assert forces[-2] < 0.99 * forces[0]
