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
        model.mesh.renumberNodes()  # dolfinx takes for granted that they have no gaps
        names = {model.getPhysicalName(1, tag): tag for _, tag in model.getPhysicalGroups(1)}
    names = comm.bcast(names, root=rank)
    if hasattr(dolfinx.io, "gmshio"):
        mesh, _, facets = dolfinx.io.gmshio.model_to_mesh(
            model, comm, rank, gdim=2, partitioner=partitioner
        )
        return mesh, facets, names
    data = dolfinx.io.gmsh.model_to_mesh(model, comm, rank, gdim=2, partitioner=partitioner)
    return data.mesh, data.facet_tags, names


def space_with(mesh: Any, element: Any, index_map: Any, cells: Any, block: int = 2) -> Any:
    """Return the space of an element with a dof map of one's own.

    Args:
        mesh: The mesh.
        element: Element of basix.ufl.
        index_map: Distribution of the blocks over the ranks.
        cells: Blocks of each local cell, shape (cells, n), int32.
        block: Unknowns in a block.
    """
    usual = dolfinx.fem.functionspace(mesh, element)
    layout, kind = usual.dofmap.dof_layout, type(usual._cpp_object)
    blocks = dolfinx.cpp.graph.AdjacencyList_int32(cells)
    dofmap = dolfinx.cpp.fem.DofMap(layout, index_map, block, blocks, block)
    parts = (mesh._cpp_object, usual._cpp_object.element, dofmap)
    try:
        space = kind(*parts, usual.value_shape)
    except TypeError:  # 0.10 takes the shape from the element
        space = kind(*parts)
    return dolfinx.fem.FunctionSpace(mesh, element, space)
