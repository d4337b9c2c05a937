"""Settings for all tests."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest
from mpi4py import MPI


@pytest.fixture(autouse=True)
def _ranks_in_step(request: pytest.FixtureRequest) -> Iterator[None]:
    """PETSc destroys objects collectively: let all ranks collect at the same point."""
    yield
    if request.node.get_closest_marker("mpi"):
        gc.collect()
        MPI.COMM_WORLD.barrier()
