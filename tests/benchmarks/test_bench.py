"""The frame of the measurements: all is printed, and a missed figure is the exit code."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from benchmarks.__main__ import SECTIONS, main
from benchmarks.figure import Figure


def section(value: float, at_least: bool) -> Callable[[], list[Figure]]:
    return lambda: [Figure("speed", value, 2.0, "x", "of something", at_least)]


@pytest.mark.parametrize(
    ("value", "at_least", "kept"),
    [(1.9, False, True), (2.1, False, False), (2.1, True, True), (1.9, True, False)],
)
def test_a_figure_is_within_its_limit_on_the_right_side_of_its_limit(
    value: float, at_least: bool, kept: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([], {"one": section(value, at_least)}) == (0 if kept else 1)
    bound, verdict = "at least" if at_least else "at most", "kept" if kept else "MISSED"
    assert f"speed: {value} x, {bound} 2 x: {verdict}\n" in capsys.readouterr().out


def test_all_sections_are_measured_after_a_missed_figure_and_chosen_ones_alone(
    capsys: pytest.CaptureFixture[str],
) -> None:
    sections = {"bad": section(1.0, at_least=True), "good": section(3.0, at_least=True)}
    assert main([], sections) == 1
    assert capsys.readouterr().out.count("speed: ") == 2
    assert main(["good"], sections) == 0
    assert capsys.readouterr().out.count("speed: ") == 1


def test_an_unknown_section_is_named_with_those_that_there_are(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["speed"]) == 2
    output = capsys.readouterr().out
    assert "'speed'" in output
    assert all(name in output for name in SECTIONS)
