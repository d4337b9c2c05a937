import subprocess
import sys
from pathlib import Path

import pytest
from mpi4py import MPI

from tests.report.sample import make
from wovenfab.parallel import child_environment
from wovenfab.record.results import draw_in_subprocess


@pytest.mark.slow
def test_pictures_are_drawn_in_another_process(small: Path) -> None:
    pictures = draw_in_subprocess(small)
    assert pictures.warning is None
    assert [path.name for path in pictures.paths] == ["loop.png", "loop.svg", "deformed.png"]
    assert all(path.exists() for path in pictures.paths)


def test_what_fails_becomes_a_warning_that_names_reason_and_remedy(small: Path) -> None:
    (small / "history.csv").unlink()
    pictures = draw_in_subprocess(small)
    assert pictures.warning is not None
    assert "history.csv" in pictures.warning
    assert f"wovenfab report {small}" in pictures.warning


@pytest.mark.slow
def test_what_could_be_drawn_is_kept(small: Path) -> None:
    (small / "fields.h5").write_bytes(b"no HDF5")
    pictures = draw_in_subprocess(small)
    assert [path.name for path in pictures.paths] == ["loop.png", "loop.svg"]
    assert pictures.warning is not None


def test_drawing_that_takes_too_long_is_given_up(small: Path) -> None:
    pictures = draw_in_subprocess(small, patience=0.01)
    assert pictures.paths == ()
    assert "not ready after 0.01 s" in str(pictures.warning)


@pytest.mark.mpi
def test_one_rank_draws_and_no_other(shared_path: Path) -> None:
    comm = MPI.COMM_WORLD
    directory = shared_path / "results"
    if comm.rank == 0:
        make(directory, [0.03], placements=1, every=40)
    comm.Barrier()
    pictures = draw_in_subprocess(directory)
    assert pictures.warning is None
    assert len(pictures.paths) == (3 if comm.rank == 0 else 0)


@pytest.mark.mpi
def test_the_other_process_is_no_rank() -> None:
    program = "from mpi4py import MPI; print(MPI.COMM_WORLD.size)"
    said = subprocess.run(
        [sys.executable, "-c", program],
        env=child_environment(),
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert said.stdout.strip() == "1"
