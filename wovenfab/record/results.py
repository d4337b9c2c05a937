"""The results directory: made once, never overwritten silently, never emptied."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from wovenfab.parallel import on_root, world

if TYPE_CHECKING:
    from mpi4py import MPI

#: Shows that wovenfab made the directory, so that only such a one can be overwritten.
MARKER = ".wovenfab"

#: What finished results were computed from, where a sweep made them.
FINGERPRINT = ".fingerprint"

#: Everything that wovenfab writes into a results directory, and may replace.
FILES = (
    "case.yaml",
    "history.csv",
    "reactions.csv",
    "cycles.csv",
    "fields.h5",
    "fields.xdmf",
    "summary.json",
    "loop.png",
    "loop.svg",
    "deformed.png",
    "mode.h5",
    "mode.xdmf",
    "mode.png",
    "report.html",
    FINGERPRINT,
    "yarns.h5",
    "yarns.xdmf",
    "open_in_paraview.py",
    "animation.gif",
    "error.csv",
    "error.h5",
    "error.xdmf",
    "error.png",
)


class ResultsExistError(Exception):
    """The results directory holds what must not be overwritten, or cannot be written."""


def open_results(path: str | Path, overwrite: bool = False, comm: MPI.Comm | None = None) -> Path:
    """Make the results directory ready for a new run; collective.

    With ``overwrite`` the files of an earlier run are removed, and nothing else: a user's
    own files stay, and a directory that wovenfab did not make is refused all the same.

    Args:
        path: The directory; it and its parents are made if missing.
        overwrite: Whether the results of an earlier run may be replaced.
        comm: The ranks that call; all of MPI's if None.

    Returns:
        The directory.

    Raises:
        ResultsExistError: The directory is in use or cannot be written; the message says
            what to do.
    """
    directory = Path(path)
    on_root(world() if comm is None else comm, lambda: _prepare(directory, overwrite))
    return directory


def require_free(path: str | Path, overwrite: bool = False, comm: MPI.Comm | None = None) -> None:
    """Refuse early what :func:`open_results` would refuse, and change nothing; collective.

    Args:
        path: The directory.
        overwrite: Whether the results of an earlier run may be replaced.
        comm: The ranks that call; all of MPI's if None.

    Raises:
        ResultsExistError: The directory is in use; the message says what to do.
    """
    on_root(world() if comm is None else comm, lambda: _refuse(Path(path), overwrite))


def write_whole(path: Path, text: str) -> None:
    """Write a file such that a reader finds the old text or the new one, never a part."""
    part = path.with_name(f".{path.name}.part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def _refuse(directory: Path, overwrite: bool) -> None:
    if directory.exists() and not directory.is_dir():
        raise ResultsExistError(
            f"{directory} is a file, so no results can be written there; "
            "choose another directory with -o"
        )
    if not directory.exists() or not any(directory.iterdir()):
        return
    if not (directory / MARKER).exists():
        raise ResultsExistError(
            f"{directory} holds files that wovenfab did not write, so it is left alone; "
            "choose a new directory with -o"
        )
    if not overwrite:
        raise _exists(directory)


def _prepare(directory: Path, overwrite: bool) -> None:
    _refuse(directory, overwrite)
    try:
        directory.mkdir(parents=True, exist_ok=True)
        if overwrite:
            _clear(directory)
        (directory / MARKER).touch(exist_ok=False)
    except FileExistsError:  # another run was quicker
        raise _exists(directory) from None
    except OSError as error:
        raise ResultsExistError(
            f"{directory} cannot be written ({error.strerror}); choose another directory with -o"
        ) from None


def _clear(directory: Path) -> None:
    """Remove an earlier run's files, the marker last."""
    for name in FILES:
        (directory / name).unlink(missing_ok=True)
        (directory / f".{name}.part").unlink(missing_ok=True)
    (directory / MARKER).unlink(missing_ok=True)


def _exists(directory: Path) -> ResultsExistError:
    return ResultsExistError(
        f"{directory} already holds results; choose another directory with -o, "
        "or replace them with --overwrite"
    )
