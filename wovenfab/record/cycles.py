"""What each cycle of a program cost: figures from the history alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Cycle:
    """The figures of one cycle.

    Attributes:
        start: Time (s) at which the cycle begins.
        end: Time (s) at which it ends, or should have ended.
        complete: Whether the run reached its end; if not, the figures are those so far.
        peak_displacement: Displacement of largest size, with its sign (m).
        peak_force: Force of largest size, with its sign (N).
        dissipated: Energy dissipated by all effects (J).
        loop_area: Integral of force over displacement, by trapezoids (J).
    """

    start: float
    end: float
    complete: bool
    peak_displacement: float
    peak_force: float
    dissipated: float
    loop_area: float

    def as_dict(self) -> dict[str, float | bool]:
        """Return the figures by name, with units in the names, as the summary has them."""
        return {
            "start_s": self.start,
            "end_s": self.end,
            "complete": self.complete,
            "peak_displacement_m": self.peak_displacement,
            "peak_force_N": self.peak_force,
            "dissipated_J": self.dissipated,
            "loop_area_J": self.loop_area,
        }


def cycles(
    history: Mapping[str, NDArray[np.float64]], spans: Iterable[tuple[float, float]]
) -> list[Cycle]:
    """Return the figures of each cycle that the history entered.

    Args:
        history: Columns of ``history.csv``.
        spans: Times (s) at which each cycle begins and ends, in order.
    """
    time = history["time_s"]
    if len(time) < 2:
        return []
    slack = 1e-9 * (time[-1] - time[0])
    return [
        _cycle(history, start, end, bool(end <= time[-1] + slack))
        for start, end in spans
        if start < time[-1] - slack
    ]


def window(
    history: Mapping[str, NDArray[np.float64]], start: float, end: float
) -> dict[str, NDArray[np.float64]]:
    """Return the history from ``start`` to ``end`` (s), ends included by interpolation.

    Where the history stops before ``end``, so does what is returned.
    """
    time = history["time_s"]
    end = min(end, float(time[-1]))
    # a step that ends a rounding error beside the boundary is not a point of its own
    slack = 1e-9 * (end - start)
    inner = time[(time > start + slack) & (time < end - slack)]
    wanted = np.concatenate([[start], inner, [end]])
    return {name: np.interp(wanted, time, values) for name, values in history.items()}


def _cycle(
    history: Mapping[str, NDArray[np.float64]], start: float, end: float, complete: bool
) -> Cycle:
    part = window(history, start, end)
    u, force, lost = part["displacement_m"], part["force_N"], part["dissipated_J"]
    return Cycle(
        start=float(start),
        end=float(end),
        complete=complete,
        peak_displacement=float(u[np.abs(u).argmax()]),
        peak_force=float(force[np.abs(force).argmax()]),
        dissipated=float(lost[-1] - lost[0]),
        loop_area=float(np.trapezoid(force, u)),
    )
