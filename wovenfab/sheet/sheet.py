"""The sheet: a triangle mesh with named edges and two fibre directions; structured rectangles.

An outline has closed rings of straight segments, each on a named edge or on none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from math import ceil, cos, sin

import basix.ufl
import numpy as np
import shapely
import ufl
from dolfinx.mesh import (
    CellType,
    DiagonalType,
    GhostMode,
    Mesh,
    MeshTags,
    compute_midpoints,
    create_mesh,
    create_rectangle,
    entities_to_geometry,
    exterior_facet_indices,
    meshtags,
)
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.compat import cell_partitioner, corners_of
from wovenfab.parallel import from_root
from wovenfab.sheet.errors import GeometryError as GeometryError
from wovenfab.sheet.tolerance import LEAST_CROSSING, SAME_DIRECTION, SAME_PLACE

Array = NDArray[np.float64]
Triangles = NDArray[np.int64]
#: Turn (rad) above which a vertex is a corner; below, it is one of a curve's many.
CORNER = np.radians(20)


@dataclass(frozen=True)
class Ring:
    """A closed ring with the sheet on its left: the outside runs counter-clockwise.

    Attributes:
        points: Vertices, shape (n, 2), m.
        names: Edge of the segment from each vertex to the next; None where it has no name.
    """

    points: Array
    names: tuple[str | None, ...]

    @cached_property
    def turns(self) -> Array:
        """Change of direction (rad) at each vertex; negative at re-entrant ones."""
        ahead = np.roll(self.points, -1, axis=0) - self.points
        back = np.roll(ahead, 1, axis=0)
        cross = back[:, 0] * ahead[:, 1] - back[:, 1] * ahead[:, 0]
        return np.asarray(np.arctan2(cross, (back * ahead).sum(axis=1)))


@dataclass(frozen=True)
class Outline:
    """Outside and holes of a sheet."""

    rings: tuple[Ring, ...]

    @cached_property
    def polygon(self) -> shapely.Polygon:
        """The same region as a polygon of shapely."""
        outside, *holes = (ring.points for ring in self.rings)
        return shapely.Polygon(outside, holes)

    @cached_property
    def extent(self) -> float:
        """Largest absolute coordinate, m, which sets the rounding of positions."""
        return float(max(np.abs(ring.points).max() for ring in self.rings))

    def segments(self) -> list[tuple[Array, Array, str | None]]:
        """Return start, end and edge of every segment."""
        return [
            (ring.points[i], ring.points[(i + 1) % len(ring.names)], name)
            for ring in self.rings
            for i, name in enumerate(ring.names)
        ]


def rectangle_outline(length: float, width: float) -> Outline:
    """Return the outline of a rectangle with its lower left corner at the origin."""
    points = np.array([(0.0, 0.0), (length, 0.0), (length, width), (0.0, width)])
    return Outline((Ring(points, ("bottom", "right", "top", "left")),))


def outline_of(
    points: Array, triangles: Triangles, named: Mapping[str, NDArray[np.int64]]
) -> Outline:
    """Return the outline of a mesh.

    Args:
        points: Vertices, shape (n, 2), m.
        triangles: Corners of the cells, shape (m, 3).
        named: Pairs of vertices of the segments on each named edge, shape (n, 2).

    Raises:
        GeometryError: The mesh is not one sheet.
    """
    names = {frozenset(map(int, pair)): name for name, pairs in named.items() for pair in pairs}
    following = {int(a): int(b) for a, b in free_sides(points, triangles)}
    rings = []
    while following:
        start = min(following)
        chain, way = [start], following.pop(start)
        while way != start:
            chain.append(way)
            way = following.pop(way)
        labels = [names.get(frozenset(pair)) for pair in pairwise([*chain, start])]
        rings.append(_straightened(Ring(points[chain], tuple(labels))))
    outline = Outline(tuple(sorted(rings, key=_area, reverse=True)))
    if len(pieces := [ring for ring in outline.rings if _area(ring) > 0]) > 1:
        raise GeometryError(
            f"the sheet is in {len(pieces)} pieces, the second one at "
            f"{placed(pieces[1].points[0])}; join them, as BooleanUnion or BooleanFragments do, "
            "or leave all but one out of the Physical Surface"
        )
    if not outline.polygon.is_valid:
        why = shapely.is_valid_reason(outline.polygon)
        raise GeometryError(f"the outline crosses itself ({why}, m); move its parts apart there")
    return outline


def free_sides(points: Array, triangles: Triangles) -> NDArray[np.int64]:
    """Return the sides of one triangle only, the mesh on their left, shape (n, 2).

    Args:
        points: Vertices, shape (n, 2), m.
        triangles: Corners of the cells, shape (m, 3).

    Raises:
        GeometryError: Cells are flat or overlap, or the mesh touches itself in a point.
    """
    one, two = (points[triangles[:, i]] - points[triangles[:, 0]] for i in (1, 2))
    cross = one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]
    if not np.all(cross):
        place = placed(points[triangles[np.argmin(np.abs(cross)), 0]])
        raise GeometryError(f"a cell at {place} is flat; mesh it with other sizes there")
    turned = np.where((cross > 0)[:, None], triangles, triangles[:, ::-1])
    sides = np.concatenate([turned[:, [i, (i + 1) % 3]] for i in range(3)])
    ahead, back = (sides[:, [i, 1 - i]] @ [len(points), 1] for i in (0, 1))
    free: Triangles = sides[~np.isin(ahead, back)]
    starts, counts = np.unique(free[:, 0], return_counts=True)
    if len(np.unique(ahead)) < len(ahead) or counts.max() > 1:
        number = starts[counts.argmax()]
        raise GeometryError(
            f"the sheet touches or overlaps itself at {placed(points[number])}; let its parts "
            "share a curve there, or keep them apart"
        )
    return free


def placed(point: Array) -> str:
    """Return a position in words."""
    return f"x = {point[0]:.4g} m, y = {point[1]:.4g} m"


def _straightened(ring: Ring) -> Ring:
    """Return the ring without vertices inside straight stretches of one edge."""
    before = np.roll(np.array(ring.names, dtype=object), 1)
    keep = (np.abs(ring.turns) > SAME_DIRECTION) | (before != np.array(ring.names, dtype=object))
    names = [name for name, kept in zip(ring.names, keep, strict=True) if kept]
    return Ring(ring.points[keep], tuple(names))


def _area(ring: Ring) -> float:
    """Return the signed area (m²): positive for the outside, negative for holes."""
    x, y = ring.points.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def changes(ring: Ring, holds: Mapping[str, object]) -> Iterable[int]:
    """Return the vertices where a family stops being held as before.

    Args:
        ring: A ring of the outline.
        holds: How each edge holds the family; edges that are missing leave it free.
    """
    states = [holds.get(name) if name is not None else None for name in ring.names]
    return [i for i in range(len(states)) if states[i] != states[i - 1]]


PATTERNS = {"crossed": DiagonalType.crossed, "right": DiagonalType.right}


@dataclass(frozen=True)
class Sheet:
    """A meshed sheet.

    Attributes:
        mesh: Triangles, coordinates in m.
        facets: Facets tagged by the edge they lie on.
        edges: Tag of each named edge.
        fibres: Reference directions D_1, D_2, shape (2, 2), a row a family.
        jumps: For each family, lines along facets and fibres across which its placement
            may jump: end points, shape (n, 2, 2), m.
    """

    mesh: Mesh
    facets: MeshTags
    edges: dict[str, int]
    fibres: NDArray[np.float64]
    jumps: tuple[NDArray[np.float64], NDArray[np.float64]] = field(
        default_factory=lambda: (np.zeros((0, 2, 2)), np.zeros((0, 2, 2)))
    )

    def __post_init__(self) -> None:
        """Refuse a mesh that cannot be used; collective.

        Raises:
            ValueError: The cells are no plane triangles with straight sides, ranks lack the cells
                beside their own, or the fibres are no unit vectors that cross.
        """
        mesh = self.mesh
        if mesh.topology.cell_type != CellType.triangle or mesh.geometry.dim != 2:
            raise ValueError("the cells must be triangles in a plane (geometric dimension 2)")
        if mesh.ufl_domain().ufl_coordinate_element().embedded_superdegree != 1:
            raise ValueError("the triangles must have straight sides (geometry of degree 1)")
        ghosts = mesh.comm.allreduce(mesh.topology.index_map(2).num_ghosts)
        if mesh.comm.size > 1 and not ghosts:
            raise ValueError(
                "ranks lack the cells beside their own, over whose sides bending is integrated: "
                "make the mesh with ghost_mode=dolfinx.mesh.GhostMode.shared_facet"
            )
        lengths, (one, two) = np.linalg.norm(self.fibres, axis=1), self.fibres
        if np.shape(self.fibres) != (2, 2) or not np.allclose(lengths, 1, rtol=0, atol=1e-12):
            raise ValueError("fibres are two unit vectors, a row a family")
        if abs(one[0] * two[1] - one[1] * two[0]) < LEAST_CROSSING:
            raise ValueError("the fibres of both families must cross")

    @property
    def original_cells(self) -> NDArray[np.int64]:
        """Return the number of each local cell that does not depend on the ranks."""
        numbers: NDArray[np.int64] = self.mesh.topology.original_cell_index
        return numbers

    def edge_facets(self, name: str) -> NDArray[np.int32]:
        """Return the local facets on the named edge."""
        facets: NDArray[np.int32] = self.facets.find(self.edges[name])
        return facets

    def edge_points(self, name: str) -> Array:
        """Return the vertices on the named edge, shape (n, 2), m; collective.

        Each is there at least once, in no order.
        """
        self.mesh.topology.create_connectivity(1, 2)
        facets = self.edge_facets(name)  # dolfinx divides by zero where a rank has none
        corners = entities_to_geometry(self.mesh, 1, facets) if len(facets) else facets
        own = self.mesh.geometry.x[corners.ravel(), :2]
        return np.concatenate(self.mesh.comm.allgather(own))

    def area(self) -> float:
        """Return the area at rest, m^2; collective."""
        own = corners_of(self.mesh)[: self.mesh.topology.index_map(2).size_local]
        one, two = (
            self.mesh.geometry.x[own[:, i]] - self.mesh.geometry.x[own[:, 0]] for i in (1, 2)
        )
        twice = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum()
        return float(self.mesh.comm.allreduce(twice) / 2)


def quadrature_points(mesh: Mesh, degree: int) -> Array:
    """Return the points of a quadrature rule in this rank's cells and on their sides.

    Args:
        mesh: Triangles.
        degree: Degree of polynomials that the rule integrates exactly.

    Returns:
        Positions, shape (n, 2), m.
    """
    inside, _ = basix.make_quadrature(basix.CellType.triangle, degree)
    along = basix.make_quadrature(basix.CellType.interval, degree)[0][:, 0]
    sides = [np.stack(side, axis=1) for side in ((along, 0 * along), (0 * along, along))]
    points = np.vstack([inside, *sides, np.stack([along, 1 - along], axis=1)])
    own = mesh.topology.index_map(2).size_local
    corners = mesh.geometry.x[corners_of(mesh)[:own], :2]
    shape = np.column_stack([1 - points.sum(axis=1), points])
    return np.asarray(np.einsum("pi,cid->cpd", shape, corners)).reshape(-1, 2)


def directions(angles: tuple[float, float]) -> NDArray[np.float64]:
    """Return unit vectors, shape (2, 2), at ``angles`` (rad) from the x axis, one a family."""
    return np.array([[cos(a), sin(a)] for a in angles])


def rectangle(
    comm: MPI.Comm, length: float, width: float, mesh_size: float, pattern: str
) -> tuple[Mesh, MeshTags, dict[str, int]]:
    """Return mesh, facet tags and tag numbers of a structured rectangle.

    Args:
        comm: Communicator.
        length: Extent in x, m.
        width: Extent in y, m.
        mesh_size: Largest side of the squares that are cut into triangles, m.
        pattern: ``crossed`` (four triangles a square) or ``right`` (two).
    """
    # The tolerance keeps 0.9 m / 30 mm at 30 squares in spite of round-off.
    counts = [max(1, ceil(side / mesh_size * (1 - 1e-9))) for side in (length, width)]
    mesh = create_rectangle(
        comm,
        [[0.0, 0.0], [length, width]],
        counts,
        ghost_mode=GhostMode.shared_facet,
        diagonal=PATTERNS[pattern],
    )
    return mesh, *name_facets(mesh, rectangle_outline(length, width))


def triangle_mesh(comm: MPI.Comm, build: Callable[[], tuple[Array, Triangles]]) -> Mesh:
    """Return the mesh of the vertices and cells that ``build`` makes on rank 0; collective."""
    none: tuple[Array, Triangles] = np.zeros((0, 2)), np.zeros((0, 3), dtype=np.int64)
    points, cells = from_root(comm, build, none)
    shape = ufl.Mesh(basix.ufl.element("Lagrange", "triangle", 1, shape=(2,)))
    return create_mesh(comm, cells=cells, x=points, e=shape, partitioner=cell_partitioner())


def name_facets(mesh: Mesh, outline: Outline) -> tuple[MeshTags, dict[str, int]]:
    """Return facet tags and tag numbers of the outline's edges."""
    names = dict.fromkeys(name for _, _, name in outline.segments() if name is not None)
    tags = {name: number for number, name in enumerate(names, start=1)}
    mesh.topology.create_connectivity(1, 2)
    facets = exterior_facet_indices(mesh.topology)
    middles = compute_midpoints(mesh, 1, facets)[:, :2]
    marks = np.zeros(len(facets), dtype=np.int32)
    for start, end, name in outline.segments():
        if name is not None:
            marks[_between(middles, start, end, SAME_PLACE * outline.extent)] = tags[name]
    named = marks > 0
    return meshtags(mesh, 1, facets[named], marks[named]), tags


def _between(places: Array, start: Array, end: Array, tolerance: float) -> NDArray[np.bool_]:
    length = float(np.linalg.norm(end - start))
    ahead, away = (end - start) / length, places - start
    position = away @ ahead
    aside = np.abs(away[:, 0] * ahead[1] - away[:, 1] * ahead[0])
    return np.asarray((aside < tolerance) & (position > 0) & (position < length))
