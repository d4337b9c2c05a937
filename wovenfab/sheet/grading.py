"""Meshes that shrink towards points and edges, where the strain of one placement is steep.

Every side that leaves a chosen set of vertices is cut near it, and so are the cells there.
At a point that leaves rings of similar cells whose size falls geometrically; along an edge,
layers of long cells parallel to it. Nothing changes elsewhere, all cells fit together, and
sides along fibres stay along fibres.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, log

import numpy as np
import shapely
from numpy.typing import NDArray

from wovenfab.sheet.fibre_mesh import quality

Array = NDArray[np.float64]
Triangles = NDArray[np.int64]
#: Share of a side that is left next to the set by default.
RATIO = 0.25
#: A vertex lies on a place that it is this close to, as a share of the largest coordinate.
ON_PLACE = 1e-8
#: Sides that are shorter than so many times that distance are not cut any more.
APART = 100


@dataclass(frozen=True)
class Layers:
    """How often and how fast a mesh shrinks towards a set.

    Attributes:
        count: Number of layers.
        ratio: Share of a side that each leaves next to the set.
        least: Sides that are shorter than this share of the longest one stay whole, and
            for each further layer than ``ratio`` times that.
    """

    count: int
    ratio: float = RATIO
    least: float = 0.0


@dataclass(frozen=True)
class Grading:
    """How a mesh shrinks towards what makes the strain of one placement steep.

    Attributes:
        points: Towards singular points.
        lines: Towards the special fibres that start there.
        edges: Towards edges that hold nothing.
    """

    points: Layers
    lines: Layers
    edges: Layers


#: What suits one placement with elements of degree 3 and 4, cells of a tenth of the width to
#: the width. Points: the force still feels rings a hundredth of a cell wide, and sees the
#: difference between halves and quarters because two cells must span the corner at every
#: scale. Fibres: one layer is enough, rings have small cells already. Edges: with two, cells
#: between a half and an eighth of the width are no longer limited by them.
STEEP = Grading(Layers(8, 0.5), Layers(1, 0.35, 0.25), Layers(2, RATIO, 0.5))


def grading_of(mesh_size: float, corner_size: float | None) -> Grading:
    """Return how a mesh shrinks.

    Args:
        mesh_size: Size of the cells elsewhere, m.
        corner_size: Size at singular points, m, which is reached by quarters, without
            regard to fibres; None for what suits one placement.
    """
    if corner_size is None:
        return STEEP
    count = max(0, ceil(log(corner_size / mesh_size) / log(RATIO) - 1e-9))
    edges = Layers(min(count, STEEP.edges.count), RATIO, STEEP.edges.least)
    return Grading(Layers(count), Layers(0), edges)


def towards(
    points: Array, cells: Triangles, place: shapely.Geometry, layers: Layers, size: float
) -> tuple[Array, Triangles]:
    """Return a mesh that shrinks towards a place by layers, as long as vertices are told apart.

    Args:
        points: Vertices, shape (n, 2), m.
        cells: Corners of the triangles, counter-clockwise, shape (m, 3).
        place: What it shrinks towards: vertices or along sides of the mesh.
        layers: How often and how fast.
        size: Longest side before anything shrank, m.
    """
    reach = ON_PLACE * float(np.abs(points).max())
    for level in range(0 if place.is_empty else layers.count):
        if layers.ratio ** (level + 1) * size < APART * reach:
            break
        on = shapely.distance(shapely.points(points), place) < reach
        least = layers.least * size * layers.ratio**level
        points, cells = shrunk(points, cells, on, least, layers.ratio)
    return points, cells


def shrunk(
    points: Array,
    cells: Triangles,
    on: NDArray[np.bool_],
    least: float = 0.0,
    ratio: float = RATIO,
) -> tuple[Array, Triangles]:
    """Return a mesh with one more layer of cells around some vertices.

    Args:
        points: Vertices, shape (n, 2), m.
        cells: Corners of the triangles, counter-clockwise, shape (m, 3).
        on: Which vertices, shape (n,).
        least: Sides that are shorter stay whole, m.
        ratio: Share of a side that is left next to those vertices.
    """
    places: list[Array] = list(points)
    cuts: dict[tuple[int, int], int] = {}

    def cut(inner: int, outer: int) -> int | None:
        """Return the number of the new vertex on a side from the set outwards, if any."""
        if (inner, outer) not in cuts:
            side = points[outer] - points[inner]
            if np.linalg.norm(side) < least:
                return None
            cuts[inner, outer] = len(places)
            places.append(points[inner] + ratio * side)
        return cuts[inner, outer]

    found: list[tuple[int, int, int]] = []
    for cell in cells:
        inside = on[cell]
        count = int(inside.sum())
        if count in (0, 3):
            found.append(tuple(cell))
            continue
        # Turned so that the vertex that stands alone comes first.
        a, b, c = np.roll(cell, -int(np.argmax(inside if count == 1 else ~inside)))
        p, q = (cut(a, b), cut(a, c)) if count == 1 else (cut(b, a), cut(c, a))
        if p is not None and q is not None:
            found += [(a, p, q), *_halved((p, b, c, q), places)]
        elif p is not None:
            found += [(a, p, c), (p, b, c)]
        elif q is not None:
            found += [(a, b, q), (q, b, c)]
        else:
            found.append((a, b, c))
    return np.array(places), np.array(found, dtype=np.int64)


def _halved(corners: tuple[int, int, int, int], places: list[Array]) -> list[tuple[int, int, int]]:
    """Return the two triangles of a quadrilateral, along its better diagonal."""
    a, b, c, d = corners
    ways = [[(a, b, c), (a, c, d)], [(a, b, d), (b, c, d)]]
    return max(ways, key=lambda two: min(quality(*(places[i] for i in t)) for t in two))
