"""Steps that fail: restored, cut and retried, and told by name in the end."""

from __future__ import annotations

import itertools
import re
from itertools import count

import numpy as np
import pytest

from tests import scenes
from wovenfab.model.model import Model
from wovenfab.solver import problem as solver_module
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.problem import SolveResult, SolverOptions
from wovenfab.stepping.program import Program, cycle, program_of, ramp
from wovenfab.stepping.schemes import SCHEMES
from wovenfab.stepping.step import Step, StepFailedError
from wovenfab.stepping.time_stepper import TimeStepper

SHORT = 0.6  # 1:2, locks at 0.124 m


def bonded(length: float = 0.9) -> Model:
    return scenes.model(scenes.sheet(length), scenes.BONDED, scenes.PROTOTYPE)


def march(
    model: Model, program: Program, options: SolverOptions, smallest_step: float = 1 / 64
) -> tuple[TimeStepper, EquilibriumSolver]:
    model.field.x.array[:] = 0
    equilibrium = scenes.solver(model, options=options)
    scheme = SCHEMES["backward-euler"]
    return TimeStepper(equilibrium, program, scheme, smallest_step), equilibrium


def run(
    model: Model, program: Program, options: SolverOptions, smallest_step: float = 1 / 64
) -> tuple[list[Step], list[np.ndarray], StepFailedError | None]:
    """Return the accepted steps, the field at each, and the failure."""
    marching, equilibrium = march(model, program, options, smallest_step)
    steps, fields, failure = [], [], None
    try:
        for step in marching.steps():
            steps.append(step)
            fields.append(model.field.x.array.copy())
    except StepFailedError as error:
        failure = error
    equilibrium.destroy()
    return steps, fields, failure


def pull(displacement: float, steps: int) -> Program:
    return program_of([ramp(0.0, displacement, 1.0, steps)])


@pytest.mark.parametrize(
    ("length", "displacement", "iterations"),
    [(0.9, 0.1, 3), (SHORT, 0.2, 8)],
    ids=["too few iterations", "beyond locking"],
)
def test_a_step_that_was_cut_ends_where_small_steps_end(
    length: float, displacement: float, iterations: int
) -> None:
    model, few = bonded(length), SolverOptions(max_iterations=iterations)
    cut, fields, failure = run(model, pull(displacement, 1), few)
    assert failure is None
    assert sum(s.cutbacks for s in cut) > 0
    assert [s.number for s in cut] == list(range(len(cut)))
    assert [s.milestone is not None for s in cut] == [True] + [False] * (len(cut) - 2) + [True]
    same = [
        ramp(a.displacement, b.displacement, b.time - a.time, 1) for a, b in itertools.pairwise(cut)
    ]
    small, gentle, _ = run(model, program_of(same), SolverOptions())
    assert not any(s.cutbacks for s in small)
    assert cut[-1].displacement == small[-1].displacement == displacement
    assert fields[-1] == pytest.approx(gentle[-1], abs=1e-8 * displacement)
    for step, other in zip(cut[1:], small[1:], strict=True):
        assert step.reactions["right"] == pytest.approx(
            other.reactions["right"], rel=1e-8, abs=1e-8 * other.reactions["right"][0]
        )
        assert step.stored == pytest.approx(other.stored, rel=1e-8)


def test_cut_backs_change_the_dissipated_energy_only_within_the_time_accuracy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    names = (*scenes.COUPLED, "slip_friction")
    numerics = scenes.PROTOTYPE_TWO_STEPS
    model = scenes.model(scenes.sheet(mesh_size=0.3), names, numerics)
    program = program_of(cycle(0.0, 0.04, 1.0, 40))
    smooth = scenes.march(model, program, "bdf2")
    refuse, whole = count(), EquilibriumSolver.solve

    def solve(self: EquilibriumSolver) -> object:
        """Pretend that every seventh solve did not converge."""
        result = whole(self)
        failed = next(refuse) % 7 == 3
        return SolveResult(False, "REFUSED", 1, 1.0) if failed else result

    monkeypatch.setattr(EquilibriumSolver, "solve", solve)
    rough = scenes.march(model, program, "bdf2")
    assert sum(s.cutbacks for s in rough) >= 5
    assert [s.milestone for s in rough if s.milestone] == [s.milestone for s in smooth]
    assert sum(s.cutbacks for s in rough) == next(refuse) - (len(rough) - 1)
    lost = [s[-1].dissipated["slip_friction"] for s in (smooth, rough)]
    assert lost[1] == pytest.approx(lost[0], rel=0.01)
    for a, b in zip(smooth, [s for s in rough if s.milestone], strict=True):
        peak = 400.0
        assert b.reactions["right"][0] == pytest.approx(a.reactions["right"][0], abs=0.02 * peak)


