"""A solver with a part taken out fails the rows that the part is there for, and others not."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import pytest

from benchmarks.hard.alternatives import Unlimited, Unsearched
from benchmarks.hard.families import row_named
from benchmarks.hard.row import Row, problems

Change = Callable[[Row], Row]


def plain(row: Row) -> Row:
    """Return the row with Newton's plain tangent."""
    return replace(row, setting=row.setting.but("solver.tangent=plain"))


def unlimited(row: Row) -> Row:
    """Return the row with steps that may cross the families."""
    return row.with_solver(Unlimited)


def unsearched(row: Row) -> Row:
    """Return the row without line search."""
    return row.with_solver(Unsearched)


def missed(change: Change, name: str) -> str:
    """Return what keeps a small row from passing with a changed solver; empty if nothing."""
    row = change(row_named(name).small())
    return "; ".join(problems(row, row.run()))


@pytest.mark.parametrize(
    ("change", "name", "problem"),
    [
        pytest.param(plain, "large-p4-12mm-graded", "worst|cutbacks", marks=pytest.mark.slow),
        pytest.param(unlimited, "tunnelling", "margin", marks=pytest.mark.slow),
        (unlimited, "locking-end", "finished, but should have stopped"),
        pytest.param(unsearched, "locking-one-step", "margin", marks=pytest.mark.slow),
    ],
)
def test_a_part_that_is_missing_fails_the_rows_it_is_there_for(
    change: Change, name: str, problem: str
) -> None:
    assert re.search(problem, missed(change, name))


@pytest.mark.parametrize(
    ("change", "name"),
    [
        pytest.param(plain, "locking-1x2-400", marks=pytest.mark.slow),
        pytest.param(unlimited, "locking-1x2-400", marks=pytest.mark.slow),
        (unsearched, "locking-end"),
    ],
)
def test_rows_that_do_not_need_the_part_pass_without_it(change: Change, name: str) -> None:
    assert missed(change, name) == ""
