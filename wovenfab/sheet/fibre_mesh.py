"""Meshes whose edges run along the fibres, for any polygon.

Nearly inextensible yarns move as threads: their motion depends on the position across
the fibre alone. Elements can represent that only if edges follow the fibres from one end
to the other. So the sheet is cut along fibres of both families, and each face of that net
is divided into triangles.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wovenfab.sheet.fibre_lines import SAME, pieces
from wovenfab.sheet.outline import Outline

Array = NDArray[np.float64]
Triangles = NDArray[np.int64]
#: Direction of the sides that are added where both choices are as good; along no symmetry.
PREFERRED = (cos(0.3), sin(0.3))
#: Digits to which two choices are as good.
DIGITS = 9


def fibre_mesh(
    outline: Outline, fibres: Array, offsets: Sequence[Array]
) -> tuple[Array, Triangles]:
    """Return points, shape (n, 2), and corners of triangles, shape (m, 3).

    Args:
        outline: The sheet.
        fibres: Unit vectors along the fibres, shape (2, 2).
        offsets: For each family, positions across its fibres of the lines to cut along, m.
    """
    numbers: dict[tuple[float, float], int] = {}
    cells = []
    for face in _faces(outline, fibres, offsets):
        ring = np.array(shapely.geometry.polygon.orient(face).exterior.coords)[:-1]
        corners = [numbers.setdefault((x, y), len(numbers)) for x, y in ring]
        cells += [[corners[i] for i in triangle] for triangle in divided(ring)]
    return np.array(list(numbers)), np.array(cells, dtype=np.int64)


def _faces(outline: Outline, fibres: Array, offsets: Sequence[Array]) -> Sequence[shapely.Polygon]:
    """Return the faces of the net; lines that end at one place end at one point."""
    tolerance = SAME * outline.extent
    lines = [
        ends
        for family, positions in enumerate(offsets)
        for offset in positions
        for ends in pieces(outline, fibres[family], offset)
    ]
    vertices = np.concatenate([ring.points for ring in outline.rings])
    points = _merged(np.concatenate([vertices, *lines]), tolerance)
    known = points[: len(vertices)], points[len(vertices) :].reshape(-1, 2, 2)
    paths = [_through(start, end, known[0], tolerance) for start, end in known[1]]
    places = np.unique(points, axis=0)
    edges = [_through(start, end, places, tolerance) for start, end, _ in outline.segments()]
    noded = shapely.union_all([shapely.LineString(path) for path in (*paths, *edges)])
    faces = shapely.get_parts(shapely.polygonize([noded]))
    return [f for f in faces if outline.polygon.contains(f.representative_point())]


def _merged(points: Array, tolerance: float) -> Array:
    """Return the points, each replaced by the first one within the tolerance."""
    pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    first = np.arange(len(points))
    for low, high in pairs[np.lexsort(pairs.T[::-1])]:
        first[high] = min(first[high], first[low])
    return np.asarray(points[first])


def _through(start: Array, end: Array, places: Array, tolerance: float) -> Array:
    """Return the path from start to end through those places that lie between them."""
    length = float(np.linalg.norm(end - start))
    ahead = (end - start) / length
    away = places - start
    position = away @ ahead
    aside = np.abs(away[:, 0] * ahead[1] - away[:, 1] * ahead[0])
    between = (aside < tolerance) & (position > tolerance) & (position < length - tolerance)
    order = np.argsort(position[between])
    return np.concatenate([[start], places[between][order], [end]])


def divided(ring: Array) -> list[tuple[int, int, int]]:
    """Divide a simple polygon into triangles by its vertices, the worst as good as it can be.

    Where that leaves a choice, as in a square, the sides that are added run along
    ``PREFERRED`` as far as they can: rounding must not decide, or a sheet in other units
    would have another mesh.

    Args:
        ring: Vertices, counter-clockwise, shape (n, 2).

    Returns:
        Numbers of the vertices of each triangle, counter-clockwise.
    """
    n = len(ring)
    best = {(i, i + 1): (np.inf, 0.0, -1) for i in range(n)}
    for gap in range(2, n):
        for i in range(n - gap):
            j = i + gap
            added = _straightness(ring[i], ring[j]) if gap < n - 1 else 0.0
            best[i, j] = max(
                (
                    min(round(quality(ring[i], ring[k], ring[j]), DIGITS), first[0], second[0]),
                    round(added + first[1] + second[1], DIGITS),
                    k,
                )
                for k in range(i + 1, j)
                for first, second in [(best[i, k], best[k, j])]
            )
    found, open_sides = [], [(0, n - 1)]
    while open_sides:
        i, j = open_sides.pop()
        k = best[i, j][2]
        if k >= 0:
            found.append((i, k, j))
            open_sides += [(i, k), (k, j)]
    return found


def _straightness(a: Array, b: Array) -> float:
    """Return how far a side runs along ``PREFERRED``, 0 to 1."""
    x, y = b - a
    return float(abs(x * PREFERRED[0] + y * PREFERRED[1]) / np.hypot(x, y))


def quality(a: Array, b: Array, c: Array) -> float:
    """Return the height of a triangle over its longest side; negative if it is clockwise."""
    twice = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    sides = ((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 for p, q in ((a, b), (b, c), (c, a)))
    return float(twice / max(sides))
