"""Conjugate gradients that do not pay for knowing how wrong they are.

Their error in the norm of energy is that of the rest r = b - A x: sqrt(r P r), with P near the
inverse of A. Where P is the large factor of an earlier tangent, to apply it takes most of the
time, and the last application would serve for nothing but that number. Norms of the rest are
cheap; one is turned into the other by their ratio at the step before (of the solution before,
where there was no step yet). What is solved too roughly costs Newton's method an iteration.

Linear systems with tangents, by a factor of one of them that is kept while that pays.

To factorise a tangent takes as long as tens of solutions with its factor, and more the larger
it is; but tangents change little from one Newton step to the next. An older factor
preconditions conjugate gradients, which need the more iterations the older it is. It is made
anew where the next system is expected to cost more than all have cost on average since the
last factorisation, that itself included: there the average is least.

Tangents of minima are positive: pivots need no search, which takes a part of the time, more of
it on several ranks. The first tangent that has a negative pivot after all is factorised again
with a search, and so are all later ones: only then are their numbers to be relied upon.

When the tangent of one Newton step serves for the next one, too (Shamanskii, 1967).

Where a motion is foreseen well, a solve begins near its solution: its first step is short, and
the second only mends what the first has left. Tangents hardly change over so short a step, so
that the second needs none of its own, nor a factor. Where a solve begins far away, forces tell
little of how tangents change: they fall by orders while yarns still turn.
"""

from __future__ import annotations

from math import inf, isfinite
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc


class ConjugateGradients:
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


Reason = PETSc.KSP.ConvergedReason
#: Of MUMPS: status, number of negative pivots, entries of the factor, operations for it.
STATUS, NEGATIVE, ENTRIES, OPERATIONS = 1, 12, 29, 3
#: Of MUMPS: null pivots are counted apart instead of ending the factorisation.
COUNT_NULL = 24
#: Status of MUMPS where a pivot is null.
SINGULAR = -10
#: Operations for an entry of the factor that take as long as to use the entry in an iteration.
OPERATIONS_PER_USE = 40.0
#: Error of a solution in the norm of energy, relative: beyond what Newton's steps can tell.
ACCURACY = 1e-8
#: Most tangents in a row for which no older factor is tried after it has failed.
LONGEST_WAIT = 32


def create_direct(comm: MPI.Comm, prefix: str | None = None) -> Any:
    """Return a linear solver: a Cholesky factorisation by MUMPS; collective.

    Args:
        comm: Its ranks.
        prefix: Beginning of the names of PETSc's options, which may choose another one; None
            for no options.
    """
    direct = PETSc.KSP().create(comm)
    direct.setOptionsPrefix(prefix or "wovenfab_own_")
    direct.setType("preonly")
    direct.getPC().setType("cholesky")
    direct.getPC().setFactorSolverType("mumps")
    if prefix is not None:
        direct.setFromOptions()
    return direct


