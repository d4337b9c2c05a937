"""Where results and pictures come from: the command and the commit that made them.

The results directory: made once, never overwritten silently, never emptied.
"""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from wovenfab.parallel import on_root, world

if TYPE_CHECKING:
    from mpi4py import MPI


#: Variable in which ``env/enter`` tells the commit of the code, ``+`` after it if changed.
COMMIT = "WOVENFAB_COMMIT"
#: Variable in which a command that starts others tells them what the user typed.
COMMAND = "WOVENFAB_COMMAND"


@dataclass(frozen=True)
class Provenance:
    """What made a file.

    Attributes:
        command: The command line; two that made it together have ``"; "`` between.
        commit: Commit of the code (several likewise), ``+`` after it where the code had
            changes that were not committed; empty where it is not known.
    """

    command: str
    commit: str

    def then(self, later: Provenance) -> Provenance:
        """Return what made a file for which one command used the results of another."""
        return Provenance(
            _together(self.command, later.command), _together(self.commit, later.commit)
        )


def this_process(ranks: int = 1) -> Provenance:
    """Return the command that the user typed for this process, and the commit of its code.

    Args:
        ranks: Number of MPI ranks that the command was started on.
    """
    commit = os.environ.get(COMMIT, "")
    if os.environ.get(COMMAND):
        return Provenance(os.environ[COMMAND], commit)
    spec = getattr(sys.modules.get("__main__"), "__spec__", None)
    module = spec.name.removesuffix(".__main__") if spec else ""
    program = ["python3", "-m", module] if module else [Path(sys.argv[0]).name]
    if module == "wovenfab":
        program = [module]
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    return Provenance(shlex.join([*launcher, *program, *sys.argv[1:]]), commit)


def of_summary(summary: Mapping[str, object]) -> Provenance | None:
    """Return what made a run, from its summary; None where that does not say it."""
    command = summary.get("command")
    return Provenance(str(command), str(summary.get("commit") or "")) if command else None


def _together(first: str, second: str) -> str:
    """Return both texts, or one where the other is empty or the same."""
    parts = dict.fromkeys([*first.split("; "), *second.split("; ")])
    return "; ".join(part for part in parts if part)


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
