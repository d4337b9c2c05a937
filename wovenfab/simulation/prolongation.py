"""The initial guess of degree p+1 from the solution of degree p on the same mesh."""

from __future__ import annotations

from collections.abc import Mapping

import basix.ufl
import numpy as np
from numpy.typing import NDArray

from wovenfab.model.model import Model

Array = NDArray[np.float64]


def prolongated(values: Array, low: Model, high: Model) -> Array:
    """Return unknowns of the higher degree that make the same field.

    Args:
        values: Unknowns of the lower degree with ghosts, shape (n,), m.
        low: Their model, on the same mesh as
        high: that of higher degree.
    """
    elements = [
        basix.ufl.element("Lagrange", "triangle", m.balance.degree).basix_element
        for m in (low, high)
    ]
    table = elements[0].tabulate(0, elements[1].points)[0, :, :, 0]
    of_cells = values.reshape(-1, 2)[low.placements.blocks]
    result = np.zeros(high.field.x.array.size).reshape(-1, 2)
    result[high.placements.blocks] = np.einsum("ij,cjkd->cikd", table, of_cells)
    return result.ravel()


class Prolongation:
    """Initial guesses of steps from states of lower degree and the corrections so far.

    The correction by the higher degree is as smooth in time as the motion: it is extrapolated
    linearly.
    """

    def __init__(self, states: Mapping[float, Array], low: Model, high: Model) -> None:
        """Start without any step.

        Args:
            states: Unknowns of the lower degree with ghosts (m) by time (s).
            low: Their model, on the same mesh as
            high: the one that is stepped.
        """
        self._states, self._low, self._high = states, low, high
        self._corrections: list[tuple[float, Array]] = []

    def guess(self, time: float) -> Array | None:
        """Return the initial guess for a time, or None where there is no state of lower degree."""
        if (state := self._prolongated(time)) is None:
            return None
        if self._corrections:
            (then, last), *before = reversed(self._corrections)
            state += last
            for earlier, previous in before:
                state += (last - previous) * ((time - then) / (then - earlier))
        return state

    def accept(self, time: float) -> None:
        """Store the correction in the model's present field."""
        if (state := self._prolongated(time)) is not None:
            correction = (time, self._high.field.x.array - state)
            self._corrections = [*self._corrections[-1:], correction]

    def _prolongated(self, time: float) -> Array | None:
        state = self._states.get(time)
        return None if state is None else prolongated(state, self._low, self._high)
