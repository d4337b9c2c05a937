"""What differs between dolfinx 0.9, 0.10 and 0.11; the only place that knows."""

from __future__ import annotations

from typing import Any

import dolfinx
from mpi4py import MPI


def cell_partitioner() -> Any:
    """Return a partitioner that shares cells across facets, as facet integrals need."""
    mode = dolfinx.mesh.GhostMode.shared_facet
    try:
        return dolfinx.mesh.create_cell_partitioner(mode)
    except TypeError:  # 0.11 wants the number of cells that meet at a facet
        return dolfinx.mesh.create_cell_partitioner(mode, 2)


def mesh_from_gmsh(model: Any, comm: MPI.Comm, rank: int = 0) -> tuple[Any, Any, dict[str, int]]:
    """Return mesh, facet tags and tag numbers by physical name from a gmsh model.

    Args:
        model: The gmsh model, on ``rank`` only.
        comm: Communicator of the mesh.
        rank: The rank that holds the model.
    """
    partitioner = cell_partitioner()
    names: dict[str, int] = {}
    if comm.rank == rank:
        names = {model.getPhysicalName(1, tag): tag for _, tag in model.getPhysicalGroups(1)}
    names = comm.bcast(names, root=rank)
    if hasattr(dolfinx.io, "gmshio"):
        mesh, _, facets = dolfinx.io.gmshio.model_to_mesh(
            model, comm, rank, gdim=2, partitioner=partitioner
        )
        return mesh, facets, names
    data = dolfinx.io.gmsh.model_to_mesh(model, comm, rank, gdim=2, partitioner=partitioner)
    return data.mesh, data.facet_tags, names
