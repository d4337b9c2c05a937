"""Step size control: steps are cut after a failure, remembered, and grown again."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil, inf
from typing import Any

from wovenfab.model.snapshot import attributes, take_attributes

#: Share of its length that is left of a failed step, and growth after easy ones.
CUT, GROWTH = 0.5, 2.0
#: Tangents up to which a step is easy, and harder ones in a row after which steps grow, too.
EASY, ENOUGH = 3, 5
#: Round-off of a number of steps.
SLACK = 1e-9
#: What a later step depends on.
MEMORY = "_length", "_before", "_row", "_target"


class StepSizeControl:
    """The length of steps between planned times, which are always hit.

    A planned step is made whole unless the last ones had to be cut: the shorter length is
    kept beyond the planned time, so that a difficult part of the program does not begin with
    the same failures at each of its steps, and is doubled again where steps converge.
    """

    def __init__(self, smallest: float) -> None:
        """Begin with whole steps.

        Args:
            smallest: Share of a planned step below which cutting ends.
        """
        self._smallest = smallest
        self._length = self._before = inf
        self._row = 0
        self._target = -inf  # of a bisection, s

    def snapshot(self) -> dict[str, Any]:
        """Return the present lengths."""
        return attributes(self, *MEMORY)

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on with the lengths of a snapshot."""
        take_attributes(self, snapshot, *MEMORY)

    def next(self, now: float, end: float) -> float:
        """Return the time (s) to step to from ``now``, on the way to the planned ``end``."""
        if -inf < self._target <= now:
            self.bracketed(self._before)
        left = end - now
        number = max(1, ceil(left / self._length - SLACK))
        return end if number == 1 else now + left / number

    def accepted(self, length: float, tangents: int) -> None:
        """Grow after an accepted step of ``length`` (s), if its number of tangents allows."""
        self._row += 1
        if self._target == -inf and (tangents <= EASY or self._row >= ENOUGH):
            self._length = max(self._length, GROWTH * length)
            self._row = 0

    def reduce(self, length: float, planned: float) -> bool:
        """Cut after a failed step; return whether the shorter one may be tried.

        Args:
            length: Of the failed step, s.
            planned: Length of the planned step, s.
        """
        self._length, self._row = CUT * length, 0
        return self._length >= self._smallest * planned

    def limit(self, length: float) -> None:
        """Take steps of at most ``length`` (s) next, for their error; not in a bisection."""
        if self._target == -inf:
            self._length, self._row = length, 0

    def bisect(self, until: float, length: float) -> None:
        """Begin or continue a bisection towards ``until`` (s), where a step of ``length`` led.

        Steps do not grow before it has ended.
        """
        if self._target == -inf:
            self._before = self._length
        self._target, self._length = until, CUT * length

    def grow(self, length: float) -> None:
        """Try twice a ``length`` (s) next."""
        self._length = GROWTH * length

    def bracketed(self, length: float) -> None:
        """End a bisection; grow again from a ``length`` (s)."""
        self._length, self._target, self._row = length, -inf, 0
