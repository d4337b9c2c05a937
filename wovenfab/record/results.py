"""The results directory, never overwritten silently; provenance of results; tables; pictures.

A run draws in a process of its own, so that a failing picture never ends a computation, and
no drawing library is loaded beside it.
"""

from __future__ import annotations

import csv
import fcntl
import json
import logging
import os
import shlex
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from errno import EACCES
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TextIO

from wovenfab.mpi import command_of, on_ranks
from wovenfab.parallel import child_environment, lock, on_root, world
from wovenfab.plain_text import printable

if TYPE_CHECKING:
    from mpi4py import MPI

logger = logging.getLogger(__name__)
#: Environment variable with the commit of the code, set by ``env/enter``; ``+`` if changed.
COMMIT = "WOVENFAB_COMMIT"
#: Environment variable with the command that the user typed, for processes that it starts.
COMMAND = "WOVENFAB_COMMAND"
#: Marks a directory as made by wovenfab: only such a one can be overwritten.
MARKER = ".wovenfab"
#: Outcome in the summary of a run that made its whole program.
FINISHED = "finished"
#: Beginning of the outcome of a run that a signal has stopped.
INTERRUPTED = "interrupted"
#: Fingerprint of the input of the results, where a sweep made them, and its environment variable.
FINGERPRINT, INPUT = ".fingerprint", "WOVENFAB_FINGERPRINT"
#: The last two checkpoints of a run.
CHECKPOINT, EARLIER_CHECKPOINT = "checkpoint.h5", "checkpoint-earlier.h5"
#: Series of fields, and all folders that wovenfab writes there with the names of their files.
SERIES = ("fields", "mode", "error", "yarns")
FOLDERS = {**dict.fromkeys(SERIES, "*.h5"), "export": "step-*.*"}
#: Fields along the lines of a case.
LINES = "lines.csv"
#: Figures of standard tests, as an object and as a table; the tests, each with a curve.
FIGURES, FIGURES_TABLE = "figures.json", "figures.csv"
TESTS = ("kes-shear", "kes-tension", "picture-frame", "bias-extension")
#: Every file that wovenfab writes into a results directory, and may replace.
FILES = (
    *("case.yaml", "summary.json", FINGERPRINT),
    *("history.csv", "reactions.csv", "cycles.csv", LINES, "error.csv"),
    *(FIGURES, FIGURES_TABLE, *(f"{test}.csv" for test in TESTS)),
    *(f"{name}.{kind}" for name in SERIES for kind in ("h5", "xdmf")),
    *("loop.png", "loop.svg", "deformed.png", "mode.png", "error.png", "animation.gif"),
    *("report.html", "open_in_paraview.py", CHECKPOINT, f"{CHECKPOINT}.new", EARLIER_CHECKPOINT),
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
    program = ["python3", "-m", module]
    if module in ("", "wovenfab"):
        name = module or Path(sys.argv[0]).name
        program = [command_of(name) or name]
    return Provenance(shlex.join([*on_ranks(ranks), *program, *sys.argv[1:]]), commit)


def of_summary(summary: Mapping[str, object]) -> Provenance | None:
    """Return the provenance of a run from its summary; None if the summary has none."""
    command = summary.get("command")
    commit = summary.get("commit") or ""
    return Provenance(printable(str(command)), printable(str(commit))) if command else None


def _joined(first: str, second: str) -> str:
    """Return both texts joined, without empty and repeated parts."""
    parts = dict.fromkeys([*first.split("; "), *second.split("; ")])
    return "; ".join(part for part in parts if part)


class ResultsExistError(Exception):
    """The directory holds files that must not be overwritten, or cannot be written."""


class NothingToResumeError(Exception):
    """A directory from which no run can go on; the message says why and what to do."""


class ResultsDirectory:
    """A results directory that this run has for itself: no other run may write there.

    A context manager. The lock is the system's on the open marker file, so that a killed run
    leaves none behind; only rank 0 holds it. On a file system without locks there is none, which
    is logged.

    Attributes:
        path: The directory.
    """

    def __init__(self, path: Path, comm: MPI.Comm) -> None:
        """Lock nothing yet."""
        self.path, self._comm = path, comm
        self._lock: TextIO | None = None

    def require_free(self, overwrite: bool = False) -> None:
        """Raise what :meth:`open` would raise, but change nothing; collective."""
        on_root(self._comm, lambda: _refuse(self.path, overwrite))

    def open(self, overwrite: bool = False) -> Self:
        """Prepare it for a new run; collective.

        It is made, with its parents, if missing. With ``overwrite`` the files of an earlier run
        are removed, and nothing else: a user's own files stay, and a directory that wovenfab did
        not make is refused all the same.

        Raises:
            ResultsExistError: The directory is in use or cannot be written.
        """
        on_root(self._comm, lambda: self._prepare(overwrite))
        return self

    def reopen(self) -> Self:
        """Take the directory of an earlier run as it is; collective.

        Raises:
            ResultsExistError: Another run writes there, or this one must not.
        """
        on_root(self._comm, self._take)
        return self

    def close(self) -> None:
        """Let others write there."""
        if self._lock:
            self._lock.close()
            self._lock = None

    def __enter__(self) -> Self:
        """Return the directory itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Let others write there."""
        self.close()

    def _prepare(self, overwrite: bool) -> None:
        _refuse(self.path, overwrite)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._take(new=not overwrite)
            if overwrite:
                for folder in FOLDERS:
                    for file in (self.path / folder).glob(FOLDERS[folder]):
                        file.unlink()
                    with suppress(OSError):  # not there, or with files of the user
                        (self.path / folder).rmdir()
                for name in FILES:
                    (self.path / name).unlink(missing_ok=True)
                    (self.path / f".{name}.part").unlink(missing_ok=True)
            if text := os.environ.get(INPUT):
                write_whole(self.path / FINGERPRINT, f"{text}\n")
        except OSError as error:
            raise _unwritable(self.path, error) from None

    def _take(self, new: bool = False) -> None:
        """Lock the marker, which a ``new`` directory must not have yet."""
        for path in (self.path / name for name in (MARKER, *FOLDERS)):
            if path.is_symlink():
                raise ResultsExistError(is_link(path))
            if path.exists() and path.is_file() != (path.name == MARKER):
                raise ResultsExistError(f"{path} is not what wovenfab writes: remove it")
        try:
            self._lock = (self.path / MARKER).open("x" if new else "a", encoding="utf-8")
            if not lock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB):
                logger.warning(
                    "%s is on a file system without locks: let no other run write there", self.path
                )
        except FileExistsError:  # another run made it in between
            raise _exists(self.path) from None
        except BlockingIOError:
            self.close()
            raise ResultsExistError(
                f"another run is writing into {self.path}; wait for its end, or choose another "
                "directory with -o"
            ) from None
        except OSError as error:
            raise _unwritable(self.path, error) from None


