"""The quick version of every hard case keeps its thresholds."""

from __future__ import annotations

import math

import pytest
from mpi4py import MPI

from benchmarks.hard.families import families
from benchmarks.hard.row import Row, problems

ROWS = [row.small() for family in families() for row in family.rows]


@pytest.mark.parametrize("row", [r for r in ROWS if r.ranks == 1], ids=lambda row: row.name)
def test_a_hard_case_passes_or_stops_where_it_should(row: Row) -> None:
    figures = row.run()
    assert problems(row, figures) == []
    for series in figures.series.values():
        numbers = [x for x in series if isinstance(x, float)] if isinstance(series, list) else []
        assert all(map(math.isfinite, numbers))


@pytest.mark.mpi
@pytest.mark.mpi4
@pytest.mark.parametrize("row", [r for r in ROWS if r.ranks > 1], ids=lambda row: row.name)
def test_a_hard_case_on_ranks_passes(row: Row) -> None:
    figures = MPI.COMM_WORLD.bcast(row.run())  # the first rank has them
    assert problems(row, figures) == []


def test_names_and_numbers_are_used_once() -> None:
    names = [row.name for row in ROWS]
    assert len(names) == len(set(names))
    numbers = [family.number for family in families()]
    assert numbers == sorted(set(numbers))
