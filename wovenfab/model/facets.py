"""Interior facets that fibres cross; only there can a yarn's direction jump."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx.mesh import Mesh, entities_to_geometry, meshtags
from numpy.typing import NDArray

#: Largest |sin| of the angle between a facet and a fibre that runs along it.
PARALLEL = 1e-9
CROSSED = 1


def crossed_facets(mesh: Mesh, fibre: NDArray[np.float64]) -> Any:
    """Return the measure of the interior facets that are not parallel to a fibre.

    On a mesh along the fibres this leaves out about a third of the facets.

    Args:
        mesh: Triangles.
        fibre: Unit vector, shape (2,).
    """
    mesh.topology.create_connectivity(1, 2)
    mesh.topology.create_connectivity(2, 1)
    facets = np.arange(_count(mesh, 1), dtype=np.int32)
    ends = mesh.geometry.x[entities_to_geometry(mesh, 1, facets)][:, :, :2]
    way = ends[:, 1] - ends[:, 0]
    across = np.abs(way[:, 0] * fibre[1] - way[:, 1] * fibre[0])
    crossed = facets[across > PARALLEL * np.linalg.norm(way, axis=1)]
    tags = meshtags(mesh, 1, crossed, np.full(len(crossed), CROSSED, dtype=np.int32))
    return ufl.Measure("dS", domain=mesh, subdomain_data=tags, subdomain_id=CROSSED)


def _count(mesh: Mesh, dimension: int) -> int:
    entities = mesh.topology.index_map(dimension)
    return int(entities.size_local + entities.num_ghosts)
