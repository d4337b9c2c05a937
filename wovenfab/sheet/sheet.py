"""The sheet: a triangle mesh with named edges and two fibre directions; structured rectangles."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import ceil, cos, sin

import numpy as np
from dolfinx.mesh import (
    DiagonalType,
    GhostMode,
    Mesh,
    MeshTags,
    create_rectangle,
    locate_entities_boundary,
    meshtags,
)
from mpi4py import MPI
from numpy.typing import NDArray

PATTERNS = {"crossed": DiagonalType.crossed, "right": DiagonalType.right}


class GeometryError(Exception):
    """A geometry that cannot be meshed; the text says why and what to do."""


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

    @property
    def original_cells(self) -> NDArray[np.int64]:
        """Return the number of each local cell that does not depend on the ranks."""
        numbers: NDArray[np.int64] = self.mesh.topology.original_cell_index
        return numbers

    def edge_facets(self, name: str) -> NDArray[np.int32]:
        """Return the local facets on the named edge."""
        facets: NDArray[np.int32] = self.facets.find(self.edges[name])
        return facets


def directions(angles: tuple[float, float]) -> NDArray[np.float64]:
    """Return unit vectors, shape (2, 2), at ``angles`` (rad) from the x axis."""
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
    return mesh, *name_edges(mesh, length, width)


def name_edges(mesh: Mesh, length: float, width: float) -> tuple[MeshTags, dict[str, int]]:
    """Return facet tags and tag numbers of the four edges of a rectangle at the origin."""
    slack = 1e-9 * max(length, width)
    on_edge = {
        "left": lambda x: x[0] < slack,
        "right": lambda x: x[0] > length - slack,
        "bottom": lambda x: x[1] < slack,
        "top": lambda x: x[1] > width - slack,
    }
    tags = {name: number for number, name in enumerate(on_edge, start=1)}
    facets = [locate_entities_boundary(mesh, 1, marker) for marker in on_edge.values()]
    values = [np.full_like(f, tag) for f, tag in zip(facets, tags.values(), strict=True)]
    together, marks = np.concatenate(facets), np.concatenate(values)
    order = np.argsort(together, kind="stable")
    return meshtags(mesh, 1, together[order], marks[order]), tags
