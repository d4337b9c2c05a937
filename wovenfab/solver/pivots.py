"""What a factorisation tells of a tangent: its negative and its null pivots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from wovenfab.solver.factor import COUNT_NULL, NEGATIVE, STATUS

#: Of MUMPS: number of null pivots, over all ranks.
NULL = 28
#: Shift over the largest diagonal entry, and sweeps, that bring out a null vector.
SHIFT, SWEEPS = 1e-12, 3


@dataclass(frozen=True)
class Pivots:
    """Pivots of a symmetric matrix A = L D L'.

    Attributes:
        negative: Number of negative ones: A has as many negative eigenvalues.
        null: Number of vanishing ones.
        status: MUMPS's status, negative where it failed.
    """

    negative: int
    null: int
    status: int


def pivots_of(matrix: Any) -> Pivots:
    """Factorise a symmetric matrix and return its pivots; collective."""
    ksp = _direct(matrix)
    ksp.setUp()
    factor = ksp.getPC().getFactorMatrix()
    found = Pivots(*(int(factor.getMumpsInfog(i)) for i in (NEGATIVE, NULL, STATUS)))
    ksp.destroy()
    return found


def softest(matrix: Any, start: Any) -> NDArray[np.float64]:
    """Return the direction that a (nearly) singular matrix resists least; collective.

    Args:
        matrix: Symmetric; it is left with a tiny shift.
        start: Vector to begin with; it is overwritten.

    Returns:
        At this rank's own unknowns, of length one over all.
    """
    diagonal = matrix.getDiagonal()
    matrix.shift(SHIFT * (diagonal.norm(PETSc.NormType.INFINITY) or 1.0))
    ksp, image = _direct(matrix), start.duplicate()
    for _ in range(SWEEPS):
        ksp.solve(start, image)
        image.scale(1 / (image.norm() or 1.0))
        image.copy(start)
    found = np.array(start.array_r)
    for item in (ksp, image, diagonal):
        item.destroy()
    return found


def _direct(matrix: Any) -> Any:
    ksp = PETSc.KSP().create(matrix.comm)
    ksp.setOptionsPrefix("pivots_")  # a user's options are for Newton's solver
    ksp.setOperators(matrix)
    ksp.setType("preonly")
    pc = ksp.getPC()
    pc.setType("cholesky")
    pc.setFactorSolverType("mumps")
    pc.setFactorSetUpSolverType()
    pc.getFactorMatrix().setMumpsIcntl(COUNT_NULL, 1)
    return ksp
