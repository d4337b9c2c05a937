"""Settings for all tests."""

from __future__ import annotations

import gc
import logging
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest
from mpi4py import MPI

from wovenfab.model import assembly


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add an option by which FFCx writes all kernels itself, as with a version not compared."""
    parser.addoption("--plain-kernels", action="store_true", help="let FFCx write all kernels")


def pytest_configure(config: pytest.Config) -> None:
    """Let FFCx write all kernels of this process where that was asked for."""
    if config.getoption("--plain-kernels"):
        assembly.writing, assembly.way = nullcontext, "FFCx"


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Do not import files without tests for several ranks where only these are wanted.

    Every rank would import all of them at the same time.
    """
    if not config.option.markexpr.startswith("mpi") or collection_path.suffix != ".py":
        return None
    return True if "mark.mpi" not in collection_path.read_text(encoding="utf-8") else None


@pytest.fixture
def own_kernels(request: pytest.FixtureRequest) -> None:
    """Skip what is about kernels that FFCx does not write, where it writes all of them."""
    if request.config.getoption("--plain-kernels"):
        pytest.skip("FFCx writes all kernels")


@pytest.fixture
def shared_path(tmp_path: Path) -> Path:
    """Rank 0's temporary directory, on all ranks."""
    return MPI.COMM_WORLD.bcast(tmp_path, root=0)


@pytest.fixture(autouse=True)
def _log_as_before() -> Iterator[None]:
    """A command that a test has run chose where the log goes: the next test has its own."""
    package = logging.getLogger("wovenfab")
    level, propagate, handlers = package.level, package.propagate, package.handlers[:]
    yield
    package.level, package.propagate, package.handlers[:] = level, propagate, handlers


@pytest.fixture(autouse=True)
def _ranks_in_step(request: pytest.FixtureRequest) -> Iterator[None]:
    """PETSc destroys objects collectively: let all ranks collect at the same point."""
    yield
    if request.node.get_closest_marker("mpi"):
        gc.collect()
        MPI.COMM_WORLD.barrier()
