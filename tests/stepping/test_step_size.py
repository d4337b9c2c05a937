"""Steps are cut where they fail, not more often than needed, and planned times are hit."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import pytest

from wovenfab.stepping.step import CUT, GROWTH, StepSizeControl


def walk(
    planned: list[float], iterations: Callable[[float, float], int | None], smallest: float = 1e-3
) -> tuple[list[float], int]:
    """Return the times reached and the number of failures.

    Args:
        planned: Planned times, from 0.
        iterations: Of a step from a time (s) of a length (s); None if it fails.
        smallest: Share of a planned step below which cutting ends.
    """
    step_size, times, failures = StepSizeControl(smallest), [planned[0]], 0
    for start, end in pairwise(planned):
        while times[-1] < end:
            until = step_size.next(times[-1], end)
            length = until - times[-1]
            taken = iterations(times[-1], length)
            if taken is not None:
                step_size.accepted(length, taken)
                times.append(until)
                continue
            failures += 1
            if not step_size.reduce(length, end - start):
                return times, failures
    return times, failures


#: Tangents of a step that is easy, and of one that is not.
EASY, HARD = 2, 8
EVEN = [i / 10 for i in range(11)]
UNEVEN = [0.0, 0.1, 0.13, 0.5, 0.501, 1.0]
in_each = pytest.mark.parametrize("planned", [EVEN, UNEVEN], ids=["even", "uneven"])


@in_each
def test_steps_that_never_fail_are_the_planned_ones(planned: list[float]) -> None:
    assert walk(planned, lambda *_: HARD) == (planned, 0)


@in_each
@pytest.mark.parametrize("longest", [0.7, 0.06, 0.011])
def test_planned_times_are_hit_bit_for_bit(planned: list[float], longest: float) -> None:
    times, _ = walk(planned, lambda _, length: 3 if length <= longest else None)
    assert set(planned) <= set(times)
    lengths = [b - a for a, b in pairwise(times)]
    assert max(lengths) <= longest
    inner = [b - a for a, b in pairwise(times) if not {a, b} <= set(planned)]
    assert min(inner, default=longest) > longest * CUT / GROWTH


def test_what_was_learnt_is_kept_beyond_the_planned_time() -> None:
    _, failures = walk(EVEN, lambda _, length: HARD if length <= 0.04 else None)
    assert failures <= 8  # not twice in each planned step


def test_steps_grow_back_to_the_planned_ones_where_they_are_easy() -> None:
    def hard_at_first(time: float, length: float) -> int | None:
        return EASY if time > 0.05 else HARD if length <= 0.02 else None

    times, failures = walk(EVEN, hard_at_first)
    assert failures == 3
    assert times[-8:] == EVEN[-8:]


def test_steps_that_stay_hard_grow_too_in_the_end() -> None:
    times, failures = walk(EVEN, lambda t, h: None if t < 0.05 and h > 0.01 else HARD)
    assert failures <= 5
    assert len(times) < 40  # 100 without growth


@pytest.mark.parametrize(("tangents", "steps"), [(3, 1), (4, 5)])
def test_a_cut_length_is_doubled_after_a_step_of_three_tangents_or_five_harder_ones(
    tangents: int, steps: int
) -> None:
    """Newton's method that converges quadratically from the start takes three."""
    step_size, lengths = StepSizeControl(1e-3), list[float]()
    step_size.reduce(1 / 32, 1.0)
    while sum(lengths) < 0.5:
        lengths.append(step_size.next(sum(lengths), 1.0) - sum(lengths))
        step_size.accepted(lengths[-1], tangents)
    assert lengths[:steps] == pytest.approx([1 / 64] * steps, rel=0.1)
    assert lengths[steps] > 1.8 / 64


def test_what_is_sought_is_bisected_without_growth_and_forgotten_once_passed() -> None:
    step_size = StepSizeControl(1e-3)
    for length in (1.0, 0.5):
        assert step_size.next(0.0, 1.0) == length
        step_size.bisect(length, length)
    assert step_size.next(0.0, 1.0) == 0.25
    step_size.accepted(0.25, 1)  # easy, but the way to 0.5 is known to be blocked
    assert step_size.next(0.25, 1.0) == 0.5
    step_size.accepted(0.25, 1)  # it was not
    assert step_size.next(0.5, 1.0) == 1.0


def test_beyond_what_was_found_steps_grow_from_where_they_are() -> None:
    step_size = StepSizeControl(1e-3)
    step_size.bisect(0.01, 0.01)
    step_size.bracketed(0.01)
    step_size.accepted(0.01, 1)
    assert step_size.next(0.01, 1.0) - 0.01 == pytest.approx(0.02, rel=0.02)


def test_cutting_ends_at_the_smallest_share_of_the_planned_step() -> None:
    times, failures = walk([0.0, 1.0, 2.0], lambda *_: None, smallest=0.2)
    assert times == [0.0]
    assert failures == 3  # 1, 1/2, 1/4
