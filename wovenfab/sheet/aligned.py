"""Sheets whose mesh follows the fibres, with the lines across which placements may jump."""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt

import basix.ufl
import numpy as np
import ufl
from dolfinx.mesh import (
    Mesh,
    MeshTags,
    compute_midpoints,
    create_mesh,
    exterior_facet_indices,
    meshtags,
    refine,
)
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.compat import cell_partitioner
from wovenfab.parallel import from_root
from wovenfab.sheet.fibre_lines import special_lines
from wovenfab.sheet.fibre_mesh import fibre_mesh
from wovenfab.sheet.fibre_spacing import spaced
from wovenfab.sheet.outline import CORNER, Outline, changes
from wovenfab.sheet.sheet import Sheet

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
) -> Sheet:
    """Return a sheet with a mesh along its fibres; collective.

    Args:
        comm: Communicator of the mesh.
        outline: The shape of the sheet with its edges.
        fibres: Unit vectors along the fibres, shape (2, 2).
        holds: For each family, how edges hold it; special fibres start where that changes.
        mesh_size: Longest side of the cells, about, m.
        corner_size: The same at corners where the strain is singular, m; None for no
            refinement there.
        jumps: Whether placements may jump across special fibres.
    """
    lines = [special_lines(outline, fibres[a], holds[a]) for a in (0, 1)]

    def build() -> tuple[Array, NDArray[np.int64]]:
        offsets = spaced(outline, fibres, (lines[0].offsets, lines[1].offsets), mesh_size / sqrt(2))
        points, cells = fibre_mesh(outline, fibres, offsets)
        if corner_size is None:
            return points, cells
        return refined(points, cells, singular_points(outline, holds), mesh_size, corner_size)

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


def refined(
    points: Array, cells: NDArray[np.int64], near: Array, mesh_size: float, corner_size: float
) -> tuple[Array, NDArray[np.int64]]:
    """Return a mesh whose cells shrink towards some points, by halving again and again."""
    mesh = _mesh(MPI.COMM_SELF, points, cells)
    radius = mesh_size
    while radius > corner_size * (1 + 1e-9):
        corners = mesh.geometry.x[mesh.geometry.dofmap][:, :, None, :2]
        away = np.linalg.norm(corners - near, axis=-1).min(axis=(1, 2))
        mesh.topology.create_entities(1)
        mesh.topology.create_connectivity(1, 2)
        mesh.topology.create_connectivity(2, 1)
        sides = mesh.topology.connectivity(2, 1)
        marked = [sides.links(cell) for cell in np.flatnonzero(away < radius)]
        mesh = refine(mesh, np.unique(np.concatenate(marked)).astype(np.int32))[0]
        radius /= 2
    return mesh.geometry.x[:, :2].copy(), mesh.geometry.dofmap.astype(np.int64)


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
