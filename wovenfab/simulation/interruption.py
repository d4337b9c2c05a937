"""Signals that ask a run to end: the run stops after a step, and can go on later."""

from __future__ import annotations

import signal
import time
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from mpi4py import MPI

#: Signals of a terminal that is closed or Ctrl-C, of batch systems and of ``kill``.
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1, signal.SIGHUP)
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

    A context manager, which hands the signals back to those who had them. A second signal of
    the same kind ends the process at once.
    """

    def __init__(self) -> None:
        """Note nothing yet."""
        self._number, self._since = 0, 0.0
        self._stepping = False
        self._former: dict[int, Any] = {}

    def __enter__(self) -> Self:
        """Listen to the signals."""
        for number in SIGNALS:
            if signal.getsignal(number) != signal.SIG_IGN:  # as nohup wants it
                self._former[number] = signal.signal(number, self._note)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Listen no longer."""
        for number, former in self._former.items():
            signal.signal(number, former)

    def begin_steps(self) -> None:
        """From now on a signal lets the step in progress come to its end."""
        self._stepping = True

    def asked(self, comm: MPI.Comm) -> int:
        """Return the number of a signal that any rank has got, or 0; collective."""
        number: int = max(comm.allgather(self._number))
        return number

    def check(self, comm: MPI.Comm) -> None:
        """End a step that is not quick; collective.

        Raises:
            InterruptedRunError: A signal came some seconds ago; on every rank.
        """
        late = self._number and time.monotonic() - self._since > QUICK
        if number := max(comm.allgather(self._number if late else 0)):
            raise InterruptedRunError(number)

    def _note(self, number: int, frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_DFL)
        if not self._stepping:
            raise InterruptedRunError(number)
        self._number, self._since = number, time.monotonic()
