"""The sheet: a triangle mesh with named edges and two reference fibre directions."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import cos, sin

import numpy as np
from dolfinx.mesh import Mesh, MeshTags
from numpy.typing import NDArray


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
        found: NDArray[np.int32] = self.facets.find(self.edges[name])
        return found


def directions(angles: tuple[float, float]) -> NDArray[np.float64]:
    """Return unit vectors, shape (2, 2), at ``angles`` (rad) from the x axis."""
    return np.array([[cos(a), sin(a)] for a in angles])
