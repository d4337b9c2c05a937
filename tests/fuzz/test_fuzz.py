"""Some mutated cases and damaged results; ``make fuzz`` tries many."""

from __future__ import annotations

from tests.fuzz import results
from tests.fuzz.__main__ import GOOD, fuzz


def test_mutated_cases_are_accepted_or_refused_in_words() -> None:
    # Other tests share the processors: only a check without an end is too long here.
    assert fuzz(range(24), seconds=60.0).keys() <= GOOD


def test_damaged_results_are_read_or_refused_in_words_and_left_as_they_are() -> None:
    assert results.fuzz(range(6)).keys() <= results.GOOD
