"""Verdicts follow from thresholds, results are stored, and a row can neither hang nor lie."""

from __future__ import annotations

from dataclasses import asdict, replace
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hard import results
from benchmarks.hard.crossing import exact_crossing
from benchmarks.hard.families import families, row_named
from benchmarks.hard.families.scales import Scale
from benchmarks.hard.grids import crossed
from benchmarks.hard.page import page, table
from benchmarks.hard.results import Result, row_fingerprint, run_row
from benchmarks.hard.row import Bound, Figures, Row, Setting, is_good, problems, together, verdict
from wovenfab.study.runner import Store

GOOD = Figures(100, 4, 3.0, 5, 0, 0.5, 1e-3).with_checks(difference=1e-5)
ROW = Row(
    name="some",
    title="a case",
    hard="it is hard",
    remedy="a remedy",
    setting=Setting("bonded-1x3", ("program.steps=2",)),
    measure=lambda setting: GOOD,
    bounds=(Bound("worst", most=5), Bound("margin", least=0.1), Bound("difference", most=1e-3)),
    quick=("program.steps=1",),
    quick_bounds=(Bound("worst", most=6),),
)


def test_figures_within_the_bounds_pass_and_the_checks_are_shown() -> None:
    assert problems(ROW, GOOD) == []
    assert verdict(ROW, GOOD) == "passed: difference 1e-05"


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"worst": 6}, "worst 6 > 5"),
        ({"margin": 0.01}, "margin 0.01 < 0.1"),
        ({"margin": None}, "margin is not a number"),
        ({"margin": nan}, "margin is not a number"),
        ({"checks": {"difference": 0.1}}, "difference 0.1 > 0.001"),
        ({"checks": {"difference": nan}}, "difference is not a number"),
        ({"checks": {"difference": inf}}, "difference is not a number"),
        ({"checks": {}}, "difference is not a number"),
        ({"end": "no equilibrium at t = 1 s"}, "stopped: no equilibrium at t = 1 s"),
    ],
)
def test_each_figure_that_misses_its_bound_fails_the_row(
    change: dict[str, object], problem: str
) -> None:
    figures = replace(GOOD, **change)  # type: ignore[arg-type]
    assert problems(ROW, figures) == [problem]
    assert verdict(ROW, figures) == f"**failed**: {problem}"
    assert not is_good(ROW, figures)


def test_a_row_that_must_stop_fails_where_it_finishes_or_names_another_cause() -> None:
    row = replace(ROW, stops="the sheet locks")
    assert problems(row, GOOD) == ["finished, but should have stopped"]
    other = replace(GOOD, end="the stiffness is singular")
    assert "another reason" in problems(row, other)[0]
    right = replace(GOOD, end="Probable cause: the sheet locks: …")
    assert verdict(row, right) == "stopped with a diagnosis: difference 1e-05"


def test_a_row_that_gave_nothing_fails() -> None:
    assert verdict(ROW, None, "no end within 3 s") == "**failed**: no end within 3 s"
    assert not is_good(ROW, None)


def test_the_small_version_changes_the_case_and_only_the_bounds_it_names() -> None:
    small = ROW.small()
    assert small.setting.case.program[0].steps == 1  # type: ignore[union-attr]
    assert ROW.setting.case.program[0].steps == 2  # type: ignore[union-attr]
    assert {b.figure: b.most or b.least for b in small.bounds} == {
        "worst": 6, "margin": 0.1, "difference": 1e-3
    }  # fmt: skip


def test_together_keeps_the_worst_of_all_runs() -> None:
    bad = replace(GOOD, worst=9, margin=0.01, imbalance=0.2, cutbacks=3, end="stopped", steps=12)
    both = together([GOOD, bad], {})
    assert (both.worst, both.margin, both.imbalance) == (9, 0.01, 0.2)
    assert (both.cutbacks, both.end, both.steps) == (3, "stopped", 16)