class LinearSolver:
    """Solves with the matrix of the present tangent; collective.

    Attributes:
        definite: Whether matrices are expected to be definite and near to the last one, as
            an older factor needs.
        method: PETSc's names of solver, preconditioner and package.
        counts: Whether the factor tells the number of negative eigenvalues.
    """

    def __init__(
        self, direct: Any, matrix: Any, keep_from: float = inf, accuracy: float = ACCURACY
    ) -> None:
        """Prepare to factorise.

        Args:
            direct: The linear solver, of ``create_direct``; destroyed with this object.
            matrix: Symmetric; its values may change from one solution to the next.
            keep_from: Iterations that a factorisation must be worth before an older factor
                is used; infinite for never.
            accuracy: Error of a solution in the norm of energy, relative, where an older factor
                is used.
        """
        self._matrix, self._keep_from, self._accuracy = matrix, keep_from, accuracy
        self.definite = True
        self._direct, self._pc = direct, direct.getPC()
        self._direct.setOperators(matrix)
        self.method = direct.getType(), self._pc.getType(), self._pc.getFactorSolverType()
        self.counts = self.method == ("preonly", "cholesky", "mumps")
        self._positive = self.counts  # whether all were so far
        self._gradients: ConjugateGradients | None = None
        self._begun = False  # before that PETSc's factor is not to be asked for: that makes one
        self._made = -1  # state of the matrix when it was factorised
        self._cost = 0.0  # of a factorisation, in iterations
        self._spent, self._solved, self._last = 0.0, 0, 0  # since then
        self._wait, self._waiting = 0, 0

    @property
    def keeps(self) -> bool:
        """Whether a tangent and its factor may serve more than once."""
        return self.counts and isfinite(self._keep_from)

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
        """Number of negative pivots of the factor, over all ranks."""
        return self._told(NEGATIVE)

    @property
    def status(self) -> int:
        """How MUMPS ended the last factorisation, negative where it failed; 0 if none tells."""
        tells = self._begun and self._pc.getFactorSolverType() == "mumps"
        return self._told(STATUS) if tells else 0

    def solve(self, b: Any, x: Any, accuracy: float | None = None) -> int:
        """Solve A x = b.

        Args:
            b: Right-hand side.
            x: The solution; overwritten.
            accuracy: Another one for this solution.

        Returns:
            PETSc's reason, negative where it failed.
        """
        if not self.is_present:
            if self._pays() and self._refine(
                b, x, self._accuracy if accuracy is None else accuracy
            ):
                return int(Reason.CONVERGED_RTOL)
            self._renew()
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

    def view(self, viewer: Any) -> None:
        """Describe the solver to a PETSc viewer; collective."""
        self._direct.view(viewer)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        if self._gradients:
            self._gradients.destroy()
        self._direct.destroy()

    def _told(self, number: int) -> int:
        return int(self.factor.getMumpsInfog(number))

    def _pays(self) -> bool:
        """Return whether to try the factor there is."""
        usable = self.counts and self.definite and self._solved and not self.negatives
        if not usable or self._cost < self._keep_from:
            return False
        if self._waiting:
            self._waiting -= 1
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
            entries = self._told(ENTRIES)
            entries = entries if entries >= 0 else -1_000_000 * entries  # millions
            operations = self.factor.getMumpsRinfog(OPERATIONS)
            self._cost = operations / (OPERATIONS_PER_USE * max(entries, 1))
        self._spent, self._solved, self._last = self._cost, 0, 0

    def _factorise(self) -> None:
        if self.counts:
            self._matrix.setOption(PETSc.Mat.Option.SPD, self._positive)
        self._direct.setOperators(self._matrix)
        self._begun = True
        self._direct.setUp()

    def _refine(self, b: Any, x: Any, accuracy: float) -> bool:
        """Solve with an older factor; return whether that has succeeded."""
        if self._gradients is None:
            self._gradients = ConjugateGradients(self._matrix, self._pc)
        self._pc.setReusePreconditioner(True)
        done, applied = self._gradients.solve(b, x, accuracy, max(1, int(self._cost)))
        self._count(applied)
        self._wait = 0 if done else min(max(1, 2 * self._wait), LONGEST_WAIT)
        self._waiting = self._wait
        return done

    def _count(self, iterations: int) -> None:
        self._spent += iterations
        self._solved += 1
        self._last = iterations


Array = NDArray[np.float64]
#: A step must have left no more than this share of the forces that did not balance.
LEFT = 0.03
#: Most solves in a row in which no tangent serves twice after that has not been enough.


class TangentReuse:
    """Chooses the steps that take the tangent of the step before.

    Attributes:
        taken: Whether the last step was one.
    """

    def __init__(self) -> None:
        """Begin before any solve."""
        self.taken = False
        self._wait = self._waiting = 0

    def begin(self) -> None:
        """Begin a solve."""
        if self.taken:  # and the last solve ended with it
            self._wait = 0
        self.taken = False
        self._waiting = max(0, self._waiting - 1)

    def promises(self, left: float) -> bool:
        """Return whether the next step may be one, as far as forces tell.

        Args:
            left: Share of the forces that the last step left.
        """
        if left <= LEFT:
            return not self._waiting
        if self.taken:  # and has not been worth it
            self._wait = min(max(1, 2 * self._wait), LONGEST_WAIT)
            self._waiting = self._wait
        return False


def distance_over(comm: MPI.Comm, now: Array, other: Array, start: Array) -> float:
    """Return the largest difference of two states over that of the first from a third; collective.

    Args:
        comm: Its ranks.
        now: Own unknowns of the first, m.
        other: Those of the second, m.
        start: Those of the third, m.
    """
    ways = [float(np.abs(now - x).max(initial=0.0)) for x in (other, start)]
    step, whole = np.max(comm.allgather(ways), axis=0)
    return float(step / whole) if whole > 0 else np.inf
