"""Pictures and pages of runs, made from the files in their results directories alone.

A run draws in a process of its own, so that a failing picture never ends a computation, and
no drawing library is loaded beside it.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from wovenfab.parallel import child_environment, world
from wovenfab.record.results import COMMAND, this_process

if TYPE_CHECKING:
    from mpi4py import MPI


@dataclass(frozen=True)
class Pictures:
    """The pictures drawn (none on ranks other than 0), and what failed and how to try again."""

    paths: tuple[Path, ...] = ()
    warning: str | None = None


def draw_in_subprocess(
    directory: str | Path, comm: MPI.Comm | None = None, patience: float = 600.0
) -> Pictures:
    """Draw the pictures of a results directory in another process; never raises.

    Every rank may call; only rank 0 draws, and the others do not wait for it.

    Args:
        directory: The results directory.
        comm: The ranks that call; the world communicator if None.
        patience: Time (s) after which the drawing is given up.
    """
    comm = world() if comm is None else comm
    if comm.rank != 0:
        return Pictures()
    try:
        ended = subprocess.run(
            [sys.executable, "-m", "wovenfab.report.pictures", str(directory)],
            env=child_environment() | {COMMAND: this_process(comm.size).command},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=patience,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Pictures(warning=_warning(directory, f"not ready after {patience:g} s"))
    except OSError as error:
        return Pictures(warning=_warning(directory, str(error)))
    paths = tuple(Path(line) for line in ended.stdout.splitlines())
    if ended.returncode == 0:
        return Pictures(paths)
    messages = ended.stderr.strip().splitlines() or [f"it ended with code {ended.returncode}"]
    return Pictures(paths, _warning(directory, messages[-1]))


def _warning(directory: str | Path, reason: str) -> str:
    return f"pictures are missing: {reason} (to try again: wovenfab report {directory})"
