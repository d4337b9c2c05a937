"""A field of one degree in the unknowns of a higher one."""

from __future__ import annotations

import basix.ufl
import numpy as np
from numpy.typing import NDArray

from wovenfab.model.model import Model

Array = NDArray[np.float64]


def raised(values: Array, low: Model, high: Model) -> Array:
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
