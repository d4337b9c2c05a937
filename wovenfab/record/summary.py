"""The summary of a run: one JSON file of figures that people quote."""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.parallel import on_root, world
from wovenfab.record.cycles import cycles
from wovenfab.record.results import this_process, write_whole

if TYPE_CHECKING:
    from mpi4py import MPI

SUMMARY = "summary.json"


def summarise(
    history: Mapping[str, NDArray[np.float64]],
    spans: Iterable[tuple[float, float]],
    *,
    outcome: str,
    unknowns: int,
    cut_backs: int,
    seconds: Mapping[str, float],
    ranks: int,
    losses: Sequence[Mapping[str, float]] = (),
) -> dict[str, Any]:
    """Return the summary of a run, finished or not.

    Args:
        history: Columns of ``history.csv``.
        spans: Times (s) at which each cycle begins and ends, in order.
        outcome: ``"finished"``, or the reason of the failure in plain words.
        unknowns: Number of unknowns.
        cut_backs: How often a step was restored and retried with a smaller size.
        seconds: Wall time of each phase (s).
        ranks: Number of MPI ranks.
        losses: Figures of each loss of stability.
    """
    rows = len(history["step"])
    iterations = history["newton_iterations"][1:]  # the first row is the start, not a step
    origin = this_process(ranks)
    peak = int(np.abs(history["force_N"]).argmax()) if rows else None
    return {
        "outcome": outcome,
        "command": origin.command,
        "commit": origin.commit,
        "steps": len(iterations),
        "end_s": float(history["time_s"][-1]) if rows else None,
        "peak_force_N": None if peak is None else float(history["force_N"][peak]),
        "peak_force_at_m": None if peak is None else float(history["displacement_m"][peak]),
        "dissipated_J": float(history["dissipated_J"][-1]) if rows else None,
        "work_J": float(history["work_J"][-1]) if rows else None,
        "worst_imbalance_J": float(np.abs(history["imbalance_J"]).max()) if rows else None,
        "cycles": [cycle.as_dict() for cycle in cycles(history, spans)],
        "unknowns": unknowns,
        "newton_iterations": {
            "total": int(iterations.sum()),
            "mean": float(iterations.mean()) if len(iterations) else None,
            "worst": int(iterations.max()) if len(iterations) else None,
        },
        "cut_backs": cut_backs,
        "losses_of_stability": [dict(loss) for loss in losses],
        "saddles": int((history["negative_eigenvalues"] > 0).sum()),
        "wall_time_s": {phase: float(s) for phase, s in seconds.items()},
        "ranks": ranks,
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """Return the versions of what computed: wovenfab, dolfinx, PETSc, Python."""
    return {
        "wovenfab": _version("wovenfab"),
        "dolfinx": _version("fenics-dolfinx"),
        "petsc": _petsc_version(),
        "python": platform.python_version(),
    }


def write_summary(
    directory: str | Path, summary: Mapping[str, Any], comm: MPI.Comm | None = None
) -> None:
    """Write ``summary.json`` in one go; rank 0 writes, all call.

    Args:
        directory: The results directory.
        summary: What :func:`summarise` returned, or more.
        comm: The ranks that call; all of MPI's if None.

    Raises:
        ValueError: A number is not finite; on every rank, and nothing is written.
    """

    def write() -> None:
        text = json.dumps(summary, indent=2, allow_nan=False, default=_plain)
        write_whole(Path(directory) / SUMMARY, text + "\n")

    on_root(world() if comm is None else comm, write)


def read_summary(directory: str | Path) -> dict[str, Any]:
    """Return the content of ``summary.json``."""
    content: dict[str, Any] = json.loads((Path(directory) / SUMMARY).read_text(encoding="utf-8"))
    return content


def _plain(value: Any) -> Any:
    """Return numpy's numbers and arrays as Python's."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no place in the summary")


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # run from the source tree, perhaps
        return str(getattr(sys.modules.get(package), "__version__", "unknown"))


def _petsc_version() -> str:
    # asked only if it is loaded: loading it here, on one rank, would wait for the others
    petsc: Any = sys.modules.get("petsc4py.PETSc")
    if petsc is None:
        return _version("petsc4py")
    return ".".join(map(str, petsc.Sys.getVersion()))
