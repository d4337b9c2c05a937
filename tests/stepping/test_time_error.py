"""The error of a step in time, and steps that adapt to it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from tests import scenes
from wovenfab.stepping.program import Program, cycle, program_of, ramp
from wovenfab.stepping.schemes import LEAST, SCHEMES, end_weights, rate_error
from wovenfab.stepping.step import Step
from wovenfab.stepping.time_stepper import TimeStepper


@pytest.mark.parametrize("steps", [(0.1, 0.1, 0.1), (0.05, 0.2, 0.1), (0.1, 0.2, 0.1, 0.3)])
def test_a_polynomial_of_one_degree_more_has_its_true_rate(steps: tuple[float, ...]) -> None:
    motion = np.polynomial.Polynomial([1.0, 3.0, -1.0, 2.0, 1.0][: len(steps) + 1])
    now, *states = (np.array([motion(0.7 - age)]) for age in (0.0, *np.cumsum(steps)))
    weights = end_weights(steps[:-1])
    rate = sum(w * s for w, s in zip(weights, (now, *states), strict=False))
    true = motion.deriv()(0.7)
    assert abs(rate - true) > 1e-3
    assert rate + rate_error(now, states, steps) == pytest.approx(true)


@pytest.mark.parametrize(
    "ratios", [(2.0, 1.0, 1.0), (2.0, 1.0, 1.0, 0.5), (2.0, 1.0, 1.0, LEAST), (1.5,)]
)
def test_bdf_of_third_order_is_zero_stable_where_it_doubles_after_even_steps(
    ratios: tuple[float, ...],
) -> None:
    """Perturbations of a constant solution die away: all roots but one are in the unit circle."""
    steps, product = [1.0, 1.0, 1.0], np.eye(3)
    for _ in range(4):
        product = np.eye(3)
        for ratio in ratios:
            steps = [ratio * steps[0], *steps[:2]]
            now, *before = end_weights(steps)
            advance = np.eye(3, k=-1)
            advance[0] = -np.array(before) / now
            product = advance @ product
    roots = sorted(abs(np.linalg.eigvals(product)))
    print(f"\n{ratios}: {roots}")
    assert roots[-1] == pytest.approx(1)
    assert roots[-2] < 0.95


def run(program: Program, tolerance: float | None) -> list[Step]:
    names = (*scenes.COUPLED, "slip_friction")
    model = scenes.model(scenes.sheet(0.6), names, scenes.PROTOTYPE_TWO_STEPS)
    result = scenes.run(model, program, None, 1e-4, "bdf2", tolerance=tolerance)
    assert result.failure is None
    return result.steps


def lost(program: Program) -> float:
    """Return the energy (J) dissipated with the planned steps."""
    return scenes.lost(run(program, None)[-1])


def test_smaller_tolerances_make_smaller_errors_and_hit_reversals() -> None:
    program = program_of(cycle(0.0, 0.02, 0.25, 8))
    best = lost(program_of(cycle(0.0, 0.02, 0.25, 320)))
    errors, counts = [], []
    for tolerance in (0.03, 0.003):
        steps = run(program, tolerance)
        planned = [s.time for s in steps if s.milestone is not None]
        assert planned == [m.time for m in program.milestones]
        assert max(s.displacement for s in steps) == 0.02
        true, estimate = scenes.lost(steps[-1]) - best, steps[-1].dissipated_error
        print(f"{tolerance}: {len(steps)} steps, error {true:.3g} J, embedded {estimate:.3g} J")
        assert 0.5 < estimate / true < 3
        errors.append(true / best)
        counts.append(len(steps))
    assert counts[1] > 2 * counts[0]
    assert abs(errors[1]) < abs(errors[0]) / 4
    assert abs(errors[0]) < 0.05


@pytest.mark.slow
def test_steps_shrink_where_friction_lets_go_and_grow_where_nothing_happens() -> None:
    """After a ramp the sheet creeps for about half a second, and then rests."""
    program = program_of([ramp(0.0, 0.02, 0.1, 1), ramp(0.02, 0.02, 10.0, 2)])
    steps = run(program, 0.01)
    early = [b.time - a.time for a, b in pairwise(steps) if 0.1 < b.time < 0.4]
    late = [b.time - a.time for a, b in pairwise(steps) if b.time > 5.2]
    print(f"{len(steps)} steps, {min(early):.3g} s to {max(late):.3g} s")
    assert max(late) > 20 * min(early)
    number = (len(steps) - 1) // 2
    pull, rest = (0.0, 0.02, 0.1), (0.02, 0.02, 10.0)
    equal = program_of([ramp(*pull, number), ramp(*rest, number)])
    fine = program_of([ramp(*pull, 40), ramp(0.02, 0.02, 2.0, 400), ramp(0.02, 0.02, 8.0, 2)])
    adapted, of_equal, best = scenes.lost(steps[-1]), lost(equal), lost(fine)
    print(f"{adapted:.4f} J, with as many equal steps {of_equal:.4f} J, best {best:.4f} J")
    assert abs(adapted - best) < abs(of_equal - best) / 3


def test_without_rates_steps_are_as_planned() -> None:
    model = scenes.model(scenes.sheet(0.6), scenes.BONDED, scenes.PROTOTYPE)
    equilibrium = scenes.solver(model)
    program = program_of([ramp(0.0, 0.01, 1.0, 3)])
    stepper = TimeStepper(equilibrium, program, SCHEMES["bdf2"], 1 / 64, tolerance=1e-6)
    assert not stepper.measures_errors
    assert [s.time for s in stepper.steps()] == [m.time for m in program.milestones]
    equilibrium.destroy()
