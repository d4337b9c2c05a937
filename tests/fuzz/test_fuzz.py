"""Some mutated cases and damaged results; ``make fuzz`` tries many."""

from __future__ import annotations

from tests.fuzz import geometries, measured, results
from tests.fuzz.__main__ import GOOD, fuzz


def test_mutated_cases_are_accepted_or_refused_in_words() -> None:
    # Other tests share the processors: only a check without an end is too long here.
    assert fuzz(range(24), seconds=60.0).keys() <= GOOD


def test_mutated_measured_and_fit_files_are_accepted_or_refused_in_words() -> None:
    counts = measured.fuzz(range(200))
    assert counts.keys() == {"accepted", "refused"}


def test_mutated_geometry_files_are_accepted_or_refused_in_words() -> None:
    assert geometries.fuzz(range(12), seconds=60.0).keys() <= GOOD


def test_damaged_results_are_read_or_refused_in_words_and_left_as_they_are() -> None:
    assert results.fuzz(range(6)).keys() <= results.GOOD
