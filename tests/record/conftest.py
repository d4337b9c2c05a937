"""A directory that all ranks share."""

from pathlib import Path

import pytest
from mpi4py import MPI


@pytest.fixture
def shared_path(tmp_path: Path) -> Path:
    """Rank 0's temporary directory, on all ranks."""
    return MPI.COMM_WORLD.bcast(tmp_path, root=0)
