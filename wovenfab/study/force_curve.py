"""The force between steps: a spline through its values, and what steps miss of its peak.

Where friction does not depend on the rate, the force jumps when the motion turns: the curve
consists of pieces, one from reversal to reversal. A step ends at each reversal, so that nothing is
missed there, and a spline through it would only swing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from wovenfab.record.history import index_of_peak

Array = NDArray[np.float64]
#: Steps through which a parabola goes, and points between two steps where two are compared.
THREE, BETWEEN = 3, 129


@dataclass(frozen=True)
class ForceCurve:
    """Forces at the ends of steps.

    Attributes:
        times: Of the steps, s, shape (n,).
        forces: N, shape (n,).
        breaks: Times (s) after which the force may be another one at once.
    """

    times: Array
    forces: Array
    breaks: Sequence[float] = ()

    def spline(self, times: Array) -> Array:
        """Return a spline through the steps of each piece at other times, N, shape (m,).

        From a break to the first step after it the curve is straight.
        """
        values = np.interp(times, self.times, self.forces)
        for part in self._pieces:
            first, last = self.times[part][[0, -1]]
            inside = (first <= times) & (times <= last)
            if last > first and inside.any():
                values[inside] = CubicSpline(self.times[part], self.forces[part])(times[inside])
        return np.asarray(values)

    def peak_of_spline(self) -> tuple[float, float]:
        """Return when the spline is largest in size, s, and that size, N."""
        n = len(self.times)
        between = np.union1d(np.linspace(self.times[0], self.times[-1], n * BETWEEN), self.times)
        sizes = np.abs(self.spline(between))
        return float(between[sizes.argmax()]), float(sizes.max())

    def peak_bound(self) -> tuple[float, float]:
        """Return when the curve may be largest in size, even by a kink, s, and that force, N.

        Before and after it the curve goes on as parabolas through three steps each, which meet
        where it is largest, be that smooth or, where friction reverses, nearly a kink. Where
        steps are too long to resolve the curvature, that is too much.
        """
        times, at = self.times, index_of_peak(self.forces)
        sign = 1.0 if self.forces[at] >= 0 else -1.0
        sizes = sign * self.forces
        best = float(sizes[at]), float(times[at])
        for j in (at - 1, at):
            before, after = slice(j - THREE + 1, j + 1), slice(j + 1, j + THREE + 1)
            if not any(p.start <= before.start and after.stop <= p.stop for p in self._pieces):
                continue
            t = np.linspace(times[j], times[j + 1], BETWEEN)
            sides = [_parabola(times[s], sizes[s], times[j])(t - times[j]) for s in (before, after)]
            curve = np.minimum(*sides)
            best = max(best, (float(curve.max()), float(t[curve.argmax()])))
        return best[1], sign * best[0]

    def missed_peak(self) -> float:
        """Return what the steps may miss of the force of largest size between them, over it."""
        largest = float(np.abs(self.forces).max(initial=0.0))
        return abs(self.peak_bound()[1]) / largest - 1 if largest else 0.0

    @cached_property
    def _pieces(self) -> tuple[slice, ...]:
        """The steps between breaks; one that ends at a break is the last before it."""
        after = np.searchsorted(self.times, np.asarray(self.breaks, dtype=float), side="right")
        ends = np.unique([0, *after, len(self.times)])
        return tuple(slice(int(a), int(b)) for a, b in pairwise(ends))


def _parabola(times: Array, values: Array, origin: float) -> np.poly1d:
    return np.poly1d(np.polyfit(times - origin, values, THREE - 1))