def test_after_the_smallest_step_the_last_state_is_restored_bit_for_bit() -> None:
    model = bonded(SHORT)
    program = program_of([ramp(0.0, 0.01, 1.0, 4), ramp(0.01, 5.0, 1.0, 1)])
    whole, _, failure = run(model, pull(0.01, 4), SolverOptions())
    assert failure is None
    steps, fields, failure = run(model, program, SolverOptions(max_iterations=6), smallest_step=0.3)
    assert failure is not None
    assert (model.field.x.array == fields[-1]).all()
    assert np.abs(fields[-1]).max() > 0
    for a, b in zip(steps, whole, strict=False):
        assert (a.time, a.displacement, a.reactions, a.stored, a.work) == (
            b.time, b.displacement, b.reactions, b.stored, b.work
        )  # fmt: skip
    assert len(steps) >= 5


def test_every_rejected_attempt_is_counted_those_before_a_failure_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    solves, whole = count(), EquilibriumSolver.solve

    def solve(self: EquilibriumSolver) -> object:
        next(solves)
        return whole(self)

    monkeypatch.setattr(EquilibriumSolver, "solve", solve)
    program = program_of([ramp(0.0, 0.01, 1.0, 4), ramp(0.01, 5.0, 1.0, 1)])
    steps, _, failure = run(
        bonded(SHORT), program, SolverOptions(max_iterations=6), smallest_step=0.3
    )
    assert failure is not None and failure.cutbacks == 2
    accepted, rejected = len(steps) - 1, sum(s.cutbacks for s in steps) + failure.cutbacks
    assert accepted + rejected == next(solves)


def test_a_failure_says_when_where_and_why() -> None:
    steps, _, failure = run(
        bonded(), pull(0.1, 1), SolverOptions(max_iterations=1), smallest_step=0.2
    )
    assert len(steps) == 1
    assert failure is not None
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


def poisoned(monkeypatch: pytest.MonkeyPatch, calls: range, where: object) -> None:
    """Let the numbered assemblies of the residual give NaN at some unknowns."""
    whole, number = solver_module.assemble_vector, count()

    def assemble(b: object, form: object, *more: object) -> object:
        result = whole(b, form, *more)
        if next(number) in calls:
            b.array_w[where] = np.nan  # type: ignore[attr-defined]
        return result

    monkeypatch.setattr(solver_module, "assemble_vector", assemble)


def held_unknowns(model: Model) -> np.ndarray:
    return 2 * model.placements.on_facets(model.sheet.edge_facets("right"), 0)


@pytest.mark.parametrize("everywhere", [True, False], ids=["everywhere", "at the grip alone"])
def test_a_nan_that_stays_ends_as_a_failure_by_name_with_clean_records(
    monkeypatch: pytest.MonkeyPatch, everywhere: bool
) -> None:
    model = bonded()
    where = slice(None) if everywhere else held_unknowns(model)
    poisoned(monkeypatch, range(12, 10**6), where)
    steps, fields, failure = run(model, pull(0.04, 8), SolverOptions())
    assert failure is not None and failure.result.reason == "DIVERGED_FNORM_NAN"
    assert 1 < len(steps) < 9
    for step, field in zip(steps, fields, strict=True):
        assert np.isfinite(field).all()
        assert np.isfinite([*step.reactions["left"], *step.reactions["right"], step.work]).all()
        assert np.isfinite(list(step.stored.values())).all()


def test_a_nan_that_passes_costs_a_cut_back_and_nothing_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model = bonded()
    clean, gentle, _ = run(model, pull(0.04, 8), SolverOptions())
    poisoned(monkeypatch, range(12, 13), slice(None))
    steps, fields, failure = run(model, pull(0.04, 8), SolverOptions())
    assert failure is None
    assert sum(s.cutbacks for s in steps) == 1 and len(steps) == len(clean) + 1
    assert fields[-1] == pytest.approx(gentle[-1], abs=1e-10)


def test_a_singular_tangent_ends_as_a_failure_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solver_module, "assemble_matrix", lambda matrix, *_: matrix.zeroEntries())
    steps, _, failure = run(bonded(), pull(0.04, 2), SolverOptions(), smallest_step=0.5)
    assert len(steps) == 1
    assert failure is not None and failure.result.reason.startswith("DIVERGED")


def test_without_predictor_a_step_starts_from_the_last_state_and_ends_the_same() -> None:
    found = {}
    for predict in (True, False):
        model = bonded()
        equilibrium = scenes.solver(model, scenes.PULL, SolverOptions())
        scheme = SCHEMES["backward-euler"]
        marching = TimeStepper(equilibrium, pull(0.04, 8), scheme, 0.5, predict=predict)
        *_, last = marching.steps()
        found[predict] = (last.iterations, model.field.x.array.copy())
        equilibrium.destroy()
    assert found[True][0] < found[False][0]
    assert found[False][1] == pytest.approx(found[True][1], abs=1e-9)
