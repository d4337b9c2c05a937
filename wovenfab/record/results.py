"""The results directory, which is never overwritten silently, and the provenance of results."""

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

#: Environment variable with the commit of the code, set by ``env/enter``; ``+`` if changed.
COMMIT = "WOVENFAB_COMMIT"
#: Environment variable with the command that the user typed, for processes that it starts.
COMMAND = "WOVENFAB_COMMAND"
#: Marks a directory as made by wovenfab: only such a one can be overwritten.
MARKER = ".wovenfab"
#: Fingerprint of the input of finished results, where a sweep made them.
FINGERPRINT = ".fingerprint"
#: Every file that wovenfab writes into a results directory, and may replace.
FILES = (
    *("case.yaml", "summary.json", FINGERPRINT),
    *("history.csv", "reactions.csv", "cycles.csv", "error.csv"),
    *(f"{name}.{kind}" for name in ("fields", "mode", "error", "yarns") for kind in ("h5", "xdmf")),
    *("loop.png", "loop.svg", "deformed.png", "mode.png", "error.png", "animation.gif"),
    *("report.html", "open_in_paraview.py"),
)


@dataclass(frozen=True)
class Provenance:
    """The command and the commit that made a file.

    Attributes:
        command: The command line; several are joined by ``"; "``.
        commit: Commit of the code, several joined likewise; ``+`` after it if the code had
            uncommitted changes; empty if unknown.
    """

    command: str
    commit: str

    def then(self, later: Provenance) -> Provenance:
        """Return the provenance of a file that a later command made from these results."""
        return Provenance(_joined(self.command, later.command), _joined(self.commit, later.commit))


def this_process(ranks: int = 1) -> Provenance:
    """Return the command that started this process (on ``ranks`` MPI ranks), and its commit."""
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
    """Return the provenance of a run from its summary; None if the summary has none."""
    command = summary.get("command")
    return Provenance(str(command), str(summary.get("commit") or "")) if command else None


def _joined(first: str, second: str) -> str:
    """Return both texts joined, without empty and repeated parts."""
    parts = dict.fromkeys([*first.split("; "), *second.split("; ")])
    return "; ".join(part for part in parts if part)


class ResultsExistError(Exception):
    """The directory holds files that must not be overwritten, or cannot be written."""


def open_results(path: str | Path, overwrite: bool = False, comm: MPI.Comm | None = None) -> Path:
    """Prepare the results directory for a new run and return it; collective.

    It is made, with its parents, if missing. With ``overwrite`` the files of an earlier run
    are removed, and nothing else: a user's own files stay, and a directory that wovenfab did
    not make is refused all the same.

    Raises:
        ResultsExistError: The directory is in use or cannot be written.
    """
    directory = Path(path)
    on_root(world() if comm is None else comm, lambda: _prepare(directory, overwrite))
    return directory


def require_free(path: str | Path, overwrite: bool = False, comm: MPI.Comm | None = None) -> None:
    """Raise what :func:`open_results` would raise, but change nothing; collective."""
    on_root(world() if comm is None else comm, lambda: _refuse(Path(path), overwrite))


def write_whole(path: Path, text: str) -> None:
    """Replace a file in one operation: a reader sees the old text or the new one."""
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
            for name in (*FILES, MARKER):  # the marker last
                (directory / name).unlink(missing_ok=True)
                (directory / f".{name}.part").unlink(missing_ok=True)
        (directory / MARKER).touch(exist_ok=False)
    except FileExistsError:  # another run made it in between
        raise _exists(directory) from None
    except OSError as error:
        raise ResultsExistError(
            f"{directory} cannot be written ({error.strerror}); choose another directory with -o"
        ) from None


def _exists(directory: Path) -> ResultsExistError:
    return ResultsExistError(
        f"{directory} already holds results; choose another directory with -o, "
        "or replace them with --overwrite"
    )
