"""When an older tangent or factor serves again, and when that is not tried.

A whole tangent may serve for the next Newton step, too (Shamanskii, 1967): where a solve begins
near its solution, the second step only corrects what the first one left.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.model.memory import attributes, take_attributes

logger = logging.getLogger(__name__)
Array = NDArray[np.float64]
#: Largest number of occasions that are passed over after failures.
LONGEST_WAIT = 32
#: A tangent serves again if its step has left at most this share of the residual.
LEFT = 0.03


class BackOff:
    """Passes over occasions after a failure, twice as many after each further one."""

    def __init__(self, what: str) -> None:
        """Begin without a failure.

        Args:
            what: What has failed, for the log.
        """
        self._what = what
        self._length = self._remaining = 0

    @property
    def waits(self) -> bool:
        """Whether the next occasion is to be passed over."""
        return self._remaining > 0

    def skip(self) -> None:
        """Pass over an occasion."""
        self._remaining = max(0, self._remaining - 1)

    def snapshot(self) -> dict[str, Any]:
        """Return what is passed over."""
        return attributes(self, "_length", "_remaining")

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on with a snapshot."""
        take_attributes(self, snapshot, "_length", "_remaining")

    def reset(self) -> None:
        """Note a success."""
        self._length = self._remaining = 0

    def fail(self) -> None:
        """Note a failure."""
        self._length = self._remaining = min(max(1, 2 * self._length), LONGEST_WAIT)
        logger.info("%s: not tried the next %d times", self._what, self._length)


class TangentReuse:
    """Chooses the steps that use the tangent of the step before.

    Attributes:
        taken: Whether the last step was one.
    """

    def __init__(self) -> None:
        """Begin before any solve."""
        self.taken = False
        self._back_off = BackOff("an older tangent does not reduce the residual enough")

    def snapshot(self) -> dict[str, Any]:
        """Return what later choices depend on."""
        return {"taken": self.taken, "back_off": self._back_off.snapshot()}

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on with a snapshot."""
        self.taken = snapshot["taken"]
        self._back_off.resume(snapshot["back_off"])

    def begin(self) -> None:
        """Begin a solve."""
        if self.taken:  # and the last solve ended with it
            self._back_off.reset()
        self.taken = False
        self._back_off.skip()

    def promises(self, left: float) -> bool:
        """Return whether the next step may be one, by the residual.

        Args:
            left: Share of the residual that the last step left.
        """
        if left <= LEFT:
            return not self._back_off.waits
        if self.taken:  # without success
            self._back_off.fail()
        return False


def relative_distance(comm: MPI.Comm, now: Array, other: Array, start: Array) -> float:
    """Return the largest difference of two states over that of the first from a third; collective.

    Args:
        comm: Its ranks.
        now: Own unknowns of the first, m.
        other: Those of the second, m.
        start: Those of the third, m.
    """
    distances = [float(np.abs(now - x).max(initial=0.0)) for x in (other, start)]
    step, whole = np.max(comm.allgather(distances), axis=0)
    return float(step / whole) if whole > 0 else np.inf
