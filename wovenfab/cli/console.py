"""Messages, log and progress with the time left, from the first of all ranks."""

from __future__ import annotations

import logging
import os
import re
import signal
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from io import TextIOWrapper
from pathlib import Path
from typing import Any, TextIO

from wovenfab.case import case_error
from wovenfab.plain_text import printable
from wovenfab.record.results import FILES, FOLDERS
from wovenfab.simulation.progress import Progress

BAD_INPUT = 2
FAILED_STEP = 3
CANNOT_WRITE = 4
#: With the number of a signal the exit code of a run that it ended.
SIGNALLED = 128
INTERRUPTED = SIGNALLED + 2
#: Seconds between two lines of progress in a log.
PAUSE = 5.0
#: Share of the program below which nobody can say how long the rest will take.
UNKNOWN = 0.01
#: Variables in which MPI's launchers tell a process its rank.
RANKS = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK", "SLURM_PROCID")
#: Levels of ``-v`` and ``-vv``.
LEVELS = (logging.WARNING, logging.INFO, logging.DEBUG)
#: The first line of a log of wovenfab, and how much of it is read.
_LOGGED = re.compile(rb"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} [A-Z]+ +wovenfab[\w.]*: ")
_LONGEST = 200
_FILE_FORMAT = "%(asctime)s %(levelname)-7s %(name)s: %(message)s"
#: How many ranks srun has started; the last one above is set in the script of a job, too.
OF_SRUN = "SLURM_STEP_NUM_TASKS"


def is_launched() -> bool:
    """Return whether an MPI launcher started this process; it hides what the terminal is."""
    by_srun = int(os.environ.get(OF_SRUN, "1")) > 1
    return by_srun or any(name in os.environ for name in RANKS[:-1])


def is_first_rank() -> bool:
    """Return whether this process is the first rank, without loading MPI."""
    return next((os.environ[name] for name in RANKS if name in os.environ), "0") == "0"


def prepare_streams() -> None:
    """Make the output streams take any text, also where the caller has closed them."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w"))  # noqa: SIM115 - until the process ends
        elif isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


class Console:
    """Prints on the first rank only: a live bar on a terminal, plain lines in a log.

    All that the commands print goes through it: texts are plain, without markup, and control
    characters in titles, names and paths are spelled out.
    """

    def __init__(self) -> None:
        """Find out whether this is the first rank."""
        self._first = is_first_rank()
        self._bar: Any = None
        self._task: Any = None
        self._rows: dict[str, Any] = {}
        self._last = time.monotonic()
        self._done = 0.0
        self._phase = ""

    def say(self, text: str) -> None:
        """Print a line."""
        if not self._first:
            return
        signal.signal(signal.SIGPIPE, signal.SIG_IGN)  # by PETSc it ends the process
        try:
            self._print(printable(text), sys.stdout)
        except OSError as error:  # nobody reads any more, or the disk is full: go on without
            with Path(os.devnull).open("w") as nowhere:
                os.dup2(nowhere.fileno(), sys.stdout.fileno())
            if not isinstance(error, BrokenPipeError):
                self.problem(f"the output cannot be written ({error.strerror}), and is left out")

    def problem(self, text: str, launcher_ends: bool = False) -> None:
        """Print a message to the error stream.

        Args:
            text: The message.
            launcher_ends: mpirun was interrupted, too, and passes nothing on any more: print it
                to the terminal, if there is one.
        """
        if not self._first:
            return
        line = printable(text if ".yaml:" in text else f"wovenfab: {text}")
        print(line, file=sys.stderr, flush=True)
        if launcher_ends:
            with suppress(OSError), Path("/dev/tty").open("w") as terminal:
                print(line, file=terminal)

    def log(self, text: str) -> None:
        """Print a message of the log to the error stream, or above the live bar."""
        if self._first:
            self._print(printable(text), sys.stderr)

    def _print(self, text: str, stream: TextIO) -> None:
        """Print above the live bar, or to a stream if there is none."""
        if self._bar:
            plain = {"markup": False, "highlight": False, "emoji": False, "soft_wrap": True}
            self._bar.console.print(text, **plain)
        else:
            print(text, file=stream, flush=True)

    def __enter__(self) -> Console:
        """Start the live bar on a terminal."""
        if self._first and sys.stdout.isatty() and not is_launched():
            from rich import progress as rich

            self._bar = rich.Progress(
                rich.TextColumn("{task.description}", markup=False),
                rich.BarColumn(),
                rich.TextColumn("{task.percentage:>3.0f} %"),
                rich.TimeRemainingColumn(),
                rich.TextColumn("{task.fields[state]}", markup=False),
            )
            self._bar.start()
            self._task = self._bar.add_task("starting", total=1.0, state="")
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the live bar."""
        if self._bar:
            self._bar.stop()
            self._bar = None

    def rows(self, shares: Mapping[str, float]) -> None:
        """Show below the bar a row for each of several runs: its share that is done, time left."""
        if self._bar:
            for name in self._rows.keys() - shares.keys():
                self._bar.remove_task(self._rows.pop(name))
            for name, share in shares.items():
                if name not in self._rows:
                    shown = printable(f"  {name}")
                    self._rows[name] = self._bar.add_task(shown, total=1.0, state="")
                self._bar.update(self._rows[name], completed=share)

    def progress(self, now: Progress) -> None:
        """Show progress: the bar, or a line every few seconds."""
        if not self._first:
            return
        state = _state(now)
        if self._bar:
            phase = printable(now.phase)
            self._bar.update(self._task, description=phase, completed=now.done, state=state)
            return
        moment = time.monotonic()
        if now.phase != self._phase:
            self._phase = now.phase
            self._last, self._done = moment, now.done
            size = f" ({now.unknowns} unknowns)" if now.unknowns else ""
            self.say(f"{now.phase}{size}")
        elif moment - self._last > PAUSE and now.step is not None:
            speed = (now.done - self._done) / (moment - self._last)
            known = now.done > UNKNOWN and speed > 0
            left = f", {duration((1 - now.done) / speed)} left" if known else ""
            self._last, self._done = moment, now.done
            self.say(f"{now.done:4.0%}  {state}{left}")


