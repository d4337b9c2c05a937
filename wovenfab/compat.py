"""What differs between dolfinx 0.9 and 0.11; tests run with both, not with 0.10."""

from __future__ import annotations

from typing import Any

import dolfinx
import ffcx
import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

#: Versions of FFCx whose kernels were compared with those of model/kernels.py
#: (tests/solver/test_compilation.py); any other writes all kernels itself.
COMPARED = ("0.9", "0.11")
_REASONS = PETSc.SNES.ConvergedReason
#: PETSc's name of the reason that a residual is no number; another one since its 3.24.
NOT_FINITE = (
    "DIVERGED_FNORM_NAN"
    if hasattr(_REASONS, "DIVERGED_FNORM_NAN")
    else "DIVERGED_FUNCTION_NANORINF"
)


def is_compared() -> bool:
    """Return whether this version of FFCx is one whose kernels were compared."""
    return ".".join(ffcx.__version__.split(".")[:2]) in COMPARED


def rule_of(key: Any) -> Any:
    """Return the quadrature rule by which FFCx finds an integrand; 0.11 names the cell, too."""
    return key[-1] if isinstance(key, tuple) else key


def cell_partitioner() -> Any:
    """Return a partitioner that shares cells across facets, as facet integrals need."""
    mode = dolfinx.mesh.GhostMode.shared_facet
    try:
        return dolfinx.mesh.create_cell_partitioner(mode)
    except TypeError:  # 0.11 wants the number of cells that meet at a facet
        return dolfinx.mesh.create_cell_partitioner(mode, 2)


def corners_of(mesh: Any) -> NDArray[np.int32]:
    """Return the numbers of each local cell's corners in the geometry, shape (cells, 3)."""
    geometry = mesh.geometry
    corners: NDArray[np.int32] = (
        geometry.dofmaps[0] if hasattr(geometry, "dofmaps") else geometry.dofmap
    )
    return corners


def index_map_of(
    comm: MPI.Comm, size: int, ghosts: NDArray[np.int64], owners: NDArray[np.int32]
) -> Any:
    """Return the distribution of numbers over the ranks; collective.

    Args:
        comm: The ranks.
        size: How many numbers this rank owns.
        ghosts: Numbers of other ranks that it uses.
        owners: Their ranks.
    """
    try:
        return dolfinx.common.IndexMap(comm, size, ghosts, owners)
    except TypeError:  # 0.11 wants a tag for its messages
        return dolfinx.common.IndexMap(comm, size, ghosts, owners, 0)


def column_map(pattern: Any) -> Any:
    """Return the distribution of a finalized sparsity pattern's columns, ghosts included."""
    if hasattr(pattern, "column_index_map"):
        return pattern.column_index_map()
    return pattern.index_map(1)  # 0.11


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
