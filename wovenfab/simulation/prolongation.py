"""A field of one degree in the unknowns of a higher one.

Where steps begin with elements of higher degree: at the answer of the lower one.
"""

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
    """States near those of a model: of lower degree, and what that lacked in the last steps.

    The lack changes as smoothly as the motion, so that it is carried on along a line.
    """

    def __init__(self, states: Mapping[float, Array], low: Model, high: Model) -> None:
        """Begin without any step.

        Args:
            states: Unknowns of the lower degree with ghosts (m) by time (s).
            low: Their model, on the same mesh as
            high: the one that steps.
        """
        self._states, self._low, self._high = states, low, high
        self._lacks: list[tuple[float, Array]] = []

    def guess(self, time: float) -> Array | None:
        """Return the state to begin at for a time, or None where the lower degree has none."""
        if (state := self._raised(time)) is None:
            return None
        if self._lacks:
            (then, lack), *before = reversed(self._lacks)
            state += lack
            for earlier, less in before:
                state += (lack - less) * ((time - then) / (then - earlier))
        return state

    def accept(self, time: float) -> None:
        """Note what the lower degree lacked in the model's present field."""
        if (state := self._raised(time)) is not None:
            lack = (time, self._high.field.x.array - state)
            self._lacks = [*self._lacks[-1:], lack]

    def _raised(self, time: float) -> Array | None:
        state = self._states.get(time)
        return None if state is None else prolongated(state, self._low, self._high)
