"""One cycle's loop of force over displacement, on a grid that loops share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wovenfab.record.summary import window

Values = NDArray[np.float64]
#: Share of the amplitude at the points of a loop.
WAY = np.linspace(0.0, 1.0, 401)


@dataclass(frozen=True)
class Loop:
    """A loop.

    Attributes:
        amplitude: Largest displacement (m).
        out: Force (N) on the way out at the displacements ``WAY * amplitude``.
        back: Force (N) on the way back at the same displacements.
        dissipated: Energy lost (J).
    """

    amplitude: float
    out: Values
    back: Values
    dissipated: float

    @property
    def peak(self) -> float:
        """Largest force (N)."""
        return float(self.out.max())

    @property
    def nonlinearity(self) -> float:
        """Rise of the loop's middle over the second half of the way, over that of the first.

        One for a straight line, more where the sheet stiffens. The middle of both ways is
        free of most of the friction.
        """
        start, half, end = (np.interp(s, WAY, (self.out + self.back) / 2) for s in (0, 0.5, 1))
        return float((end - half) / (half - start))

    def width(self, share: float) -> float:
        """Return the force (N) on the way out less that on the way back at a share of the way."""
        return float(np.interp(share, WAY, self.out - self.back))

    def distance(self, other: Loop) -> float:
        """Return the largest difference in force, in parts of the peak force."""
        apart = max(np.abs(self.out - other.out).max(), np.abs(self.back - other.back).max())
        return float(apart / self.peak)


def loops_of(history: Mapping[str, Values], spans: Iterable[tuple[float, float]]) -> list[Loop]:
    """Return the loop of each cycle.

    Args:
        history: Columns of ``history.csv``.
        spans: Times (s) at which each cycle begins and ends; it begins and ends at rest.
    """
    return [_loop(window(history, start, end)) for start, end in spans]


def _loop(part: Mapping[str, Values]) -> Loop:
    u, force, lost = part["displacement_m"], part["force_N"], part["dissipated_J"]
    turn = int(u.argmax())
    where = WAY * u[turn]
    return Loop(
        amplitude=float(u[turn]),
        out=np.interp(where, u[: turn + 1], force[: turn + 1]),
        back=np.interp(where, u[turn:][::-1], force[turn:][::-1]),
        dissipated=float(lost[-1] - lost[0]),
    )
