"""Outlines of sheets that tests share, in m."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import exterior_facet_indices
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.model.assembly import compile_form
from wovenfab.sheet.aligned import Grading, aligned_sheet
from wovenfab.sheet.fibre_mesh import FibreLines, fibre_mesh, spaced, special_lines
from wovenfab.sheet.sheet import Outline, Ring, Sheet, directions, rectangle_outline

#: Of both families, degrees.
Angles = tuple[float, float]
#: Edges that are held.
HOLDS = {"left": "clamp", "right": "clamp"}
#: Of the rectangle 0.9 m long and 0.3 m wide: normal axis, place and length of each edge.
EDGES = {
    "left": (0, 0.0, 0.3),
    "right": (0, 0.9, 0.3),
    "bottom": (1, 0.0, 0.9),
    "top": (1, 0.3, 0.9),
}
LENGTHS = {name: length for name, (_, _, length) in EDGES.items()}


def with_hole(segments: int = 24) -> Outline:
    """Return a rectangle with a circular hole."""
    angles = np.linspace(0, -2 * np.pi, segments, endpoint=False)
    hole = np.array([0.4, 0.14]) + 0.05 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return Outline((*rectangle_outline(0.9, 0.3).rings, Ring(hole, (None,) * segments)))


def tee() -> Outline:
    """Return a T with two re-entrant corners at (0.6, 0.3) and (0.3, 0.3)."""
    x = [0, 0.9, 0.9, 0.6, 0.6, 0.3, 0.3, 0]
    y = [0, 0, 0.3, 0.3, 0.5, 0.5, 0.3, 0.3]
    names = (None, "right", None, None, None, None, None, "left")
    return Outline((Ring(np.stack([x, y], axis=1), names),))


SHAPES = {
    "rectangle": rectangle_outline(0.9, 0.3),
    "sides that do not fit": rectangle_outline(0.87, 0.31),
    "hole": with_hole(),
    "re-entrant corners": tee(),
}


def fibres_at(angles: Angles) -> NDArray[np.float64]:
    """Return the unit vectors along fibres at angles (degrees)."""
    first, second = np.radians(angles)
    return directions((float(first), float(second)))


def aligned(
    outline: Outline,
    angles: Angles,
    mesh_size: float,
    comm: MPI.Comm = MPI.COMM_SELF,
    **options: Grading | bool | None,
) -> Sheet:
    """Return a sheet with a mesh along its fibres."""
    return aligned_sheet(comm, outline, fibres_at(angles), (HOLDS, HOLDS), mesh_size, **options)


def lines_and_mesh(
    outline: Outline, fibres: NDArray[np.float64], mesh_size: float
) -> tuple[tuple[FibreLines, FibreLines], tuple[NDArray, NDArray], tuple[NDArray, NDArray]]:
    """Return special lines, positions of all lines, and points and cells of the mesh."""
    lines = special_lines(outline, fibres[0], HOLDS), special_lines(outline, fibres[1], HOLDS)
    offsets = spaced(outline, fibres, (lines[0].offsets, lines[1].offsets), mesh_size)
    return lines, offsets, fibre_mesh(outline, fibres, offsets)


def edge_lengths(on: Sheet) -> dict[str, float]:
    """Return the length of each named edge (m)."""
    lengths = {}
    for edge, tag in on.edges.items():
        ds = ufl.ds(domain=on.mesh, subdomain_data=on.facets, subdomain_id=tag, degree=0)
        lengths[edge] = fem.assemble_scalar(compile_form(fem.Constant(on.mesh, 1.0) * ds))
    return lengths


def assert_edges(on: Sheet, lengths: dict[str, float], error: float = 1e-12) -> None:
    """Assert that the named edges have their lengths and each facet of the boundary is in one."""
    assert edge_lengths(on) == pytest.approx(lengths, rel=error)
    on.mesh.topology.create_connectivity(1, 2)
    boundary = exterior_facet_indices(on.mesh.topology)
    assert np.array_equal(np.sort(on.facets.indices), np.sort(boundary))
