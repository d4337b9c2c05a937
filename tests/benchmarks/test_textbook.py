"""The laws by which the textbook's time is extrapolated, against closed forms."""

from __future__ import annotations

import pytest

from benchmarks.textbook import Law, cheapest


def test_a_power_law_is_found() -> None:
    law = Law.fitted([1.0, 2.0, 4.0], [3.0, 6.0 * 2**0.5, 24.0])
    assert (law.factor, law.power) == pytest.approx((3.0, 1.5))
    assert law(9.0) == pytest.approx(81.0)


def test_the_cheapest_run_shares_the_error_as_its_optimum_does() -> None:
    """Errors h and 1/n, time n / h²: the optimum has two thirds of the error in space."""
    space, time = [Law(1.0, 1.0), Law(0.1, 1.0)], [Law(0.1, -1.0), Law(1.0, -1.0)]
    size, steps, seconds = cheapest(0.03, space, time, lambda h, n: n / h**2)
    assert (size, steps) == pytest.approx((0.02, 100.0), rel=0.02)
    assert seconds == pytest.approx(100 / 0.02**2, rel=1e-3)
