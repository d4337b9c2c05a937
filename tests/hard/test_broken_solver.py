"""A solver with a part taken out fails the rows that the part is there for, and they alone."""

from __future__ import annotations

from dataclasses import replace

from wovenfab.hard.families import row_named
from wovenfab.hard.row import Row, problems


def found(row: Row) -> str:
    """Return what keeps a row from passing; empty if nothing does."""
    return "; ".join(problems(row, row.run()))


def small(name: str) -> Row:
    return row_named(name).small()


def plain(row: Row) -> Row:
    """Return the row with Newton's plain tangent."""
    return replace(row, setting=row.setting.but("solver.tangent=plain"))


def test_without_the_step_limit_states_tunnel() -> None:
    row = small("tunnelling")
    assert "margin" in found(row.with_controls(step_limit=False))
