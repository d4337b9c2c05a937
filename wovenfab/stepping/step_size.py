"""How far to step after a step has failed: cut, remembered, and grown again."""

from __future__ import annotations

from math import ceil, inf

#: Share of its length that is left of a step that failed, and growth after easy ones.
CUT, GROWTH = 0.5, 2.0
#: Tangents up to which a step was easy, and harder ones in a row that do as well.
EASY, ENOUGH = 3, 5
#: Round-off of a number of steps.
SLACK = 1e-9


class StepSizeControl:
    """The length of steps between planned times, which are always hit.

    A planned step is made whole unless the last ones had to be cut: what was learnt is
    kept beyond the planned time, so that a hard stretch does not begin with the same
    failures at each of its steps, and doubled again where steps are made.
    """

    def __init__(self, smallest: float) -> None:
        """Begin with whole steps.

        Args:
            smallest: Share of a planned step below which cutting ends.
        """
        self._smallest = smallest
        self._length = self._before = inf
        self._row = 0
        self._sought = -inf

    def next(self, now: float, end: float) -> float:
        """Return the time (s) to step to from ``now``, on the way to the planned ``end``."""
        if -inf < self._sought <= now:
            self.found(self._before)
        left = end - now
        number = max(1, ceil(left / self._length - SLACK))
        return end if number == 1 else now + left / number

    def made(self, length: float, tangents: int) -> None:
        """Note a step of ``length`` (s) that took so many tangents."""
        self._row += 1
        if self._sought == -inf and (tangents <= EASY or self._row >= ENOUGH):
            self._length = max(self._length, GROWTH * length)
            self._row = 0

    def cut(self, length: float, planned: float) -> bool:
        """Note a failed step; return whether a shorter one may be tried.

        Args:
            length: Of the failed step, s.
            planned: Length of the planned step, s.
        """
        self._length, self._row = CUT * length, 0
        return self._length >= self._smallest * planned

    def aim(self, length: float) -> None:
        """Take steps of at most ``length`` (s) next, for their error; not while seeking."""
        if self._sought == -inf:
            self._length, self._row = length, 0

    def bisect(self, until: float, length: float) -> None:
        """Look for what lies between here and ``until`` (s), where a step of ``length`` led.

        Steps do not grow before it is found or passed.
        """
        if self._sought == -inf:
            self._before = self._length
        self._sought, self._length = until, CUT * length

    def lengthen(self, length: float) -> None:
        """Try twice a ``length`` (s) next."""
        self._length = GROWTH * length

    def found(self, length: float) -> None:
        """Grow again from a ``length`` (s), for what was looked for has been passed."""
        self._length, self._sought, self._row = length, -inf, 0
