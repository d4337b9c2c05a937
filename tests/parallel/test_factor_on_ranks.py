"""Factors have on several ranks the inertia that they have on one."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from wovenfab.solver.linear import LinearSolver, create_direct

pytestmark = [pytest.mark.mpi, pytest.mark.mpi4]

#: So large that MUMPS shares the last block, which is all of a full matrix, among the ranks.
SIZE = 1200


@pytest.mark.parametrize("coupling", [0.5, 2.0])
def test_a_negative_eigenvalue_in_the_last_block_is_counted(coupling: float) -> None:
    """A full matrix, I - c/n on all ones, has the eigenvalue 1 - c, else ones."""
    matrix = PETSc.Mat().createSBAIJ((SIZE, SIZE), 1, nnz=(SIZE, SIZE), comm=MPI.COMM_WORLD)
    for row in range(*matrix.getOwnershipRange()):
        columns = np.arange(row, SIZE, dtype=np.int32)
        values = np.full(len(columns), -coupling / SIZE)
        values[0] += 1.0
        matrix.setValues([row], columns, values)
    matrix.assemble()
    factor = LinearSolver(create_direct(matrix.comm), matrix)
    b, x = matrix.createVecs()
    b.set(1.0)
    assert factor.solve(b, x) > 0
    assert x.array_r == pytest.approx(1.0 / (1.0 - coupling), rel=1e-9)
    assert factor.status == 0
    assert factor.negatives == (coupling > 1)
    factor.destroy()
    for item in (matrix, b, x):
        item.destroy()
