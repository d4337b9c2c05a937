"""Tangents that serve more than one Newton step: where they may, and that nothing else changes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import inf

import numpy as np
import pytest
from petsc4py import PETSc

from tests import scenes
from wovenfab.model.model import Numerics
from wovenfab.solver.globalisation import Convergence
from wovenfab.solver.newton import NewtonSolver
from wovenfab.solver.problem import TANGENT, SolverOptions
from wovenfab.solver.reuse import LEFT, LONGEST_WAIT, TangentReuse
from wovenfab.stepping.program import cycle, program_of, ramp
from wovenfab.stepping.step import Step

SLIDING = (*scenes.COUPLED, "slip_friction")


def reuse_after(*shares: float) -> TangentReuse:
    """Return one that has begun a solve whose steps left these shares of the forces."""
    reuse = TangentReuse()
    reuse.begin()
    for share in shares:
        reuse.taken = reuse.promises(share)
    return reuse


def test_a_tangent_serves_again_as_long_as_steps_leave_little() -> None:
    assert not reuse_after(inf).taken
    assert not reuse_after(2 * LEFT).taken
    assert reuse_after(LEFT / 2).taken
    assert reuse_after(LEFT / 2, LEFT / 3, LEFT / 2).taken
    assert not reuse_after(LEFT / 2, 2 * LEFT).taken


def test_after_a_step_that_was_not_worth_it_solves_wait_longer_each_time() -> None:
    reuse, waits = TangentReuse(), []
    for _ in range(8):
        waited = 0
        while True:
            reuse.begin()
            reuse.taken = reuse.promises(LEFT / 2)
            if reuse.taken:
                break
            waited += 1
        reuse.taken = reuse.promises(1.0)  # too much was left
        waits.append(waited)
    assert waits == [0, 0, 1, 3, 7, 15, LONGEST_WAIT - 1, LONGEST_WAIT - 1]


def test_a_solve_that_ends_with_an_older_tangent_ends_the_waiting() -> None:
    reuse = reuse_after(LEFT / 2, 1.0)
    for _ in range(3):
        reuse.begin()
        reuse.taken = reuse.promises(LEFT / 2)
        assert reuse.taken
    reuse.begin()
    assert not reuse.taken


def test_linear_convergence_is_not_taken_for_quadratic() -> None:
    judge = Convergence(1e-9, 0.0)
    judge.accept(1.0, 1.0)
    nearly = {"residual": 1e-6, "force": 1.0, "decrement": 1e-10, "energy": 1.0}
    assert judge.reason(**nearly) is not None
    assert judge.reason(**nearly, left=0.01) is None
    assert judge.reason(**nearly, left=1e-6) is not None


def counted(march: Callable[[], list[Step]]) -> tuple[list[Step], int]:
    """Return the steps of a march, and how many tangents were formed for them."""
    formed, form = [0], NewtonSolver.form_tangent

    def counting(self: NewtonSolver, x: object) -> None:
        formed[0] += 1
        form(self, x)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(NewtonSolver, "form_tangent", counting)
        return march(), formed[0]


def sliding_cycle(options: SolverOptions) -> list[Step]:
    """Return the steps of a cycle of slip friction."""
    model = scenes.model(scenes.sheet(), SLIDING, scenes.PROTOTYPE_TWO_STEPS)
    return scenes.march(model, program_of(cycle(0.0, 0.04, 0.25, 80)), "bdf2", options=options)


def test_a_predicted_step_forms_one_tangent_and_ends_where_newtons_method_does() -> None:
    few, formed = counted(lambda: sliding_cycle(SolverOptions()))
    own, each = counted(lambda: sliding_cycle(SolverOptions(keep_from=inf)))
    print(f"\n{len(own) - 1} steps: {formed} tangents, one for each iteration {each}")
    assert each >= 2 * (len(own) - 1)
    assert formed < 1.2 * (len(own) - 1)
    assert formed == sum(s.tangents for s in few)
    assert each == sum(s.tangents for s in own) == sum(s.iterations for s in own)
    assert np.mean([s.iterations for s in few[1:]]) <= 3.5
    peak = max(abs(s.reactions["right"][0]) for s in own)
    for found, expected in zip(few, own, strict=True):
        assert found.reactions["right"] == pytest.approx(
            expected.reactions["right"], abs=1e-8 * peak
        )
    assert few[-1].dissipated == pytest.approx(own[-1].dissipated, rel=1e-8)


def test_petsc_logs_the_tangents_that_are_formed() -> None:
    PETSc.Log.begin()
    event = PETSc.Log.Event(TANGENT)
    before = event.getPerfInfo()["count"]
    steps = sliding_cycle(SolverOptions())
    formed = event.getPerfInfo()["count"] - before
    assert formed == sum(s.tangents for s in steps) < sum(s.iterations for s in steps)


@pytest.mark.parametrize("numerics", [scenes.PROTOTYPE, Numerics(3)], ids=["P2", "P3"])
def test_a_large_step_from_rest_is_newtons_alone(numerics: Numerics) -> None:
    """Its forces fall by orders while yarns still turn, so that they tell little of tangents."""
    program, marches = program_of([ramp(0.0, 0.1, 1.0, 1)]), []
    for options in (SolverOptions(), SolverOptions(keep_from=inf)):
        model = scenes.model(scenes.sheet(), scenes.BONDED, numerics)
        made = partial(scenes.march, model, program, "backward-euler", options=options)
        marches.append(counted(made))
    (steps, formed), (own, each) = marches
    print(f"\n{steps[-1].iterations} iterations, {formed} tangents")
    assert formed == each and steps[-1].iterations == own[-1].iterations
    assert own[-1].iterations >= 4  # it is a large step