def open_results(path: str | Path, overwrite: bool = False, comm: MPI.Comm | None = None) -> Path:
    """Prepare the results directory for a new run and return it; collective.

    It is made, with its parents, if missing. With ``overwrite`` the files of an earlier run
    are removed, and nothing else: a user's own files stay, and a directory that wovenfab did
    not make is refused all the same.

    Raises:
        ResultsExistError: The directory is in use or cannot be written.
    """
    with ResultsDirectory(Path(path), world() if comm is None else comm) as directory:
        return directory.open(overwrite).path


def require_free(path: str | Path, overwrite: bool = False, comm: MPI.Comm | None = None) -> None:
    """Raise what :func:`open_results` would raise, but change nothing; collective."""
    on_root(world() if comm is None else comm, lambda: _refuse(Path(path), overwrite))


def is_link(path: Path) -> str:
    """Return why nothing is written to a link in a results directory, which leads elsewhere."""
    return f"{path} is a link, and results are not written elsewhere: put the file itself there"


def write_whole(path: Path, content: str | bytes) -> None:
    """Replace a file in one operation: a reader sees the old content or the new one.

    It is on the disk when this returns. After an error the old content is still there.
    """
    part = path.with_name(f".{path.name}.part")
    data = content.encode() if isinstance(content, str) else content
    try:
        part.unlink(missing_ok=True)
        with part.open("xb") as file:  # of its own, never what a link there leads to
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


def _refuse(directory: Path, overwrite: bool) -> None:
    there = next(p for p in (directory, *directory.absolute().parents) if os.path.lexists(p))
    if not there.is_dir():
        kind = "a file" if there.exists() else f"a link to {there.readlink()}, which is not there"
        raise ResultsExistError(
            f"{there} is {kind}, so no results can be written there; "
            "choose another directory with -o"
        )
    if not os.access(there, os.W_OK | os.X_OK):
        raise _unwritable(directory, PermissionError(EACCES, os.strerror(EACCES)))
    if not directory.exists() or not any(directory.iterdir()):
        return
    if not (directory / MARKER).exists():
        raise ResultsExistError(
            f"{directory} holds files that wovenfab did not write, so it is left alone; "
            "choose a new directory with -o"
        )
    if not overwrite:
        raise _exists(directory)


def _unwritable(directory: Path, error: OSError) -> ResultsExistError:
    return ResultsExistError(
        f"{directory} cannot be written ({error.strerror}); choose another directory with -o"
    )


def _exists(directory: Path) -> ResultsExistError:
    outcome = outcome_of(directory)
    if outcome == FINISHED or (outcome is not None and not has_checkpoint(directory)):
        remedy = "choose another directory with -o, or replace them with --overwrite"
        return ResultsExistError(f"{directory} already holds results; {remedy}")
    remedy = f"go on with 'wovenfab resume {directory}', or replace it with --overwrite"
    return ResultsExistError(f"{directory} holds a run that did not come to its end; {remedy}")


def has_checkpoint(directory: Path) -> bool:
    """Return whether a run there left a checkpoint, whole or not."""
    return any((directory / name).exists() for name in (CHECKPOINT, EARLIER_CHECKPOINT))


def fingerprint_of(directory: Path) -> str:
    """Return the fingerprint of the input of the results there; empty where there is none."""
    with suppress(OSError, UnicodeError):
        return (directory / FINGERPRINT).read_text(encoding="utf-8").strip()
    return ""


def is_in_use(directory: Path) -> bool:
    """Return whether a run is writing there."""
    with suppress(OSError), (directory / MARKER).open() as marker:
        try:
            lock(marker, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def outcome_of(directory: Path) -> str | None:
    """Return how the run there has ended; None if it was killed or is still going on."""
    with suppress(OSError, ValueError, TypeError, KeyError):
        summary = json.loads((directory / "summary.json").read_text(encoding="utf-8"))
        return str(summary["outcome"])
    return None


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


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows with the columns of all; a row may lack some."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    stream = StringIO()
    writer = csv.DictWriter(stream, columns, lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(rows)
    write_whole(path, stream.getvalue())


def rows_of(columns: Mapping[str, Iterable[Any]]) -> list[dict[str, Any]]:
    """Return the rows of a table that is given by columns of one length."""
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def markdown(
    titles: Sequence[str], rows: Iterable[Sequence[str]], texts: Sequence[int] = (0,)
) -> str:
    """Return a table in Markdown; columns that are not texts are aligned right."""
    rules = ["---" if i in texts else "---:" for i in range(len(titles))]
    lines = [f"| {' | '.join(titles)} |", f"|{'|'.join(rules)}|"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])
