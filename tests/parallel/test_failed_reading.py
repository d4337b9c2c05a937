"""What the first rank cannot read ends all ranks."""

from __future__ import annotations

from pathlib import Path

import pytest
from mpi4py import MPI

from wovenfab.case import read_case
from wovenfab.interface import execute
from wovenfab.record.reading import UnreadableResultsError
from wovenfab.record.results import CHECKPOINT, NothingToResumeError

pytestmark = [pytest.mark.mpi, pytest.mark.mpi4]
COMM = MPI.COMM_WORLD
CASE = Path(__file__).parents[2] / "configs" / "elastic-1x3.yaml"
SMALL = (
    *("discretisation.mesh_size=150 mm", "discretisation.degree=2", "output.pictures=false"),
    "program={type: ramp, to: 10 mm, steps: 2, velocity: 0.1 m/s}",
)


def test_a_history_that_cannot_be_read_ends_the_run_on_every_rank(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(directory: Path) -> None:
        raise UnreadableResultsError(f"{directory}: damaged on rank {COMM.rank}")

    monkeypatch.setattr("wovenfab.simulation.run.read_history", fail)
    directory: Path = COMM.bcast(tmp_path) / "run"
    with pytest.raises(UnreadableResultsError, match="damaged on rank 0"):
        execute(read_case(CASE, SMALL), directory, comm=COMM)


@pytest.mark.parametrize("name", [CHECKPOINT, pytest.param("history.csv", marks=pytest.mark.slow)])
def test_a_run_that_cannot_go_on_is_refused_on_every_rank(name: str, tmp_path: Path) -> None:
    directory: Path = COMM.bcast(tmp_path) / "run"
    case = read_case(CASE, SMALL)
    execute(case, directory, comm=COMM, until=0.04)
    if COMM.rank == 0:
        (directory / name).write_bytes(b"damaged")
        (directory / "checkpoint-earlier.h5").unlink(missing_ok=True)
    COMM.barrier()
    with pytest.raises(NothingToResumeError):
        execute(case, directory, comm=COMM, resume=True)
