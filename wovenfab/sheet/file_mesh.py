"""Nodes and elements of a file, as its reader hands them on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Group:
    """A physical group.

    Attributes:
        name: Its name, which may be empty.
        members: Numbers of its curves or surfaces.
        missing: Numbers that it names and that are not there.
        place: The line that defines it, in words, where that is known.
    """

    name: str
    members: tuple[int, ...]
    missing: tuple[int, ...] = ()
    place: str = ""


@dataclass(frozen=True)
class FileMesh:
    """A mesh in the unit of its file.

    Attributes:
        points: Nodes, shape (n, 3).
        curves: Rows of the ends of each curve's line elements, shape (k, 2).
        surfaces: Rows of the corners of each surface's triangles, shape (m, 3).
        curve_groups: Physical groups of curves.
        surface_groups: Physical groups of surfaces.
        other_cells: Whether surfaces have elements that are no triangles.
        recombining: The line of a geometry that makes them, in words, where there is one.
        boolean: The line of a Boolean operation.
    """

    points: Array
    curves: Mapping[int, Rows]
    surfaces: Mapping[int, Rows]
    curve_groups: tuple[Group, ...] = ()
    surface_groups: tuple[Group, ...] = ()
    other_cells: bool = False
    recombining: str = ""
    boolean: str = ""
