"""Whether the penalty holds the bending energy together."""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.model.model import Model


def proven_penalty(model: Model) -> float:
    """Return the smallest ``discretisation.penalty`` proven stable on a mesh; collective.

    A user's sigma/h has the mean of |T|/|F| for h; on every facet it must reach the
    value 3 p(p-1)/8 h_F (1/|T+| + 1/|T-|), and 3 p(p-1)/2 h_F/|T| on an edge that holds
    yarn directions, of the trace inequality (Bringmann, Carstensen, Streitberger 2023).
    """
    mesh, degree = model.sheet.mesh, model.balance.degree
    mesh.topology.create_connectivity(1, 2)
    cells_of = mesh.topology.connectivity(1, 2)
    areas = _areas(mesh)
    factor = 3 * degree * (degree - 1) / 8
    edges = factor * 4 if any(model.balance.held_edges) else 0.0
    ratios = [
        (areas[a] + areas[b]) ** 2 / (2 * areas[a] * areas[b])
        for a, b in (
            cells_of.links(f)
            for f in range(mesh.topology.index_map(1).size_local)
            if len(cells_of.links(f)) == 2
        )
    ]
    mine = max(factor * max(ratios, default=0.0), edges)
    return float(mesh.comm.allreduce(mine, op=MPI.MAX))


def _areas(mesh: Any) -> NDArray[np.float64]:
    """Return the areas (m^2) of this rank's cells, ghosts included."""
    a, b, c = (mesh.geometry.x[mesh.geometry.dofmap[:, i], :2] for i in range(3))
    (x, y), (u, v) = (b - a).T, (c - a).T
    return np.asarray(np.abs(x * v - y * u) / 2)
