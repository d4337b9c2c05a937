"""The fibres across which a placement may jump or has a kink.

Yarns on either side of such a fibre end differently: one at a clamp and the other at a
free edge, on either side of a corner, above and below a hole that they touch.

Where to cut along the fibres: even between special fibres, without slivers at the edges.

Meshes whose edges run along the fibres, for any polygon.

Nearly inextensible yarns move as threads: their motion depends on the position across
the fibre alone. Elements can represent that only if edges follow the fibres from one end
to the other. So the sheet is cut along fibres of both families, and each face of that net
is divided into triangles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import cos, sin

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wovenfab.sheet.sheet import CORNER, Outline, Ring, changes
from wovenfab.sheet.tolerance import SAME_PLACE

Array = NDArray[np.float64]


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


def pieces(outline: Outline, direction: Array, offsets: Array) -> list[Array]:
    """Return the parts of fibres of a family inside the sheet, without those along its edges.

    Args:
        outline: The sheet.
        direction: Unit vector along the fibres.
        offsets: Positions across the fibres, m.

    Returns:
        For each fibre the end points of its parts, shape (parts, 2, 2), m.
    """
    reach, least = 4 * outline.extent * direction, SAME_PLACE * outline.extent
    origins = np.multiply.outer(offsets, across(direction))
    whole = shapely.linestrings(np.stack([origins - reach, origins + reach], axis=1))
    parts, number = shapely.get_parts(
        shapely.intersection(outline.polygon, whole), return_index=True
    )
    inside = shapely.length(parts) > least
    parts, number = parts[inside], number[inside]
    # A piece along an edge is none; some may touch a corner on the way.
    places = shapely.line_interpolate_point(parts[:, None], [0.21, 0.5, 0.83], normalized=True)
    within = ~np.all(shapely.distance(outline.polygon.boundary, places) < least, axis=1)
    ends = shapely.get_coordinates(shapely.get_point(parts[within, None], [0, -1]))
    return np.split(ends.reshape(-1, 2, 2), np.searchsorted(number[within], range(1, len(offsets))))


def special_lines(outline: Outline, direction: Array, holds: Mapping[str, object]) -> FibreLines:
    """Return the special fibres of a family.

    Args:
        outline: The sheet.
        direction: Unit vector along the fibres.
        holds: How each edge holds the family; edges that are missing leave it free.
    """
    tolerance = SAME_PLACE * outline.extent
    places = [p for ring in outline.rings for p in ring.points[_special(ring, direction, holds)]]
    offsets: list[float] = []
    jumps: dict[tuple[int, ...], Array] = {}
    for place in places:
        offset = float(across(direction) @ place)
        offsets.append(offset)
        for ends in pieces(outline, direction, np.array([offset]))[0]:
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


#: Share of the turn at the vertices of a curve below which the angle between a side and a fibre is
#: made zero: a vertex moves less than the chord is away from the curve.
CHORD = 1 / 8


def curves_along_fibres(outline: Outline, fibres: Array) -> Outline:
    """Return the outline with those sides of its curves along a fibre that nearly are.

    Where a fibre touches a curve, the cells between the fibre and the next side would be as flat
    as the angle between both, which is as small as chance has it.

    Args:
        outline: The sheet.
        fibres: Unit vectors along the fibres, shape (2, 2).
    """
    moved = Outline(tuple(_curve_along_fibres(ring, fibres) for ring in outline.rings))
    return moved if moved.polygon.is_valid else outline  # curves that nearly touch


def _curve_along_fibres(ring: Ring, fibres: Array) -> Ring:
    """Return a ring with those sides of its curves along a fibre that nearly are."""
    ahead = np.roll(ring.points, -1, axis=0) - ring.points
    turns = np.abs(ring.turns)
    ends = np.stack([turns, np.roll(turns, -1)])
    points = ring.points.copy()
    for direction in fibres:
        rises = ahead @ across(direction)
        flat = np.abs(rises) < CHORD * ends.min(axis=0) * np.linalg.norm(ahead, axis=1)
        for i in np.flatnonzero(flat & (ends.max(axis=0) < CORNER)):
            # The vertex at which the fibre touches stays.
            touching = rises[i - 1] * rises[i] <= 0
            moved, shift = ((i + 1) % len(points), -rises[i]) if touching else (i, rises[i])
            points[moved] += shift * across(direction)
    return Ring(points, ring.names)


def _special(ring: Ring, direction: Array, holds: Mapping[str, object]) -> list[int]:
    """Return the vertices where the end of the fibres changes abruptly."""
    corners = np.flatnonzero(np.abs(ring.turns) > CORNER)
    offsets = ring.points @ across(direction)
    before, after = offsets - np.roll(offsets, 1), np.roll(offsets, -1) - offsets
    touching = np.flatnonzero((before * after <= 0) & (ring.turns < 0))
    return sorted({*corners, *touching, *changes(ring, holds)})


#: Share of the spacing by which a line may be moved.
SHIFT = 0.35
#: Number of places that are tried on the way.
TRIALS = 15


def evenly(special: Array, size: float) -> Array:
    """Return positions that include the special ones and are at most ``size`` apart."""
    parts = [
        np.linspace(a, b, max(1, int(np.ceil((b - a) / size * (1 - 1e-9)))) + 1)[:-1]
        for a, b in pairwise(special)
    ]
    return np.concatenate([*parts, special[-1:]])


def spaced(
    outline: Outline, fibres: Array, special: tuple[Array, Array], size: float
) -> tuple[Array, Array]:
    """Return the positions of the lines of both families, m.

    Lines of the two families that end close to one another on an edge would leave slivers:
    those between special fibres are moved a little, so that they end at the same point or
    well apart.

    Args:
        outline: The sheet.
        fibres: Unit vectors along the fibres, shape (2, 2).
        special: For each family, positions that must be among them.
        size: Largest distance between neighbours before they are moved, m.
    """
    lines = [evenly(positions, size) for positions in special]
    vertices = np.concatenate([ring.points for ring in outline.rings])
    for family in (1, 0):
        crossing = pieces(outline, fibres[1 - family], lines[1 - family])
        others = np.concatenate([vertices, *(ends.reshape(-1, 2) for ends in crossing)])
        fixed = np.isin(lines[family], special[family])
        lines[family] = np.array(
            [
                offset if stays else _moved(outline, fibres[family], offset, gap, others)
                for offset, stays, gap in zip(
                    lines[family], fixed, np.gradient(lines[family]), strict=True
                )
            ]
        )
    return lines[0], lines[1]


def _moved(outline: Outline, direction: Array, offset: float, gap: float, others: Array) -> float:
    """Return the best place for a line near its present one.

    Args:
        outline: The sheet.
        direction: Unit vector along the line.
        offset: Its present position across, m.
        gap: Distance from its neighbours, m.
        others: Where other lines end, shape (n, 2), m.
    """
    shifts = np.linspace(-SHIFT, SHIFT, TRIALS) * gap
    across = np.array([-direction[1], direction[0]])
    meeting = others @ across - offset
    candidates = np.concatenate([[0.0], shifts, meeting[np.abs(meeting) < SHIFT * gap]])
    tolerance = SAME_PLACE * outline.extent
    best, chosen = -np.inf, offset
    found = pieces(outline, direction, offset + candidates)
    near = others[np.abs(meeting) < 1.5 * gap]  # all that is closer than the gap to any end
    for shift, ends in zip(candidates, found, strict=True):
        apart = np.linalg.norm(ends.reshape(-1, 1, 2) - near[None], axis=2)
        apart = np.where(apart < tolerance, np.inf, apart).min(axis=1, initial=np.inf)
        room = float(np.minimum(apart, gap).sum() - 0.5 * abs(shift))
        room += 2 * float(np.minimum(apart.min(initial=gap), gap / 2))
        if room > best:
            best, chosen = room, offset + float(shift)
    return chosen


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
    tolerance = SAME_PLACE * outline.extent
    lines = [
        ends
        for family, positions in enumerate(offsets)
        for parts in pieces(outline, fibres[family], positions)
        for ends in parts
    ]
    vertices = np.concatenate([ring.points for ring in outline.rings])
    points = _merged(np.concatenate([vertices, *lines]), tolerance)
    places = np.unique(points, axis=0)
    # Where a fibre runs along a side, both have the ends of other lines there.
    paths = [
        _through(start, end, places, tolerance)
        for start, end in points[len(vertices) :].reshape(-1, 2, 2)
    ]
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
