"""The narrowest place of a sheet, and its flattest cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from wovenfab.compat import corners_of
from wovenfab.sheet.sheet import Outline, placed
from wovenfab.sheet.tolerance import SAME_PLACE

Array = NDArray[np.float64]
#: Two parts of a ring face each other if the way along it is this many times their distance.
FACING = 3.0
#: Width, as a share of the size of the sheet, below which a place is too narrow to compute with:
#: positions have 16 digits, and stiffness loses twice as many of them as the width does.
TOO_NARROW = 1e-5
#: Height of a cell over its length below which rounding errors may decide on its stiffness.
TOO_FLAT = 1e-3


@dataclass(frozen=True)
class NarrowPlace:
    """Where two parts of the outline come closest, inside or outside of the sheet.

    Attributes:
        point: The middle between them, shape (2,), m.
        width: Their distance, or the length of a side that keeps two others so little apart, m.
        share: Of the size of the sheet.
    """

    point: Array
    width: float
    share: float

    @property
    def is_too_narrow(self) -> bool:
        """Whether a computation will hardly succeed there."""
        return self.share < TOO_NARROW

    def __str__(self) -> str:
        """Say how wide it is, and where."""
        wide = f"{self.width:.3g} m wide ({self.share:.2g} of the size of the sheet)"
        return f"the narrowest place is {wide}, at {placed(self.point)}"


def narrowest(outline: Outline) -> NarrowPlace | None:
    """Return where two parts of an outline that face each other come closest.

    From corners and middles of segments the distances to all other segments are measured. Parts
    of one ring that are near each other along it, such as the sides of a corner, do not count, but
    for those that a side keeps too little apart: cells of its length are computed there.

    Args:
        outline: The sheet.
    """
    starts, ends, ring, ways, lengths = _segments(outline)
    best, place = np.inf, None
    size = float(np.ptp(starts, axis=0).max())
    along = ends - starts
    squares = np.maximum((along**2).sum(axis=1), np.finfo(float).tiny)
    for i in range(len(starts)):
        for share in (0.0, 0.5):
            point, way = starts[i] + share * along[i], ways[i] + share * np.sqrt(squares[i])
            position = np.clip(((point - starts) * along).sum(axis=1) / squares, 0.0, 1.0)
            feet = starts + position[:, None] * along
            distances = np.linalg.norm(point - feet, axis=1)
            between = np.abs(ways + position * np.sqrt(squares) - way)
            between = np.minimum(between, lengths[ring] - between)
            facing = (ring != ring[i]) | (
                between > FACING * np.maximum(distances, SAME_PLACE * size)
            )
            distances[~facing] = np.inf
            if distances.min() < best:
                nearest = int(distances.argmin())
                best, place = float(distances[nearest]), (point + feet[nearest]) / 2
    shortest = int(squares.argmin())
    if (side := float(np.sqrt(squares[shortest]))) < min(best, TOO_NARROW * size):
        best, place = side, starts[shortest] + along[shortest] / 2
    return None if place is None else NarrowPlace(place, best, best / size)


def _segments(outline: Outline) -> tuple[Array, Array, NDArray[np.int64], Array, Array]:
    """Return starts, ends and rings of segments, ways to their starts, and lengths of the rings."""
    after = [np.roll(ring.points, -1, axis=0) for ring in outline.rings]
    sides = [
        np.linalg.norm(end - ring.points, axis=1)
        for end, ring in zip(after, outline.rings, strict=True)
    ]
    return (
        np.concatenate([ring.points for ring in outline.rings]),
        np.concatenate(after),
        np.concatenate([np.full(len(side), number) for number, side in enumerate(sides)]),
        np.concatenate([np.cumsum(side) - side for side in sides]),
        np.array([side.sum() for side in sides]),
    )


@dataclass(frozen=True)
class FlatCell:
    """The flattest cell of a mesh.

    Attributes:
        point: Its middle, shape (2,), m.
        height: Least height, m.
        length: Longest side, m.
    """

    point: Array
    height: float
    length: float

    @property
    def is_too_flat(self) -> bool:
        """Whether rounding errors may decide on its stiffness."""
        return self.height < TOO_FLAT * self.length

    def __str__(self) -> str:
        """Say where it is, and how flat."""
        sizes = f"{self.length:.3g} m long and {self.height:.3g} m high"
        return f"the flattest cell, at {placed(self.point)}, is {sizes}"


def flattest_cell(mesh: Mesh) -> FlatCell:
    """Return the flattest cell of a mesh; collective."""
    corners = mesh.geometry.x[corners_of(mesh)[: mesh.topology.index_map(2).size_local], :2]
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    (x, y), (u, v) = sides[:, 0].T, sides[:, 1].T
    heights = np.abs(x * v - y * u) / longest
    found = []
    if len(corners):
        i = int((heights / longest).argmin())
        found.append(FlatCell(corners[i].mean(axis=0), float(heights[i]), float(longest[i])))
    cells: list[FlatCell] = [cell for part in mesh.comm.allgather(found) for cell in part]
    return min(cells, key=lambda cell: cell.height / cell.length)