def test_a_row_is_run_again_only_if_its_case_or_the_code_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result, store = Result(GOOD, "", 1.5, 0.2), Store(tmp_path / "a")
    assert Result.of(store.load(ROW.name)) is None
    store.save(ROW.name, row_fingerprint(ROW), asdict(result))
    assert Result.of(store.load(ROW.name, row_fingerprint(ROW))) == result
    assert row_fingerprint(ROW.small()) != row_fingerprint(ROW)
    monkeypatch.setattr(results, "SOURCES", ())
    assert store.load(ROW.name, row_fingerprint(ROW)) is None
    assert Result.of(store.load(ROW.name)) == result


@pytest.mark.slow
def test_a_row_that_hangs_or_breaks_is_a_failure_and_not_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    row = row_named("large-p2-50mm")
    monkeypatch.setattr(results, "QUICK_LIMIT", 0.05)
    late = run_row(row, quick=True)
    assert late.figures is None and late.failure == "no end within 0.05 s"
    monkeypatch.setattr(results, "QUICK_LIMIT", 60.0)
    gone = run_row(replace(row, name="no-such-row"), quick=True)
    assert gone.figures is None and "no-such-row" in gone.failure


def test_the_table_has_a_line_for_each_row_that_ran() -> None:
    family = replace(families()[0], rows=(ROW, replace(ROW, name="other")))
    lines = table([family], {"some": Result(GOOD)}).splitlines()
    assert len(lines) == 3
    assert lines[2].count("|") == lines[0].count("|") == lines[1].count("|")
    assert "passed" in lines[2] and "3.0, 5" in lines[2]
    text = page([family], {"some": Result(GOOD)}, "## What else was tried\n")
    assert text.count("![") == 1 and "What else" in text


@pytest.mark.parametrize(
    ("f", "df", "crossing"),
    [
        ([[1, 0], [0, 1]], [[0, 1], [1, 0]], 1.0),  # 1 - s²
        ([[1, 0], [0, 1]], [[-0.5, 0], [0, 0]], 2.0),  # linear
        ([[1, 0], [0, 1]], [[0, 1], [-1, 0]], inf),  # a rotation
        ([[1, 0], [0, 1]], [[-1, 0], [0, -1]], 1.0),  # a double root
        ([[1, 0], [0, 1]], [[1e-9, 0], [0, -1]], 1.0),
    ],
)
def test_the_exact_crossing(f: object, df: object, crossing: float) -> None:
    assert exact_crossing(np.array(f, float), np.array(df, float)) == crossing


def test_the_scale_of_a_unit_follows_from_its_dimensions() -> None:
    scale = Scale(length=10.0, force=3.0, time=7.0)
    expected = {"N/m": 0.3, "N*m": 30.0, "N/m^3": 3e-3, "s/m": 0.7, "s": 7.0, "1": 1.0}
    assert {u: scale.of(u) for u in expected} == pytest.approx(expected, rel=1e-12)


def test_a_grid_of_slivers_has_the_angle_it_is_made_with_and_covers_the_rectangle() -> None:
    for angle in (45.0, 10.0, 1.0):
        grid = crossed(0.9, 0.3, 0.1, angle)
        assert grid.least_angle == pytest.approx(angle, rel=1e-9)
        a, b, c = grid.points[grid.cells].transpose(1, 0, 2)
        (x, y), (u, v) = (b - a).T, (c - a).T
        assert ((x * v - y * u) / 2).sum() == pytest.approx(0.27, rel=1e-12)
    assert {name: len(e) for name, e in grid.edges.items()} == {
        "bottom": 9, "right": 3, "top": 9, "left": 3
    }  # fmt: skip


def test_every_row_has_a_fingerprint_and_its_quick_version_another() -> None:
    rows = [row for family in families() for row in family.rows]
    assert len(rows) == 60
    for row in rows:
        quick = row_fingerprint(row.small())
        assert (quick != row_fingerprint(row)) == bool(row.quick)
