"""Meshes that shrink towards points and edges, where the strain of one placement is steep.

Every side that leaves a chosen set of vertices is cut near it, and so are the cells there.
At a point that leaves rings of similar cells whose size falls geometrically; along an edge,
layers of long cells parallel to it. Nothing changes elsewhere, all cells fit together, and
sides along fibres stay along fibres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from wovenfab.sheet.fibre_mesh import quality

Array = NDArray[np.float64]
Triangles = NDArray[np.int64]
#: Share of a side that is left next to the set: geometric meshes gain most from about 0.2.
RATIO = 0.25


def shrunk(
    points: Array, cells: Triangles, on: NDArray[np.bool_], least: float = 0.0
) -> tuple[Array, Triangles]:
    """Return a mesh with one more layer of cells around some vertices.

    Args:
        points: Vertices, shape (n, 2), m.
        cells: Corners of the triangles, counter-clockwise, shape (m, 3).
        on: Which vertices, shape (n,).
        least: Sides that are shorter stay whole, m.
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
            places.append(points[inner] + RATIO * side)
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
