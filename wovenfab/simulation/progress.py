"""Progress, wall time and memory of a run, and the signals that end it."""

from __future__ import annotations

import os
import resource
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from mpi4py import MPI

    from wovenfab.stepping.step import Step


@dataclass(frozen=True)
class Progress:
    """The progress of a run.

    Attributes:
        phase: What is being done, in words.
        done: Share of the program that is done, 0 to 1.
        step: The step just accepted, or None.
        unknowns: Number of unknowns, or None before the model is made.
    """

    phase: str
    done: float = 0.0
    step: Step | None = None
    unknowns: int | None = None


class Stopwatch:
    """Wall time by phase (s)."""

    def __init__(self) -> None:
        """Start with no phase."""
        self.seconds: dict[str, float] = {}

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the time spent inside to the named phase."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


def memory(unknowns: int) -> float:
    """Return a rough estimate of the memory of a run on one rank (bytes).

    Fitted to the peak memory of a step with 8 000 to 500 000 unknowns, P3 with two
    placements; fewer couplings between unknowns need less.
    """
    return float(1.0e8 + 7.0e3 * unknowns * (max(unknowns, 1) / 8e3) ** 0.09)


def memory_of_machine() -> float:
    """Return the memory of this machine (bytes)."""
    return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))


def memory_of_machines(comm: MPI.Comm) -> float:
    """Return the memory of all machines of some ranks (bytes), the same on each; collective."""
    from mpi4py import MPI  # starts MPI, which a command does after it has read its case

    machine = comm.Split_type(MPI.COMM_TYPE_SHARED)
    shares = comm.allgather(memory_of_machine() / machine.size)
    machine.Free()
    return float(sum(shares))


def peak_memory() -> int:
    """Return the largest memory of this process so far (bytes).

    Linux counts the parent's in ``ru_maxrss`` if that was larger when it started us.
    """
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


#: Signals of a terminal that is closed or Ctrl-C, of batch systems and of ``kill``.
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1, signal.SIGHUP)
#: Seconds in which signals are one: a terminal, a launcher and a batch system may all send it.
TOGETHER = 0.5
#: Seconds after a signal in which a step may still come to its end.
QUICK = 4.0


class InterruptedRunError(KeyboardInterrupt):
    """A signal asked the run to end.

    Attributes:
        number: Of the signal.
    """

    def __init__(self, number: int) -> None:
        """Say which signal."""
        super().__init__(signal.Signals(number).name)
        self.number = number


def signal_behind(error: BaseException) -> int:
    """Return the number of the signal behind an error, or 0; PETSc hands it on as its own."""
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, KeyboardInterrupt):
        cause = cause.__cause__
    if cause is None:
        return 0
    return cause.number if isinstance(cause, InterruptedRunError) else int(signal.SIGINT)


class Interruption:
    """Notes a signal while steps are made; before that a signal ends the program as usual.

    A context manager, which hands the signals back to those who had them. A second signal ends
    the process at once; one that comes together with the first, as a launcher and a batch system
    send it twice, is the same.
    """

    def __init__(self, launched: bool = False) -> None:
        """Note nothing yet.

        A launcher of ranks passes the signals on, and kills soon after all but SIGUSR1: if
        ``launched``, the step in progress is then dropped.
        """
        self._launched = launched
        self._number, self._since = 0, 0.0
        self._stepping = False
        self._former: dict[int, Any] = {}

    def __enter__(self) -> Self:
        """Listen to the signals."""
        for number in SIGNALS:
            if signal.getsignal(number) != signal.SIG_IGN:  # as nohup wants it
                self._former[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        """Listen no longer."""
        for number, former in self._former.items():
            signal.signal(number, former)

    def begin_steps(self) -> None:
        """From now on a signal lets the step in progress come to its end."""
        self._stepping = True
        for number in self._former:  # PETSc has put its own in place of some
            signal.signal(number, self._note)

    def asked(self, comm: MPI.Comm) -> int:
        """Return the number of a signal that any rank has got, or 0; collective."""
        number: int = max(comm.allgather(self._number))
        return number

    def check(self, comm: MPI.Comm) -> None:
        """End a step that is not quick; collective.

        Raises:
            InterruptedRunError: A signal came some seconds ago; on every rank.
        """
        quick = 0.0 if self._launched and self._number != signal.SIGUSR1 else QUICK
        late = self._number and time.monotonic() - self._since > quick
        if number := max(comm.allgather(self._number if late else 0)):
            raise InterruptedRunError(number)

    def _note(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if self._number and now - self._since < TOGETHER:
            return
        if self._number:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        self._number, self._since = number, now
        if not self._stepping:
            raise InterruptedRunError(number)
