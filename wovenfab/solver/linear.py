"""Linear systems with tangents: one factorisation, kept as long as that pays.

A factorisation costs as much as tens of solutions with its factor. Tangents change little
from one Newton step to the next, so that an older factor is a good preconditioner of conjugate
gradients (CG). CG needs more iterations the older the factor is. The tangent is factorised
again when the next system would cost more than the average since the last factorisation, that
one included: there the average is least. A run that goes on from a checkpoint begins with a
factorisation.

Tangents of minima are positive definite, and their factorisation needs no search for pivots.
The first tangent with a negative pivot is factorised again with a search, and so are all later
ones: only then is their number reliable.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from math import inf
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from wovenfab.model.memory import attributes, take_attributes
from wovenfab.solver.back_off import BackOff

logger = logging.getLogger(__name__)
Array = NDArray[np.float64]
Reason = PETSc.KSP.ConvergedReason
#: Of MUMPS: status, number of negative and of null pivots, entries of the factor, operations.
STATUS, NEGATIVE, NULL, ENTRIES, OPERATIONS = 1, 12, 28, 29, 3
#: Of MUMPS: null pivots are counted apart instead of ending the factorisation.
COUNT_NULL = 24
#: Of MUMPS: how much larger its workspace is than it has estimated, in per cent.
SPACE = 14
#: Status of MUMPS where a pivot is null.
SINGULAR = -10
#: Status of MUMPS where its workspace was too small, of integers and of numbers: on several ranks
#: its estimate may fail, for these share their work as it comes.
TOO_SMALL = -8, -9
#: SPACE is doubled from the first until it is enough, or above the second.
LEAST_SPACE, MOST_SPACE = 50, 1000
#: Operations for an entry of the factor that take as long as to use the entry in an iteration.
OPERATIONS_PER_USE = 40.0
#: Error of a solution in the energy norm, relative: no Newton step needs less.
ACCURACY = 1e-8


class ConjugateGradients:
    """CG that estimates its error without an extra solve; collective.

    The error in the energy norm is sqrt(r P r) with the residual r and a preconditioner P near
    the inverse. To apply P takes most of the time, so that r P r is estimated from r r by their
    ratio at the iteration before (of the solution before, at the first iteration).

    Attributes:
        ratio: Of r P r and r r at the last iteration.
    """

    def __init__(self, matrix: Any, preconditioner: Any) -> None:
        """Create the vectors.

        Args:
            matrix: PETSc's, symmetric; its values may change between solutions.
            preconditioner: PETSc's; it is only applied.
        """
        self._matrix, self._preconditioner = matrix, preconditioner
        residual = matrix.createVecLeft()
        self._vectors = residual, *(residual.duplicate() for _ in range(3))
        self.ratio = inf

    def solve(self, b: Any, x: Any, accuracy: float, most: int) -> tuple[bool, int]:
        """Solve A x = b.

        The initial guess is P b, which is exact where placements are prescribed: those rows are
        the identity's in each tangent.

        Args:
            b: Right-hand side.
            x: The solution; overwritten.
            accuracy: Error in the energy norm, relative.
            most: Number of iterations.

        Returns:
            Whether it is solved, and how often the preconditioner was applied.
        """
        residual, preconditioned, direction, image = self._vectors
        self._preconditioner.apply(b, x)
        allowed = accuracy**2 * b.dot(x)
        self._matrix.mult(x, residual)
        residual.aypx(-1.0, b)
        square, last = residual.dot(residual), inf
        for applied in range(1, most + 1):
            if self.ratio * square <= allowed or not square:
                return True, applied
            self._preconditioner.apply(residual, preconditioned)
            error = residual.dot(preconditioned)
            if applied > 1:
                direction.aypx(error / last, preconditioned)
            else:
                preconditioned.copy(direction)
            self._matrix.mult(direction, image)
            curvature = direction.dot(image)
            if not (error > 0 and curvature > 0):  # one of the two is indefinite, or not finite
                return False, applied + 1
            x.axpy(error / curvature, direction)
            residual.axpy(-error / curvature, image)
            self.ratio, last = error / square, error
            square = residual.dot(residual)
        return self.ratio * square <= allowed, most + 1

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for vector in self._vectors:
            vector.destroy()


def create_direct(comm: MPI.Comm, prefix: str = "", options: bool = True) -> Any:
    """Return a linear solver: a Cholesky factorisation by MUMPS; collective.

    Args:
        comm: Its ranks.
        prefix: Beginning of the names of its PETSc options.
        options: Whether they may choose another solver; MUMPS reads its own in any case.
    """
    direct = PETSc.KSP().create(comm)
    direct.setOptionsPrefix(prefix)
    direct.setType("preonly")
    direct.getPC().setType("cholesky")
    direct.getPC().setFactorSolverType("mumps")
    if options:
        direct.setFromOptions()
    return direct


class LinearSolver:
    """Solves with the matrix of the present tangent; collective.

    Attributes:
        definite: Whether matrices are expected to be definite and near to the last one, as
            an older factor needs.
        method: PETSc's names of solver, preconditioner and package.
        counts: Whether the factor counts the negative eigenvalues.
        prefix: Beginning of the names of its PETSc options.
        iterations: Of CG with an older factor for the last system; 0 with a factor of its own.
        workspace_percent: By how much MUMPS's workspace exceeds its estimate (per cent); 0 for
            its default.
    """

    def __init__(
        self, direct: Any, matrix: Any, keep: bool = False, accuracy: float = ACCURACY
    ) -> None:
        """Prepare to factorise.

        Args:
            direct: The linear solver, of ``create_direct``; destroyed with this object.
            matrix: Symmetric; its values may change from one solution to the next.
            keep: Whether an older factor is used where that pays.
            accuracy: Error of a solution in the energy norm, relative, where an older factor
                is used.
        """
        self._matrix, self._keep, self._accuracy = matrix, keep, accuracy
        self.definite, self.iterations = True, 0
        self._direct, self._pc = direct, direct.getPC()
        self._direct.setOperators(matrix)
        self.method = direct.getType(), self._pc.getType(), self._pc.getFactorSolverType()
        self.counts = self.method == ("preonly", "cholesky", "mumps")
        self.prefix = direct.getOptionsPrefix() or ""
        self._positive = self.counts  # whether all were so far
        self._gradients: ConjugateGradients | None = None
        self.workspace_percent = 0
        self._begun = False  # PETSc's factor must not be asked for before: that creates one
        self._made = -1  # state of the matrix when it was factorised
        self._cost = 0.0  # of a factorisation, in iterations
        self._spent, self._solved, self._last = 0.0, 0, 0  # since then
        self._back_off = BackOff("an older factor does not precondition well enough")

    @property
    def is_present(self) -> bool:
        """Whether the factor is of the matrix as it is now."""
        return bool(self._made == self._matrix.stateGet())

    @property
    def factor(self) -> Any:
        """PETSc's factor, which exists after the first solution."""
        return self._pc.getFactorMatrix()

    @property
    def negatives(self) -> int:
        """Number of negative pivots of the factor, over all ranks; 0 before there is one."""
        return self._count_of(NEGATIVE) if self._begun else 0

    @property
    def status(self) -> int:
        """MUMPS's status of the last factorisation, negative where it failed; 0 without MUMPS."""
        known = self._begun and self._pc.getFactorSolverType() == "mumps"
        return self._count_of(STATUS) if known else 0

    def solve(self, b: Any, x: Any, accuracy: float | None = None) -> int:
        """Solve A x = b.

        Args:
            b: Right-hand side.
            x: The solution; overwritten.
            accuracy: Error of this solution, if not the usual one.

        Returns:
            PETSc's reason, negative where it failed.
        """
        if not self.is_present:
            accuracy = self._accuracy if accuracy is None else accuracy
            if self._pays() and self._refine(b, x, accuracy):
                return int(Reason.CONVERGED_RTOL)
            self._renew()
        self.iterations = 0
        if not self._solved:
            self._count(1)
        self._direct.solve(b, x)
        return int(self._direct.getConvergedReason())

    def renew(self) -> None:
        """Factorise the matrix as it is; null pivots, as of free motion, are not negative."""
        self._renew()
        if self.status < 0:
            self.factor.setMumpsIcntl(COUNT_NULL, 1)
            self._matrix.stateIncrease()  # so that it is factorised again
            self._renew()
            self.factor.setMumpsIcntl(COUNT_NULL, 0)

    def forget(self) -> None:
        """Let the next matrix be factorised."""
        if self._made >= 0 and self.status < 0:  # PETSc's MUMPS takes no other after a failure
            self._pc.reset()
            self._begun = False
        self._made, self._solved = -1, 0

    def snapshot(self) -> dict[str, Any]:
        """Return what decides how the next matrix is factorised."""
        return attributes(self, "_positive")

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on with that of a snapshot."""
        take_attributes(self, snapshot, "_positive")
        self.forget()

    def view(self, viewer: Any) -> None:
        """Describe the solver to a PETSc viewer; collective."""
        self._direct.view(viewer)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        if self._gradients:
            self._gradients.destroy()
        self._pc.destroy()  # a reference of its own, which would keep matrix and factor
        self._direct.destroy()

    def _count_of(self, number: int) -> int:
        return int(self.factor.getMumpsInfog(number))

    def _pays(self) -> bool:
        """Return whether to try the factor there is."""
        usable = self._keep and self.counts and self.definite and self._solved
        if not usable or self.negatives:
            return False
        if self._back_off.waits:
            self._back_off.skip()
            return False
        return self._last * self._solved <= self._spent

    def _renew(self) -> None:
        self._pc.setReusePreconditioner(False)
        self._factorise()
        if self._positive and (self.negatives or self.status == SINGULAR):
            self._positive = False
            self._pc.reset()
            self._factorise()
        self._made = self._matrix.stateGet()
        if self.counts:
            entries = self._count_of(ENTRIES)
            entries = entries if entries >= 0 else -1_000_000 * entries  # millions
            operations = self.factor.getMumpsRinfog(OPERATIONS)
            self._cost = operations / (OPERATIONS_PER_USE * max(entries, 1))
        self._spent, self._solved, self._last = self._cost, 0, 0

    def _factorise(self) -> None:
        self._set_up()
        while self.status in TOO_SMALL and self.workspace_percent < MOST_SPACE:
            self.workspace_percent = max(LEAST_SPACE, 2 * self.workspace_percent)
            logger.info(
                "factorised with %d %% more workspace than estimated", self.workspace_percent
            )
            self._pc.reset()
            self._set_up()

    def _set_up(self) -> None:
        if self.counts:
            self._matrix.setOption(PETSc.Mat.Option.SPD, self._positive)
        self._direct.setOperators(self._matrix)
        if self.workspace_percent:
            self._pc.setFactorSetUpSolverType()
            self.factor.setMumpsIcntl(SPACE, self.workspace_percent)
        self._begun = True
        self._direct.setUp()

    def _refine(self, b: Any, x: Any, accuracy: float) -> bool:
        """Solve with an older factor; return whether that has succeeded."""
        if self._gradients is None:
            self._gradients = ConjugateGradients(self._matrix, self._pc)
        self._pc.setReusePreconditioner(True)
        done, applied = self._gradients.solve(b, x, accuracy, max(1, int(self._cost)))
        self._count(applied)
        self.iterations = applied
        if done:
            self._back_off.reset()
        else:
            self._back_off.fail()
        return done

    def _count(self, iterations: int) -> None:
        self._spent += iterations
        self._solved += 1
        self._last = iterations
