"""Quantities that are sums of forms over the same unknowns.

What stands on facets concerns one family. Its forms live on the space of that placement
alone, whose unknowns bear the same numbers, so that their small matrices go straight into
the large one and do not couple what the physics does not.

Interior facets that fibres cross; only there can a yarn's direction jump.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx.mesh import Mesh, entities_to_geometry, meshtags
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse

from wovenfab.compat import column_map

#: A sum of compiled forms; the first one lives on the space of all placements.
Sum = tuple[fem.Form, ...]


def assemble_scalar(forms: Sum, comm: MPI.Comm) -> float:
    """Return the value of a sum of scalar forms over all ranks; collective."""
    mine = sum(fem.assemble_scalar(form) for form in forms)
    return float(comm.allreduce(mine, op=MPI.SUM))


def assemble_vector(vector: Any, forms: Sum) -> None:
    """Overwrite a ghosted vector with a sum of linear forms; ghosts are not yet added."""
    with vector.localForm() as local:
        local.set(0.0)
    for form in forms:
        fem_petsc.assemble_vector(vector, form)


def assemble_matrix(matrix: Any, forms: Sum, bcs: Sequence[fem.DirichletBC] = ()) -> None:
    """Overwrite a matrix with a sum of bilinear forms; identity where prescribed; collective."""
    matrix.zeroEntries()
    for form in forms:
        fem_petsc.assemble_matrix(matrix, form, list(bcs))
        # Rows of the identity are set; PETSc must flush before more values are added.
        matrix.assemble(PETSc.Mat.AssemblyType.FLUSH)
    matrix.assemble()


def create_matrix(forms: Sum, upper: bool = False) -> Any:
    """Return a matrix that has just the entries of a sum of bilinear forms; collective.

    Args:
        forms: The forms, which are symmetric.
        upper: Store the upper half in blocks of x and y, as a Cholesky factorisation takes
            it; putting entries in costs half as much. Otherwise any solver takes it.
    """
    unknowns = forms[0].function_spaces[0].dofmap
    entries = _entries(forms[0])
    for form in forms[1:]:
        entries = entries + _entries(form)
    block, first = unknowns.index_map_bs, unknowns.index_map.local_range[0]
    if upper:
        entries = sparse.csr_array(sparse.triu(entries, first))
    else:
        entries = sparse.csr_array(sparse.kron(entries, np.ones((block, block), dtype=np.int8)))
    entries.sort_indices()
    usual = fem_petsc.create_matrix(forms[0])
    matrix = PETSc.Mat().create(usual.comm)
    matrix.setSizes(usual.getSizes(), bsize=block)
    matrix.setType("sbaij" if upper else "aij")
    csr = [part.astype(PETSc.IntType) for part in (entries.indptr, entries.indices)]
    matrix.setPreallocationCSR(csr)
    matrix.setLGMap(*usual.getLGMap())
    if upper:
        matrix.setOption(PETSc.Mat.Option.IGNORE_LOWER_TRIANGULAR, True)
    matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_LOCATION_ERR, True)
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    usual.destroy()
    return matrix


def _entries(form: fem.Form) -> Any:
    """Return the blocks that a bilinear form couples: own rows, columns of all ranks."""
    pattern = fem.create_sparsity_pattern(form)
    pattern.finalize()
    edges, offsets = pattern.graph
    rows, columns = pattern.index_map(0), column_map(pattern)
    offsets = offsets[: rows.size_local + 1]
    numbers = columns.local_to_global(np.asarray(edges[: offsets[-1]]))
    shape = (rows.size_local, columns.size_global)
    return sparse.csr_array((np.ones(len(numbers), dtype=np.int8), numbers, offsets), shape=shape)


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
