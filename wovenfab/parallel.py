"""Work done by one rank such that all ranks agree on how it ended, and by other processes."""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import pickle
import signal
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from wovenfab.mpi import load

if TYPE_CHECKING:
    from mpi4py import MPI

#: What makes a process think that mpirun or srun started it as a rank.
_RANK_VARIABLES = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDRA_", "HYDI_", "MPI_", "SLURM_")
#: Variables that say where Python finds modules.
PYTHON_PATHS = "PYTHONPATH", "PYTHONSAFEPATH"
#: The system's call that asks for a signal at the end of the parent (prctl(2)), and its option.
_PRCTL, _PARENT_ENDS = getattr(ctypes.CDLL(None), "prctl", None), 1


def world() -> MPI.Comm:
    """Return the communicator of all ranks; MPI is loaded only now, for readers need none."""
    comm: MPI.Comm = load().COMM_WORLD
    return comm


def agree(comm: MPI.Comm, problem: Exception | None) -> None:
    """Raise on every rank if any rank has a problem; collective.

    Args:
        comm: The ranks that must agree.
        problem: What went wrong on this rank, or None.

    Raises:
        Exception: The problem of the lowest rank that has one.
    """
    for found in comm.allgather(_portable(problem)):
        if found is not None:
            raise found


def _portable(problem: Exception | None) -> Exception | None:
    """Return a problem that other ranks can read."""
    try:
        pickle.loads(pickle.dumps(problem))
    except Exception:
        return RuntimeError(f"{type(problem).__name__}: {problem}")
    return problem


def on_root(comm: MPI.Comm, action: Callable[[], None]) -> None:
    """Run ``action`` on rank 0; what it raises is raised on every rank. Collective."""
    problem: Exception | None = None
    if comm.rank == 0:
        try:
            action()
        except Exception as error:
            problem = error
    agree(comm, problem)


def from_root[T](comm: MPI.Comm, make: Callable[[], T], elsewhere: T) -> T:
    """Return what ``make`` gives on rank 0, and ``elsewhere`` on the others; collective.

    What it raises is raised on every rank.
    """
    made: list[T] = []
    on_root(comm, lambda: made.append(make()))
    return made[0] if made else elsewhere


def compute_on_root[T](
    comm: MPI.Comm, make: Callable[[], T], meanwhile: Iterable[object] = ()
) -> T:
    """Return what rank 0 makes alone, on every rank; collective.

    The other ranks go through ``meanwhile`` until it is made. What any rank raises is raised on
    every one.
    """
    made: list[T] = []
    word = bytearray(1)
    is_made = comm.Ibcast(word) if comm.rank else None

    def work() -> None:
        nonlocal is_made
        if comm.rank == 0:
            try:
                made.append(make())
            finally:
                is_made = comm.Ibcast(word)
        else:
            any(is_made and is_made.Test() for _ in meanwhile)

    try:
        run_concurrently(comm, work)
    finally:
        if is_made:
            is_made.Wait()
    found: T = comm.bcast(made)[0]
    return found


def run_concurrently(comm: MPI.Comm, work: Callable[[], object]) -> None:
    """Let each rank do its own work, and wait asleep for the others; collective.

    MPI's own waiting would keep a processor busy that the compiler of another rank could use.
    What any rank raises is raised on every one.
    """
    problem: Exception | None = None
    try:
        work()
    except Exception as error:
        problem = error
    request = comm.Ibarrier()
    while not request.Test():
        time.sleep(0.02)
    agree(comm, problem)


def child_environment() -> dict[str, str]:
    """Return the environment without mpirun's marks, in which this package is found.

    Nothing is imported from the current folder.
    """
    kept = {k: v for k, v in os.environ.items() if not k.startswith(_RANK_VARIABLES)}
    here = str(Path(__file__).resolve().parents[1])
    kept["PYTHONPATH"] = os.pathsep.join([here, *filter(None, [kept.get("PYTHONPATH")])])
    kept["PYTHONSAFEPATH"] = "1"
    return kept


def end_with_parent() -> None:
    """Let SIGTERM end this process as soon as the one that started it has ended, even by a kill.

    The signal comes at the end of the thread that started this process. Linux only.
    """
    if _PRCTL:
        _PRCTL(_PARENT_ENDS, signal.SIGTERM)


#: A program that becomes another one, which ends as with :func:`end_with_parent`: the system keeps
#: that over exec(2). Signals that Python ignores are again as they were.
_BECOMING = f"""
import ctypes, os, signal, sys
prctl = getattr(ctypes.CDLL(None), "prctl", None)
if prctl:
    prctl({_PARENT_ENDS}, signal.SIGTERM)
    if os.getppid() != int(sys.argv[1]):
        sys.exit("the process that started this one has ended")
for name in ("SIGPIPE", "SIGXFSZ"):
    signal.signal(getattr(signal, name), signal.SIG_DFL)
try:
    os.execvp(sys.argv[2], sys.argv[2:])
except OSError as error:
    sys.exit(f"{{sys.argv[2]}} cannot be started: {{error.strerror}}")
"""


def ending_with_parent(command: Sequence[str]) -> list[str]:
    """Return a command that runs another one, which ends as with :func:`end_with_parent`.

    Unlike a function that runs between fork and exec it is safe where this process has threads.
    """
    return [sys.executable, "-I", "-S", "-c", _BECOMING, str(os.getpid()), *command]


#: What a file system says that has no locks.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL)


def lock(file: TextIO, operation: int) -> bool:
    """Lock an open file by flock(2), and return whether its file system has locks at all.

    Raises:
        BlockingIOError: Another process has it, and ``operation`` says not to wait.
    """
    try:
        fcntl.flock(file, operation)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        return False
    return True
