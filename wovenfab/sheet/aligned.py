"""Sheets whose mesh follows the fibres, with the lines across which placements may jump."""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from typing import TYPE_CHECKING

import basix.ufl
import numpy as np
import shapely
import ufl
from dolfinx.mesh import (
    Mesh,
    MeshTags,
    compute_midpoints,
    create_mesh,
    exterior_facet_indices,
    meshtags,
)
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.compat import cell_partitioner
from wovenfab.parallel import from_root
from wovenfab.sheet.fibre_mesh import FibreLines, fibre_mesh, spaced, special_lines
from wovenfab.sheet.sheet import CORNER, Outline, Sheet, changes

if TYPE_CHECKING:
    from wovenfab.sheet.grading import Grading

Array = NDArray[np.float64]
#: How each edge holds a family; edges that are missing leave it free.
Holds = Mapping[str, object]
#: A facet lies on an edge that its middle is this close to, as a share of the extent.
ON_EDGE = 1e-8
#: Points and cells of a mesh on the ranks that get theirs from another.
NOTHING: tuple[Array, NDArray[np.int64]] = np.zeros((0, 2)), np.zeros((0, 3), dtype=np.int64)


def aligned_sheet(
    comm: MPI.Comm,
    outline: Outline,
    fibres: Array,
    holds: tuple[Holds, Holds],
    mesh_size: float,
    corner_size: float | None = None,
    jumps: bool = True,
    steep: bool = False,
) -> Sheet:
    """Return a sheet with a mesh along its fibres; collective.

    Args:
        comm: Communicator of the mesh.
        outline: The shape of the sheet with its edges.
        fibres: Unit vectors along the fibres, shape (2, 2).
        holds: For each family, how edges hold it; special fibres start where that changes.
        mesh_size: Longest side of the cells, about, m.
        corner_size: The same at corners where the strain is singular, m; the mesh size for
            no refinement.
        jumps: Whether placements may jump across special fibres.
        steep: Whether the mesh is graded where no ``corner_size`` is given: one placement
            is steep at corners and free edges, two slide there instead.
    """
    lines = (
        special_lines(outline, fibres[0], holds[0]),
        special_lines(outline, fibres[1], holds[1]),
    )

    def build() -> tuple[Array, NDArray[np.int64]]:
        offsets = spaced(outline, fibres, (lines[0].offsets, lines[1].offsets), mesh_size / sqrt(2))
        points, cells = fibre_mesh(outline, fibres, offsets)
        if corner_size is None and not steep:
            return points, cells
        from wovenfab.sheet.grading import grading_of

        how = grading_of(mesh_size, corner_size)
        return graded(points, cells, outline, holds, lines, how)

    points, cells = from_root(comm, build, NOTHING)
    mesh = _mesh(comm, points, cells)
    facets, tags = name_facets(mesh, outline)
    none = np.zeros((0, 2, 2))
    across = (lines[0].jumps, lines[1].jumps) if jumps else (none, none)
    return Sheet(mesh, facets, tags, fibres, across)


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
    cells: NDArray[np.int64],
    outline: Outline,
    holds: tuple[Holds, Holds],
    lines: tuple[FibreLines, FibreLines],
    how: Grading,
) -> tuple[Array, NDArray[np.int64]]:
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
    from wovenfab.sheet.grading import towards

    points, cells = towards(points, cells, near, how.points, size)
    for fibre in fibres:
        points, cells = towards(points, cells, fibre, how.lines, size)
    return towards(points, cells, free, how.edges, size)


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
            marks[_between(middles, start, end, ON_EDGE * outline.extent)] = tags[name]
    named = marks > 0
    return meshtags(mesh, 1, facets[named], marks[named]), tags


def _between(places: Array, start: Array, end: Array, tolerance: float) -> NDArray[np.bool_]:
    length = float(np.linalg.norm(end - start))
    ahead, away = (end - start) / length, places - start
    position = away @ ahead
    aside = np.abs(away[:, 0] * ahead[1] - away[:, 1] * ahead[0])
    return np.asarray((aside < tolerance) & (position > 0) & (position < length))


def _mesh(comm: MPI.Comm, points: Array, cells: NDArray[np.int64]) -> Mesh:
    shape = ufl.Mesh(basix.ufl.element("Lagrange", "triangle", 1, shape=(2,)))
    return create_mesh(comm, cells=cells, x=points, e=shape, partitioner=cell_partitioner())
