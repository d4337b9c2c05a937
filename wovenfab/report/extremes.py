"""The times that tell most of a run: where each cycle turns, and where it ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wovenfab.record.stored_fields import StoredFields
from wovenfab.report.source import Source
from wovenfab.report.style import MILLIMETRE


@dataclass(frozen=True)
class Extreme:
    """A stored time.

    Attributes:
        index: Its place among the stored times.
        displacement: Displacement of the program then (m).
        words: Which one it is.
    """

    index: int
    displacement: float
    words: str


def largest(source: Source, stored: StoredFields) -> Extreme:
    """Return the stored time of largest displacement."""
    u = _displacement(source, stored)
    index = int(np.abs(u).argmax())
    return Extreme(index, float(u[index]), f"at {_length(u[index])}")


def extremes(source: Source, stored: StoredFields, most: int = 4) -> list[tuple[Extreme, Extreme]]:
    """Return the reversal and the end of each cycle, as near as fields were stored.

    Args:
        source: The run; where it has no cycles, the whole run is taken for one.
        stored: Its fields, of one time at least.
        most: Number of cycles; if there are more, the first, the last and some between.
    """
    u = _displacement(source, stored)
    spans = [(f"cycle {i}", c.start, c.end) for i, c in enumerate(source.cycles, 1)]
    spans = spans or [("run", 0.0, float(stored.times[-1]))]
    if len(spans) > most:
        spans = [spans[round(i)] for i in np.linspace(0, len(spans) - 1, most)]
    slack = 1e-9 * stored.times[-1]
    found = []
    for name, start, end in spans:
        (inside,) = np.nonzero((stored.times >= start - slack) & (stored.times <= end + slack))
        if not len(inside):
            continue
        turn = inside[np.abs(u[inside] - u[inside[0]]).argmax()]
        found.append(
            (
                Extreme(int(turn), float(u[turn]), f"{name}, {_length(u[turn])}"),
                Extreme(int(inside[-1]), float(u[inside[-1]]), f"end of {name}"),
            )
        )
    return found


def _displacement(source: Source, stored: StoredFields) -> NDArray[np.float64]:
    history = source.history
    return np.interp(stored.times, history["time_s"], history["displacement_m"])


def _length(metres: float) -> str:
    return f"{metres * MILLIMETRE.factor:.3g} mm"
