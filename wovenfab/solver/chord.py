"""When the tangent of one Newton step serves for the next one, too (Shamanskii, 1967).

Where a motion is foreseen well, a solve begins near its solution: its first step is short, and
the second only mends what the first has left. Tangents hardly change over so short a step, so
that the second needs none of its own, nor a factor. Where a solve begins far away, forces tell
little of how tangents change: they fall by orders while yarns still turn.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: A step must have left no more than this share of the forces that did not balance.
LEFT = 0.03
#: Most solves in a row in which no tangent serves twice after that has not been enough.
LONGEST_WAIT = 32


class Chord:
    """Chooses the steps that take the tangent of the step before.

    Attributes:
        taken: Whether the last step was one.
    """

    def __init__(self) -> None:
        """Begin before any solve."""
        self.taken = False
        self._wait = self._waiting = 0

    def begin(self) -> None:
        """Begin a solve."""
        if self.taken:  # and the last solve ended with it
            self._wait = 0
        self.taken = False
        self._waiting = max(0, self._waiting - 1)

    def promises(self, left: float) -> bool:
        """Return whether the next step may be one, as far as forces tell.

        Args:
            left: Share of the forces that the last step left.
        """
        if left <= LEFT:
            return not self._waiting
        if self.taken:  # and has not been worth it
            self._wait = min(max(1, 2 * self._wait), LONGEST_WAIT)
            self._waiting = self._wait
        return False


def distance_over(comm: MPI.Comm, now: Array, other: Array, start: Array) -> float:
    """Return the largest difference of two states over that of the first from a third; collective.

    Args:
        comm: Its ranks.
        now: Own unknowns of the first, m.
        other: Those of the second, m.
        start: Those of the third, m.
    """
    ways = [float(np.abs(now - x).max(initial=0.0)) for x in (other, start)]
    step, whole = np.max(comm.allgather(ways), axis=0)
    return float(step / whole) if whole > 0 else np.inf
