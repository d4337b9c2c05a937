"""Some mutated cases and damaged results; ``make fuzz`` tries many."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzz import geometries, measured, results
from tests.fuzz.__main__ import GOOD, check, fuzz
from tests.fuzz.geometries import CASE

pytestmark = pytest.mark.slow


def test_mutated_cases_are_accepted_or_refused_in_words() -> None:
    assert fuzz(range(24)).keys() <= GOOD


def test_mutated_measured_and_fit_files_are_accepted_or_refused_in_words() -> None:
    counts = measured.fuzz(range(200))
    assert counts.keys() == {"accepted", "refused"}


def test_mutated_geometry_files_are_accepted_or_refused_in_words() -> None:
    assert geometries.fuzz(range(12)).keys() <= GOOD


def test_damaged_results_are_read_or_refused_in_words_and_left_as_they_are() -> None:
    assert results.fuzz(range(6)).keys() <= results.GOOD


def test_a_command_without_an_end_is_told_by_the_time_of_its_processor(tmp_path: Path) -> None:
    loop = "DefineConstant[ n = 1 ]; For i In {1:1e9} n = n + 1; EndFor Line(1) = {1, 2};\n"
    (tmp_path / "sheet.geo").write_text(loop)
    case = CASE.format(suffix=".geo", size="", edges="")
    (tmp_path / "case.yaml").write_text(case)
    assert check(tmp_path / "case.yaml", 0.3).kind == "hang"
    (tmp_path / "sheet.geo").write_text("")
    assert check(tmp_path / "case.yaml", 60.0).kind == "refused"
