"""Rates from unequal steps."""

from __future__ import annotations

import numpy as np
import pytest

from wovenfab.stepping.schemes import SCHEMES, end_weights


def test_three_point_rates_are_exact_for_quadratics_whatever_the_steps() -> None:
    random = np.random.default_rng(31)
    for _ in range(200):
        step, before = 10.0 ** random.uniform(-3, 1, 2)
        c0, c1, c2 = random.standard_normal(3)
        now = random.uniform(-1, 1)
        times = np.array([now, now - step, now - step - before])
        values, weights = c0 + c1 * times + c2 * times**2, end_weights(step, before)
        round_off = 1e-13 * (np.abs(weights) @ np.abs(values))
        exact = c1 + 2 * c2 * now
        assert np.dot(weights, values) == pytest.approx(exact, rel=1e-12, abs=round_off)


def test_equal_steps_give_the_textbook_weights() -> None:
    assert end_weights(0.5, 0.5) == pytest.approx((3.0, -4.0, 1.0), rel=1e-15)


@pytest.mark.parametrize("name", SCHEMES)
def test_a_scheme_does_not_look_back_beyond_a_jump_of_the_velocity(name: str) -> None:
    scheme, step = SCHEMES[name], 0.2
    now, last, *older = scheme.weights(step, None)
    stage = scheme.stage * step
    assert (now, last) == pytest.approx((1 / stage, -1 / stage), rel=1e-15)
    assert older == [0.0] * (scheme.memory - 1)
    assert len(scheme.weights(step, 0.1)) == scheme.memory + 1


@pytest.mark.parametrize("name", SCHEMES)
def test_stage_rates_have_the_schemes_order_on_a_smooth_motion(name: str) -> None:
    scheme, errors = SCHEMES[name], []
    for step in (0.02, 0.01):
        before = 1.7 * step
        weights = scheme.weights(step, before)
        times = np.array([1.0, 1.0 - scheme.stage * step, 1.0 - step - before])[: len(weights)]
        if scheme.stage == 1:
            times[1] = 1.0 - step
        errors.append(abs(np.dot(weights, np.sin(times)) - np.cos(1.0)))
    # The midpoint's rate over half a step is of order one at the stage itself, but it is
    # the mean rate of the whole step, whose middle the stage is.
    expected = 1 if scheme.stage < 1 else scheme.order
    assert np.log2(errors[0] / errors[1]) == pytest.approx(expected, abs=0.1)
