"""The fibres across which a placement may jump or has a kink.

Yarns on either side of such a fibre end differently: one at a clamp and the other at a
free edge, on either side of a corner, above and below a hole that they touch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from wovenfab.sheet.outline import CORNER, Outline, Ring, changes

Array = NDArray[np.float64]
#: Positions closer than this share of the extent are the same.
SAME = 1e-9


@dataclass(frozen=True)
class FibreLines:
    """The special fibres of one family.

    Attributes:
        offsets: Their positions across the fibres, in rising order, m; the first and the
            last are the outermost fibres of the sheet.
        jumps: The parts of them across which the placement may jump: end points,
            shape (n, 2, 2), m.
    """

    offsets: Array
    jumps: Array


def across(direction: Array) -> Array:
    """Return the unit vector across a fibre, shape (2,)."""
    return np.array([-direction[1], direction[0]])


def pieces(outline: Outline, direction: Array, offset: float) -> list[Array]:
    """Return the parts of one fibre inside the sheet, without those along its edges.

    Args:
        outline: The sheet.
        direction: Unit vector along the fibre.
        offset: Position across the fibre, m.

    Returns:
        End points of each part, shape (2, 2), m.
    """
    reach, least = 4 * outline.extent, SAME * outline.extent
    origin = offset * across(direction)
    whole = shapely.LineString([origin - reach * direction, origin + reach * direction])
    found = shapely.get_parts(outline.polygon.intersection(whole))
    inside = [p for p in found if p.length > least and not _along(outline, p, least)]
    return [np.array(p.coords)[[0, -1]] for p in inside]


def _along(outline: Outline, piece: shapely.LineString, tolerance: float) -> bool:
    """Return whether a straight piece runs along an edge; some may touch a corner on the way."""
    places = piece.interpolate([0.21, 0.5, 0.83], normalized=True)
    return bool(np.all(shapely.distance(outline.polygon.boundary, places) < tolerance))


def special_lines(outline: Outline, direction: Array, holds: Mapping[str, object]) -> FibreLines:
    """Return the special fibres of a family.

    Args:
        outline: The sheet.
        direction: Unit vector along the fibres.
        holds: How each edge holds the family; edges that are missing leave it free.
    """
    tolerance = SAME * outline.extent
    places = [p for ring in outline.rings for p in ring.points[_special(ring, direction, holds)]]
    offsets: list[float] = []
    jumps: dict[tuple[int, ...], Array] = {}
    for place in places:
        offset = float(across(direction) @ place)
        offsets.append(offset)
        for ends in pieces(outline, direction, offset):
            if shapely.LineString(ends).distance(shapely.Point(place)) < tolerance:
                middle = tuple(np.rint(ends.mean(axis=0) / (10 * tolerance)).astype(np.int64))
                jumps.setdefault(middle, ends)
    outermost = np.concatenate([ring.points for ring in outline.rings]) @ across(direction)
    offsets += [outermost.min(), outermost.max()]
    parts = np.reshape(list(jumps.values()), (-1, 2, 2))
    return FibreLines(distinct(np.array(offsets), tolerance), parts)


def distinct(positions: Array, tolerance: float) -> Array:
    """Return the positions in rising order, those within the tolerance of one another once."""
    ordered = np.sort(positions)
    return np.asarray(ordered[np.concatenate([[True], np.diff(ordered) > tolerance])])


def _special(ring: Ring, direction: Array, holds: Mapping[str, object]) -> list[int]:
    """Return the vertices where the end of the fibres changes abruptly."""
    corners = np.flatnonzero(np.abs(ring.turns) > CORNER)
    offsets = ring.points @ across(direction)
    before, after = offsets - np.roll(offsets, 1), np.roll(offsets, -1) - offsets
    touching = np.flatnonzero((before * after <= 0) & (ring.turns < 0))
    return sorted({*corners, *touching, *changes(ring, holds)})
