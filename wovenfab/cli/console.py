"""Messages, log and progress with the time left, from the first of all ranks."""

from __future__ import annotations

import logging
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from io import TextIOWrapper
from pathlib import Path
from typing import Any

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
    """Prints on the first rank only: a live bar on a terminal, plain lines in a log."""

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
            (self._bar.console.print if self._bar else print)(text)
            sys.stdout.flush()
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
        line = text if ".yaml:" in text else f"wovenfab: {text}"
        print(line, file=sys.stderr, flush=True)
        if launcher_ends:
            with suppress(OSError), Path("/dev/tty").open("w") as terminal:
                print(line, file=terminal)

    def log(self, text: str) -> None:
        """Print a message of the log to the error stream, or above the live bar."""
        if self._bar:
            self._bar.console.print(text, markup=False, highlight=False)
        elif self._first:
            print(text, file=sys.stderr, flush=True)

    def __enter__(self) -> Console:
        """Start the live bar on a terminal."""
        if self._first and sys.stdout.isatty() and not is_launched():
            from rich import progress as rich

            self._bar = rich.Progress(
                rich.TextColumn("{task.description}"),
                rich.BarColumn(),
                rich.TextColumn("{task.percentage:>3.0f} %"),
                rich.TimeRemainingColumn(),
                rich.TextColumn("{task.fields[state]}"),
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
                    self._rows[name] = self._bar.add_task(f"  {name}", total=1.0, state="")
                self._bar.update(self._rows[name], completed=share)

    def progress(self, now: Progress) -> None:
        """Show progress: the bar, or a line every few seconds."""
        if not self._first:
            return
        state = _state(now)
        if self._bar:
            self._bar.update(self._task, description=now.phase, completed=now.done, state=state)
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


def configure_log(
    verbosity: int, file: Path | None, show: Callable[[str], None], first_rank: bool
) -> None:
    """Choose what is logged and where; nothing is unless asked for.

    Every module logs to ``logging.getLogger(__name__)``: decisions that last (a cut step, a change
    to stress at points) are INFO, Newton iterations DEBUG. All ranks have the same level, because
    norms are collective; only the first one has handlers.

    Args:
        verbosity: 0 for nothing, 1 for decisions, 2 for each Newton iteration, on the screen.
        file: Gets all of it with its time, whatever the screen shows; None for no file.
        show: Shows a message on the screen.
        first_rank: Whether this process is the first rank, which alone writes.

    Raises:
        OSError: If the file cannot be written.
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
        return
    printer = _Printer(show)
    printer.setLevel(screen)
    package.addHandler(printer)
    if file is not None:
        writer = logging.FileHandler(file, mode="w", encoding="utf-8")
        writer.setFormatter(logging.Formatter(_FILE_FORMAT))
        package.addHandler(writer)
