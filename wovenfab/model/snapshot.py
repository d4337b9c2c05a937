"""Snapshots: what the next step depends on, as a tree of dictionaries and lists.

Objects with a memory have ``snapshot()``, which returns it, and ``resume(snapshot)``, which
takes it. Leaves are plain values, arrays over the unknowns of a rank (with ghosts, or its own
ones alone) and values at quadrature points.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PointValues:
    """Values at the quadrature points of a rank's own cells.

    Attributes:
        parts: One array for each friction, shape (own cells, values of a cell).
    """

    parts: tuple[Array, ...]


def attributes(owner: object, *names: str) -> dict[str, Any]:
    """Return attributes by name, without a leading underscore."""
    return {name.lstrip("_"): getattr(owner, name) for name in names}


def take_attributes(owner: object, snapshot: Mapping[str, Any], *names: str) -> None:
    """Set attributes as :func:`attributes` returned them."""
    for name in names:
        setattr(owner, name, snapshot[name.lstrip("_")])