def _state(now: Progress) -> str:
    if now.step is None:
        return ""
    step = now.step
    cut = f", cut back {counted(step.cutbacks, 'time')}" if step.cutbacks else ""
    iterations = counted(step.iterations, "iteration")
    return f"step {step.number}: {1e3 * step.displacement:.4g} mm, {iterations}{cut}"


def counted(number: int, thing: str) -> str:
    """Return a number of things in words: 1 run, 2 runs."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def duration(seconds: float) -> str:
    """Return a time in words."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


class _Printer(logging.Handler):
    """Hands each message to a function."""

    def __init__(self, show: Callable[[str], None]) -> None:
        super().__init__()
        self._show = show

    def emit(self, record: logging.LogRecord) -> None:
        self._show(self.format(record))


class _Lines(logging.Formatter):
    """Writes a message of the log as lines without control characters."""

    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


class _LogFile(logging.Handler):
    """Writes the log into a file from when it is opened on; keeps the lines before."""

    def __init__(self, path: Path, complain: Callable[[str], None]) -> None:
        super().__init__()
        self.setFormatter(_Lines(_FILE_FORMAT))
        self._path, self._complain = path, complain
        self._file: TextIO | None = None
        self._lines: list[str] | None = []

    def open(self) -> None:
        """Replace the file, and write what was kept.

        Raises:
            OSError: It cannot be written.
        """
        self._file = self._path.open("w", encoding="utf-8")
        kept, self._lines = self._lines or [], None
        self._file.writelines(kept)
        self._file.flush()

    def emit(self, record: logging.LogRecord) -> None:
        line = self.format(record) + "\n"
        if self._lines is not None:
            self._lines.append(line)
        elif self._file is not None:
            try:
                self._file.write(line)
                self._file.flush()
            except OSError as error:  # as of a full disk: the run goes on without
                self._file = None
                self._complain(f"{self._path} cannot be written ({error.strerror}), and ends here")

    def close(self) -> None:
        with suppress(OSError, AttributeError):
            self._file.close()  # type: ignore[union-attr]
        super().close()


def require_log(file: Path, directory: Path) -> None:
    """Refuse a log file that would replace anything but a log, and one that cannot be written.

    Args:
        file: The log file.
        directory: The results directory, which need not be there yet.

    Raises:
        CaseError: With the reason.
    """
    place, results = file.resolve(), directory.resolve()
    remedy = "Choose another file, such as run.log."
    if place.is_dir() or results.is_relative_to(place):
        raise case_error("--log", f"{file} is a folder", remedy)
    inside = place.relative_to(results).parts[0] if place.is_relative_to(results) else ""
    if inside in {*FILES, *FOLDERS} or inside.startswith("."):  # such as the marker and its lock
        raise case_error("--log", f"{file} is a file of the results", remedy)
    if place.exists():
        writable = os.access(place, os.W_OK)
    else:
        writable = place.parent == results or os.access(place.parent, os.W_OK | os.X_OK)
    if not writable:
        there = place.exists() or place.parent.is_dir()
        why = "is not allowed" if there else f"there is no folder {file.parent}"
        raise case_error("--log", f"{file} cannot be written: {why}", remedy)
    if place.is_file():
        with place.open("rb") as before:
            first = before.readline(_LONGEST)
        if first and not _LOGGED.match(first):
            message = f"{file} is there and is no log of wovenfab, so it is left alone"
            raise case_error("--log", message, remedy)


def configure_log(
    verbosity: int, file: Path | None, show: Callable[[str], None], first_rank: bool
) -> Callable[[], None]:
    """Choose what is logged and where; nothing is unless asked for.

    Every module logs to ``logging.getLogger(__name__)``: decisions that last (a cut step, a change
    to stress at points) are INFO, Newton iterations DEBUG. All ranks have the same level, because
    norms are collective; only the first one has handlers.

    Args:
        verbosity: 0 for nothing, 1 for decisions, 2 for each Newton iteration, on the screen.
        file: Gets all of it with its time, whatever the screen shows; None for no file.
        show: Shows a message on the screen.
        first_rank: Whether this process is the first rank, which alone writes.

    Returns:
        What opens the file, which is not touched before. It raises an OSError if that fails.
    """
    package = logging.getLogger("wovenfab")
    for handler in package.handlers[:]:
        package.removeHandler(handler)
        handler.close()
    screen = LEVELS[min(verbosity, len(LEVELS) - 1)]
    package.setLevel(screen if file is None else logging.DEBUG)
    package.propagate = False
    if not first_rank:
        package.addHandler(logging.NullHandler())
        return lambda: None
    printer = _Printer(show)
    printer.setLevel(screen)
    package.addHandler(printer)
    if file is None:
        return lambda: None
    writer = _LogFile(file, show)
    package.addHandler(writer)
    return writer.open
