"""Rates from unequal steps."""

from __future__ import annotations

import numpy as np
import pytest

from wovenfab.stepping.schemes import SCHEMES, end_weights


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_rates_are_exact_for_polynomials_whatever_the_steps(order: int) -> None:
    random = np.random.default_rng(31)
    for _ in range(100):
        steps = 10.0 ** random.uniform(-2, 1, order)
        motion = np.polynomial.Polynomial(random.standard_normal(order + 1))
        now = random.uniform(-1, 1)
        values = motion(now - np.concatenate([[0.0], np.cumsum(steps)]))
        weights = end_weights(steps)
        round_off = 1e-12 * (np.abs(weights) @ np.abs(values))
        assert np.dot(weights, values) == pytest.approx(motion.deriv()(now), abs=round_off)


def test_equal_steps_give_the_textbook_weights() -> None:
    assert end_weights((0.5, 0.5)) == pytest.approx((3.0, -4.0, 1.0), rel=1e-15)
    bdf3 = (11 / 6, -3.0, 3 / 2, -1 / 3)
    assert end_weights((1.0, 1.0, 1.0)) == pytest.approx(bdf3, rel=1e-15)


@pytest.mark.parametrize("name", SCHEMES)
def test_a_scheme_does_not_look_back_beyond_a_jump_of_the_velocity(name: str) -> None:
    scheme, step = SCHEMES[name], 0.2
    now, last, *older = scheme.weights([step])
    stage = scheme.stage * step
    assert (now, last) == pytest.approx((1 / stage, -1 / stage), rel=1e-15)
    assert older == [0.0] * (scheme.memory - 1)
    assert len(scheme.weights([step, 0.1, 0.3, 0.2])) == scheme.memory + 1


@pytest.mark.parametrize("name", SCHEMES)
def test_stage_rates_have_the_schemes_order_on_a_smooth_motion(name: str) -> None:
    scheme, errors = SCHEMES[name], []
    for step in (0.02, 0.01):
        steps = [step, 1.7 * step, 1.2 * step]
        weights = scheme.weights(steps)
        times = 1.0 - np.concatenate([[0.0], np.cumsum(steps)])[: len(weights)]
        times[1] = 1.0 - scheme.stage * step
        errors.append(abs(np.dot(weights, np.sin(times)) - np.cos(1.0)))
    # The midpoint's rate over half a step is of order one at the stage itself, but it is
    # the mean rate of the whole step, whose middle the stage is.
    expected = 1 if scheme.stage < 1 else scheme.order
    assert np.log2(errors[0] / errors[1]) == pytest.approx(expected, abs=0.1)
