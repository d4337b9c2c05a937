"""The quick version of every hard case keeps its thresholds."""

from __future__ import annotations

import math

import pytest
from mpi4py import MPI

from benchmarks.hard.families import families
from benchmarks.hard.measurement import Measurement
from benchmarks.hard.row import Row, Setting, problems

pytestmark = pytest.mark.slow

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


def test_steps_of_a_hard_case_adapt_to_its_tolerance() -> None:
    coarse = ("program.amplitudes=[20 mm]", "time.steps_per_cycle=8", "discretisation.degree=2")
    setting = Setting("bias-1x3", (*coarse, "discretisation.mesh_size=300 mm"))
    counts = []
    for tolerance in ("null", "0.05", "0.01"):
        measurement = Measurement(setting.but(f"time.tolerance={tolerance}")).run()
        counts.append(len(measurement.steps) - 1)
        measurement.destroy()
    assert 8 == counts[0] < counts[1] < counts[2]


def test_names_and_numbers_are_used_once() -> None:
    names = [row.name for row in ROWS]
    assert len(names) == len(set(names))
    numbers = [family.number for family in families()]
    assert numbers == sorted(set(numbers))
