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
        peak_time: When it is farthest from where it began (s): the reversal.
        peak_displacement: Displacement then (m).
        peak_force: Force of largest size, with its sign (N).
        residual_force: Force at its end (N).
        secant_stiffness: Slope from its beginning to the reversal (N/m).
        loop_area: Integral of force over displacement, by trapezoids (J).
        stored_at_peak: Energy stored at the reversal (J).
        dissipated: Energy dissipated by all effects (J).
        imbalance: Change of the energy imbalance (J).
    """

    start: float
    end: float
    complete: bool
    peak_time: float
    peak_displacement: float
    peak_force: float
    residual_force: float
    secant_stiffness: float | None
    loop_area: float
    stored_at_peak: float
    dissipated: float
    imbalance: float

    @property
    def loss_ratio(self) -> float | None:
        """Loop area over stored energy; None for part of a loop, or where nothing is stored."""
        stores = self.complete and self.stored_at_peak > 0
        return self.loop_area / self.stored_at_peak if stores else None

    def as_dict(self) -> dict[str, float | bool | None]:
        """Return the figures by name, with units in the names, as the summary has them."""
        return {
            "start_s": self.start,
            "end_s": self.end,
            "complete": self.complete,
            "peak_time_s": self.peak_time,
            "peak_displacement_m": self.peak_displacement,
            "peak_force_N": self.peak_force,
            "residual_force_N": self.residual_force,
            "secant_stiffness_N_per_m": self.secant_stiffness,
            "loop_area_J": self.loop_area,
            "stored_at_peak_J": self.stored_at_peak,
            "loss_ratio": self.loss_ratio,
            "dissipated_J": self.dissipated,
            "imbalance_J": self.imbalance,
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
    u, force = part["displacement_m"], part["force_N"]
    turn = int(np.abs(u - u[0]).argmax())
    way = float(u[turn] - u[0])
    return Cycle(
        start=float(start),
        end=float(end),
        complete=complete,
        peak_time=float(part["time_s"][turn]),
        peak_displacement=float(u[turn]),
        peak_force=float(force[np.abs(force).argmax()]),
        residual_force=float(force[-1]),
        secant_stiffness=float(force[turn] - force[0]) / way if way else None,
        loop_area=float(np.trapezoid(force, u)),
        stored_at_peak=float(part["energy_J"][turn]),
        dissipated=_change(part["dissipated_J"]),
        imbalance=_change(part["imbalance_J"]),
    )


def _change(values: NDArray[np.float64]) -> float:
    return float(values[-1] - values[0])
