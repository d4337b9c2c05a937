"""Sheets whose mesh follows the fibres, with the lines across which placements may jump.

Such a mesh may shrink towards points and edges where one placement is steep, by cutting the
cells there. At a point that leaves rings of similar cells whose size falls geometrically; along
an edge, layers of long cells parallel to it. Nothing changes elsewhere, all cells fit together,
and sides along fibres stay along fibres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil, log, sqrt

import numpy as np
import shapely
from mpi4py import MPI
from numpy.typing import ArrayLike, NDArray

from wovenfab.sheet.errors import GeometryError
from wovenfab.sheet.fibre_mesh import (
    FibreLines,
    curves_along_fibres,
    fibre_mesh,
    quality,
    spaced,
    special_lines,
)
from wovenfab.sheet.sheet import (
    CORNER,
    Outline,
    Ring,
    Sheet,
    changes,
    name_facets,
    triangle_mesh,
)
from wovenfab.sheet.tolerance import SAME_PLACE

Array = NDArray[np.float64]
Triangles = NDArray[np.int64]
#: How each edge holds a family; edges that are missing leave it free.
Holds = Mapping[str, object]
#: Share of a side that is left next to the set by default.
RATIO = 0.25
#: Sides that are shorter than so many times that distance are not cut any more.
APART = 100


def aligned_sheet(
    comm: MPI.Comm,
    outline: Outline,
    fibres: Array,
    holds: tuple[Holds, Holds],
    mesh_size: float,
    grading: Grading | None = None,
    jumps: bool = True,
) -> Sheet:
    """Return a sheet with a mesh along its fibres; collective.

    Args:
        comm: Communicator of the mesh.
        outline: The shape of the sheet with its edges.
        fibres: Unit vectors along the fibres, shape (2, 2).
        holds: For each family, how edges hold it; special fibres start where that changes.
        mesh_size: Longest side of the cells, about, m.
        grading: How the mesh shrinks towards what makes strain steep; None if it does not.
        jumps: Whether placements may jump across special fibres.
    """
    outline = curves_along_fibres(outline, fibres)
    lines = (
        special_lines(outline, fibres[0], holds[0]),
        special_lines(outline, fibres[1], holds[1]),
    )

    def build() -> tuple[Array, Triangles]:
        offsets = spaced(outline, fibres, (lines[0].offsets, lines[1].offsets), mesh_size / sqrt(2))
        points, cells = fibre_mesh(outline, fibres, offsets)
        if grading is None:
            return points, cells
        return graded(points, cells, outline, holds, lines, grading)

    mesh = triangle_mesh(comm, build)
    facets, tags = name_facets(mesh, outline)
    none = np.zeros((0, 2, 2))
    across = (lines[0].jumps, lines[1].jumps) if jumps else (none, none)
    return Sheet(mesh, facets, tags, fibres, across)


def fibre_sheet(
    points: ArrayLike,
    names: Sequence[str | None],
    fibres: ArrayLike,
    mesh_size: float,
    held: Sequence[str] = (),
    holes: Sequence[tuple[ArrayLike, Sequence[str | None]]] = (),
    *,
    graded: bool = False,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Sheet:
    """Return a sheet with a mesh along its fibres, from an outline of points; collective.

    Where two placements are simulated they may jump across the fibres at which ``held`` edges
    begin and end.

    Args:
        points: Vertices of the outside, counter-clockwise, shape (n, 2), m.
        names: Edge of the segment from each vertex to the next; None where it needs no name.
        fibres: Unit vectors along the fibres, a row a family, shape (2, 2).
        mesh_size: Longest side of the cells, about, m.
        held: Names of the edges at which placements will be held.
        holes: Vertices, clockwise, and names of each hole.
        graded: Whether the mesh shrinks towards the ends of held edges and re-entrant corners,
            as suits one placement.
        comm: Communicator of the mesh.

    Raises:
        GeometryError: The outline crosses itself, or is not turned as it must be.
        ValueError: A held edge has no segment, or the fibres are no unit vectors that cross.
    """
    rings = [(points, names), *holes]
    outline = Outline(tuple(Ring(np.array(p, dtype=float), tuple(of)) for p, of in rings))
    if not outline.polygon.is_valid or any(len(r.points) != len(r.names) for r in outline.rings):
        raise GeometryError("the outline crosses itself, or has not one name for each vertex")
    turned = [ring.turns.sum() > 0 for ring in outline.rings]
    if turned != [True, *(False for _ in holes)]:
        raise GeometryError("the outside runs counter-clockwise, and holes run clockwise")
    if missing := set(held) - {name for _, _, name in outline.segments()}:
        raise ValueError(f"no segment is named {sorted(missing)[0]!r}")
    holds = {name: name for name in held}
    grading = BONDED if graded else None
    return aligned_sheet(comm, outline, np.array(fibres), (holds, holds), mesh_size, grading)


def singular_points(outline: Outline, holds: tuple[Holds, Holds]) -> Array:
    """Return the points, shape (n, 2), where the strain of one placement is singular.

    They are the ends of clamps and the re-entrant corners.
    """
    found = []
    for ring in outline.rings:
        held = {i for h in holds for i in changes(ring, h)}
        sharp = np.flatnonzero(ring.turns < -CORNER)
        found.append(ring.points[sorted({*held, *map(int, sharp)})])
    return np.concatenate(found)


def graded(
    points: Array,
    cells: Triangles,
    outline: Outline,
    holds: tuple[Holds, Holds],
    lines: tuple[FibreLines, FibreLines],
    how: Grading,
) -> tuple[Array, Triangles]:
    """Return a mesh that shrinks towards singular points, special fibres and free edges.

    With l = (bending over stretching stiffness)^(1/2), of the order of a millimetre, the
    stretch of the yarns falls at a free edge to what the edge allows within l. The kink of
    one placement along a special fibre is spread over (l s)^(1/2) at a distance s from the
    corner where it starts: bending of the yarns that cross it against stretch of those
    along it, K_b u,2222 = K_e u,11.

    Args:
        points: Vertices, shape (n, 2), m.
        cells: Corners of the triangles, shape (m, 3).
        outline: The sheet.
        holds: For each family, how edges hold it.
        lines: For each family, its special fibres.
        how: Layers towards each.
    """
    near = shapely.MultiPoint(singular_points(outline, holds))
    free = shapely.MultiLineString(
        [(a, b) for a, b, name in outline.segments() if not any(name in h for h in holds)]
    )
    # Rings come first: fibres and edges leave cells whole that are small already. Fibres are
    # taken one by one, so that cells where two cross are cut across both.
    fibres = [shapely.LineString(ends) for family in lines for ends in family.jumps]
    size = float(np.linalg.norm(points[cells] - points[np.roll(cells, 1, 1)], axis=2).max())
    points, cells = towards(points, cells, near, how.points, size)
    for fibre in fibres:
        points, cells = towards(points, cells, fibre, how.lines, size)
    return towards(points, cells, free, how.edges, size)


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
#: scale. Cells that are small already, where a fibre nearly follows an edge, are cut less often.
#: Fibres: one layer is enough, rings have small cells already. Edges: with two, cells
#: between a half and an eighth of the width are no longer limited by them.
BONDED = Grading(Layers(8, 0.5, 0.5), Layers(1, 0.35, 0.25), Layers(2, RATIO, 0.5))
#: What suits two placements with Coulomb's friction: as one where they stick, but they slide where
#: the stress is singular, so that two rings are enough.
STICKING = Grading(Layers(2, 0.5, 0.5), BONDED.lines, Layers(1, RATIO, 0.5))


def grading_of(mesh_size: float, corner_size: float) -> Grading:
    """Return how a mesh shrinks to a given size, by quarters, without regard to fibres.

    Args:
        mesh_size: Size of the cells elsewhere, m.
        corner_size: Size at singular points, m.
    """
    count = max(0, ceil(log(corner_size / mesh_size) / log(RATIO) - 1e-9))
    edges = Layers(min(count, BONDED.edges.count), RATIO, BONDED.edges.least)
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
    reach = SAME_PLACE * float(np.abs(points).max())
    low, high = np.reshape(place.bounds, (2, 2)) + np.array([[-reach], [reach]])
    for level in range(0 if place.is_empty else layers.count):
        if layers.ratio ** (level + 1) * size < APART * reach:
            break
        on = (points >= low).all(axis=1) & (points <= high).all(axis=1)
        on[on] = shapely.distance(shapely.points(points[on]), place) < reach
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
    added: list[Array] = []
    cuts: dict[tuple[int, int], int] = {}

    def place(vertex: int) -> Array:
        return points[vertex] if vertex < len(points) else added[vertex - len(points)]

    def cut(inner: int, outer: int) -> int | None:
        """Return the number of the new vertex on a side from the set outwards, if any."""
        if (inner, outer) not in cuts:
            side = points[outer] - points[inner]
            if np.linalg.norm(side) < least:
                return None
            cuts[inner, outer] = len(points) + len(added)
            added.append(points[inner] + ratio * side)
        return cuts[inner, outer]

    inside = on[cells]
    counts = inside.sum(axis=1)
    parts, before = [], 0
    # Most cells stay whole: only those that are partly on the set are looked at one by one.
    for number in np.flatnonzero((counts == 1) | (counts == 2)):
        alone = inside[number] if counts[number] == 1 else ~inside[number]
        # Turned so that the vertex that stands alone comes first.
        a, b, c = map(int, np.roll(cells[number], -int(np.argmax(alone))))
        p, q = (cut(a, b), cut(a, c)) if counts[number] == 1 else (cut(b, a), cut(c, a))
        if p is not None and q is not None:
            found = [(a, p, q), *_halved((p, b, c, q), place)]
        elif p is not None:
            found = [(a, p, c), (p, b, c)]
        elif q is not None:
            found = [(a, b, q), (q, b, c)]
        else:
            found = [(a, b, c)]
        parts += [cells[before:number], np.array(found, dtype=np.int64)]
        before = number + 1
    shown = [points, np.array(added)] if added else [points]
    return np.concatenate(shown), np.concatenate([*parts, cells[before:]])


def _halved(
    corners: tuple[int, int, int, int], place: Callable[[int], Array]
) -> list[tuple[int, int, int]]:
    """Return the two triangles of a quadrilateral, along its better diagonal."""
    a, b, c, d = corners
    ways = [[(a, b, c), (a, c, d)], [(a, b, d), (b, c, d)]]
    return max(ways, key=lambda two: min(quality(*map(place, t)) for t in two))
