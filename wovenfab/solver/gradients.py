"""Conjugate gradients that do not pay for knowing how wrong they are.

Their error in the norm of energy is that of the rest r = b - A x: sqrt(r P r), with P near the
inverse of A. Where P is the large factor of an earlier tangent, to apply it takes most of the
time, and the last application would serve for nothing but that number. Norms of the rest are
cheap; one is turned into the other by their ratio at the step before (of the solution before,
where there was no step yet). What is solved too roughly costs Newton's method an iteration.
"""

from __future__ import annotations

from math import inf
from typing import Any


class Gradients:
    """Solves with a symmetric matrix by a preconditioner near its inverse; collective."""

    def __init__(self, matrix: Any, preconditioner: Any) -> None:
        """Make the vectors.

        Args:
            matrix: PETSc's; its values may change from one solution to the next.
            preconditioner: PETSc's; to apply it is all that is done with it.
        """
        self._matrix, self._preconditioner = matrix, preconditioner
        rest = matrix.createVecLeft()
        self._vectors = rest, *(rest.duplicate() for _ in range(3))
        self._ratio = inf  # of r P r and r r

    def solve(self, b: Any, x: Any, accuracy: float, most: int) -> tuple[bool, int]:
        """Solve A x = b.

        They begin with the preconditioner's answer, which is exact where placements are
        prescribed: those rows are the identity's in each tangent.

        Args:
            b: Right-hand side.
            x: The solution; overwritten.
            accuracy: Error in the norm of energy, relative.
            most: Number of steps.

        Returns:
            Whether it is solved, and how often the preconditioner was applied.
        """
        rest, image, way, push = self._vectors
        self._preconditioner.apply(b, x)
        allowed = accuracy**2 * b.dot(x)
        self._matrix.mult(x, rest)
        rest.aypx(-1.0, b)
        size, last = rest.dot(rest), inf
        for applied in range(1, most + 1):
            if self._ratio * size <= allowed or not size:
                return True, applied
            self._preconditioner.apply(rest, image)
            error = rest.dot(image)
            way.aypx(error / last, image) if applied > 1 else image.copy(way)
            self._matrix.mult(way, push)
            bent = way.dot(push)
            if not (error > 0 and bent > 0):  # one of the two is not definite, or not finite
                return False, applied + 1
            x.axpy(error / bent, way)
            rest.axpy(-error / bent, push)
            self._ratio, last = error / size, error
            size = rest.dot(rest)
        return self._ratio * size <= allowed, most + 1

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for item in self._vectors:
            item.destroy()
