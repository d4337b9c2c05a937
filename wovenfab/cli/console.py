"""Messages and progress with the time left, from the first of all ranks."""

from __future__ import annotations

import os
import signal
import sys
import time
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


def is_launched() -> bool:
    """Return whether an MPI launcher started this process; it hides what the terminal is."""
    return any(name in os.environ for name in RANKS)


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
    cut = f", cut back {_counted(step.cutbacks, 'time')}" if step.cutbacks else ""
    iterations = _counted(step.iterations, "iteration")
    return f"step {step.number}: {1e3 * step.displacement:.4g} mm, {iterations}{cut}"


def _counted(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def duration(seconds: float) -> str:
    """Return a time in words."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"
