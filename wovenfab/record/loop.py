"""The loop of a test, force against strain, as branches from reversal to reversal.

A curve of a branch goes through the values of the steps by monotone cubics (F. N. Fritsch and
R. E. Carlson, 1980). Friction turns at the start of a branch, within its first step: no value is
read there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import copysign, nan

import numpy as np
from numpy.typing import NDArray

from wovenfab.record.figures import Columns

Values = NDArray[np.float64]
#: Rounding error of a strain, as a share of the range of all.
ROUNDING = 1e-9
#: What the loop energy of a test is.
LOOP_ENERGY = "work over the first closed loop, per area at rest"
#: Fewest steps through which a curve goes.
FEWEST = 2


@dataclass(frozen=True)
class Branch:
    """A part of a loop in which the strain goes one way.

    Attributes:
        steps: The steps of the loop, from the one at its start, which the branch before it ends.
        strain: There; strictly monotone, shape (n,), two at least.
        force: There, N/m, shape (n,).
        slack: Rounding error of strains.
    """

    steps: slice
    strain: Values
    force: Values
    slack: float

    @property
    def direction(self) -> float:
        """1 where the strain grows, -1 where it falls."""
        return float(np.sign(self.strain[-1] - self.strain[0]))

    def spans(self, strain: float, first: int = 0) -> bool:
        """Return whether the branch has a strain, from its ``first`` step on."""
        known = self.strain[first:]
        return bool(known.min() - self.slack <= strain <= known.max() + self.slack)

    def at(self, strain: float) -> float:
        """Return the force (N/m) at a strain.

        NaN within the first step, beyond the ends, and where forces of the branch are not known.
        """
        known, finite = self.strain[1:], np.isfinite(self.force[1:]).all()
        if len(known) < FEWEST or not finite or not self.spans(strain, 1):
            return nan
        from scipy.interpolate import PchipInterpolator  # which takes longer than to read a case

        order = slice(None, None, int(self.direction))
        curve = PchipInterpolator(known[order], self.force[1:][order])
        return float(curve(np.clip(strain, known.min(), known.max())))


@dataclass(frozen=True)
class Loop:
    """A test as a laboratory plots it, one value a step.

    Attributes:
        strain: Shear angle (rad) or strain, shape (n,).
        force: Force per width, N/m, shape (n,).
        work: External work since the start over the area at rest, J/m^2, shape (n,).
    """

    strain: Values
    force: Values
    work: Values

    def size(self, unit: str) -> float:
        """Return the size (SI) of that of which a figure with a unit is a part or a difference.

        A width is one of forces, and a loop energy one of works. Pure numbers and angles have 1.
        """
        strain, force = self.strain[np.isfinite(self.strain)], self.force[np.isfinite(self.force)]
        most, span = float(np.abs(force).max(initial=0.0)), float(np.ptp(strain))
        return {"N/m": most, "J/m^2": most * span, "N/(m·rad)": most / (span or 1.0)}.get(unit, 1.0)

    @cached_property
    def branches(self) -> tuple[Branch, ...]:
        """The branches in order; a rest, such as a hold, ends one."""
        slack = ROUNDING * float(np.ptp(self.strain)) if len(self.strain) else 0.0
        change = np.diff(self.strain)
        way = np.where(np.abs(change) > slack, np.sign(change), 0.0)
        turns = np.flatnonzero(np.diff(way)) + 1
        parts = pairwise([0, *map(int, turns), len(way)])
        return tuple(
            Branch(steps, self.strain[steps], self.force[steps], slack)
            for steps, moves in ((slice(a, b + 1), a < b and way[a]) for a, b in parts)
            if moves
        )

    def way_out(self, *strains: float) -> Branch | None:
        """Return the first branch that goes away from zero through strains of one sign."""
        return next(self._through(0, copysign(1.0, strains[0]), strains), None)

    def width(self, strain: float) -> float:
        """Return the width at a strain, N/m: the force on the way out less that on the way back.

        It is that of the first way out through this strain and the next way back, counted positive
        where the force lags behind; NaN if one is missing or not known there.
        """
        side = copysign(1.0, strain)
        out = self.way_out(strain)
        back = out and next(self._through(out.steps.stop - 1, -side, (strain,)), None)
        return side * (out.at(strain) - back.at(strain)) if out and back else nan

    def slope(self, start: float, end: float) -> float:
        """Return the slope (N/m) between two strains on the first way out; NaN if not known."""
        out = self.way_out(start, end)
        return (out.at(end) - out.at(start)) / (end - start) if out else nan

    def closed_work(self) -> float:
        """Return the work over the first closed loop, J/m^2; NaN if there is none.

        A loop is closed where the strain is what it was at the start and goes the same way, or
        where the test ends with it.
        """
        if not self.branches:
            return nan
        first, *later = self.branches
        start = first.strain[0]
        for branch in later:
            ends_it = branch is later[-1] and abs(branch.strain[-1] - start) <= branch.slack
            if ends_it or (branch.direction == first.direction and branch.spans(start)):
                way = branch.direction
                work = np.interp(way * start, way * branch.strain, self.work[branch.steps])
                return float(work - self.work[first.steps.start])
        return nan

    def _through(
        self, after: int, direction: float, strains: tuple[float, ...]
    ) -> Iterator[Branch]:
        """Yield branches from a step on that go through all strains in a direction."""
        for branch in self.branches:
            later = branch.steps.start >= after and branch.direction == direction
            if later and all(map(branch.spans, strains)):
                yield branch


def work_per_area(history: Columns, area: float) -> Values:
    """Return the external work since the start over an area (m^2), J/m^2, from the history.

    It is the energy stored and lost, where a run knows both: a sum of the forces over its steps
    misses the work by the imbalance, by which a curve bends between them.
    """
    work = history["work_J"] - history.get("imbalance_J", 0.0)
    return np.asarray((work - work[:1]) / area)
