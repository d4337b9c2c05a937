"""What a factorisation tells of a tangent: its negative and its null pivots.

What the factor of the tangent knows: minimum or saddle, softest mode, ways down.

L D L' has as many negative pivots as the tangent has negative eigenvalues (Sylvester), so
that the factor of each Newton step tells for nothing whether the state near by is a
minimum of the incremental potential. Prescribed unknowns have rows of the identity: they
count as positive, and nothing here moves them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray
from petsc4py import PETSc

from wovenfab.model.spaces import Placements
from wovenfab.solver.linear import COUNT_NULL, NEGATIVE, STATUS, LinearSolver, create_direct

#: Of MUMPS: number of null pivots, over all ranks.
NULL = 28
#: Shift over the largest diagonal entry, and sweeps, that bring out a null vector.
NULL_SHIFT, NULL_SWEEPS = 1e-12, 3


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
    ksp = _factorised(matrix)
    ksp.setUp()
    factor = ksp.getPC().getFactorMatrix()
    found = Pivots(*(int(factor.getMumpsInfog(i)) for i in (NEGATIVE, NULL, STATUS)))
    ksp.destroy()
    return found


def null_vector(matrix: Any, start: Any) -> NDArray[np.float64]:
    """Return the direction that a (nearly) singular matrix resists least; collective.

    Args:
        matrix: Symmetric; it is left with a tiny shift.
        start: Vector to begin with; it is overwritten.

    Returns:
        At this rank's own unknowns, of length one over all.
    """
    diagonal = matrix.getDiagonal()
    matrix.shift(NULL_SHIFT * (diagonal.norm(PETSc.NormType.INFINITY) or 1.0))
    ksp, image = _factorised(matrix), start.duplicate()
    for _ in range(NULL_SWEEPS):
        ksp.solve(start, image)
        image.scale(1 / (image.norm() or 1.0))
        image.copy(start)
    found = np.array(start.array_r)
    for item in (ksp, image, diagonal):
        item.destroy()
    return found


def _factorised(matrix: Any) -> Any:
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


#: Sweeps of inverse iteration: a step, the first step, and most for a mode (to ``SAME``).
SWEEPS, FIRST_SWEEPS, MOST_SWEEPS, SAME = 1, 6, 400, 1e-7
#: Error that a sweep may have where the factor is an older one.
ROUGH = 0.1
#: Share of the start that is added at each step, lest another mode become the softest unseen.
MIXED = 0.1
#: Share of the way between solutions that Newton's last matrix need not have seen.
UNSEEN = 0.1
#: Waves and their largest number along the sheet in the field that starts the iteration.
WAVES, SHORTEST = 24, 5
#: Growth of the shift that makes a tangent definite, and how often it may grow.
GROWTH, TRIALS = 4.0, 60


class TangentSpectrum:
    """Judges tangents by their factor.

    Attributes:
        altered: Whether the matrix was made another one than the tangent, to go down.
    """

    def __init__(
        self, factor: LinearSolver, matrix: Any, assemble: Callable[[], None], start: Any
    ) -> None:
        """Use the factor of Newton's steps if it is one that counts, else another one.

        Args:
            factor: Solves Newton's systems.
            matrix: Its matrix.
            assemble: Puts the tangent of the present state in the matrix.
            start: Vector that starts the search of the softest mode, zero where prescribed.
        """
        self._matrix, self._assemble = matrix, assemble
        self._own = None
        if not factor.counts:
            self._own = LinearSolver(create_direct(matrix.comm), matrix)
        self._factor = self._own or factor
        self._start = start
        self._soft, self._image = start.copy(), start.duplicate()
        self._anything = start.norm() > 0
        self._value: float | None = None  # smallest eigenvalue of the last judgement, N/m
        self.altered, self._shift = False, 0.0  # of the present factor, N/m

    def judge(self, unseen: float) -> int:
        """Return the number of negative eigenvalues of the tangent at a solution; collective.

        Newton's last matrix was formed one step before the solution. If that step was
        short it decides, unless it is indefinite, or so soft that another change as large
        as the one since the last solution would make it so. Then, and after a large step,
        the tangent at the solution itself is factorised.

        Args:
            unseen: How far from the solution that matrix was formed, over the way from the
                last solution to this one.
        """
        if not self._anything:  # everything is prescribed
            return 0
        before = self._value
        known = unseen <= UNSEEN and not self._own and not self.altered
        if known and before is not None and not self._factor.negatives:
            self._soft.axpy(MIXED, self._start)
            value = self._sweep(SWEEPS)  # may have had to factorise
            if value > before - value and not self._factor.negatives:
                self._value = value
                return 0
        self._refactor()
        found = self._factor.negatives
        self._value = self._sweep(SWEEPS if before else FIRST_SWEEPS) if not found else None
        return found

    def begin(self) -> None:
        """Note how soft the state is that a solve begins at, if no solution is known; collective.

        Newton's first matrix must just have been solved with: it is that state's.
        """
        fresh = self._factor.is_present and not self._own and not self._factor.negatives
        if self._anything and self._value is None and fresh:
            self._value = self._sweep(FIRST_SWEEPS)

    @property
    def saddle(self) -> bool:
        """Whether the last matrix of Newton's solver is indefinite, as far as its factor tells."""
        return not self._own and self._factor.negatives > 0

    def mode(self) -> NDArray[np.float64]:
        """Return the eigenvector of the lowest eigenvalue in the present state; collective.

        Returns:
            At this rank's own unknowns, of length one over all; its sign follows from
            the start vector alone.
        """
        self._refactor()
        if self._factor.negatives:
            self._make_definite()
        self._start.copy(self._soft)
        last = np.inf
        for _ in range(MOST_SWEEPS):
            value = self._sweep(1)
            if abs(value - last) <= SAME * abs(value):
                break
            last = value
        if self._soft.dot(self._start) < 0:
            self._soft.scale(-1.0)
        return np.array(self._soft.array_r)

    def descend(self, force: Any, step: Any) -> None:
        """Replace Newton's step by one that goes down where the tangent is indefinite.

        The tangent is shifted by a multiple of the identity until it is definite.

        Args:
            force: Residual force.
            step: Newton's step, to be subtracted; it is overwritten.
        """
        self.altered, self._shift = False, 0.0
        if self._own:
            self._factor.renew()
        if self._factor.negatives:
            self._make_definite()
            self._factor.solve(force, step)

    def replace(self, force: Any, step: Any) -> bool:
        """Replace Newton's step by that of a matrix which was put in place of the tangent.

        Args:
            force: Residual force.
            step: Newton's step, to be subtracted; it is overwritten.

        Returns:
            Whether the matrix is positive; if not, the step stays.
        """
        self.altered, self._shift = True, 0.0
        self._factor.renew()
        if self._factor.negatives:
            return False
        self._factor.solve(force, step)
        return True

    def restart(self) -> None:
        """Forget a matrix that is not the tangent, whose factor is of no use."""
        if self.altered:
            self._factor.forget()
        self.altered, self._shift = False, 0.0

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for item in (self._own, self._start, self._soft, self._image):
            if item is not None:
                item.destroy()

    def _refactor(self) -> None:
        self._assemble()
        self.altered, self._shift = False, 0.0
        self._factor.renew()

    def _make_definite(self) -> None:
        """Shift the matrix until its factor has no negative pivot."""
        shift = 2 * abs(self._sweep(FIRST_SWEEPS))
        for _ in range(TRIALS):
            self._matrix.shift(shift - self._shift)
            self.altered, self._shift = True, shift
            self._factor.renew()
            if not self._factor.negatives:
                return
            shift *= GROWTH

    def _sweep(self, number: int) -> float:
        """Iterate with the inverse; return Rayleigh's quotient (N/m) of the softest vector."""
        value = 0.0
        for _ in range(number):
            self._factor.solve(self._soft, self._image, ROUGH)
            size = self._image.norm()
            self._matrix.mult(self._image, self._soft)
            value = self._image.dot(self._soft) / size**2
            self._image.copy(self._soft)
            self._soft.scale(1 / size)
        return value - self._shift


def start_vector(placements: Placements, bcs: Sequence[fem.DirichletBC], seed: int) -> Any:
    """Return a smooth random field as a vector, zero where placements are prescribed.

    It depends on positions and seed alone, so that any number of ranks has the same.

    Args:
        placements: The unknowns.
        bcs: Prescribed placements.
        seed: Of the random numbers.
    """
    places, (low, high) = placements.positions, bounding_box(placements)
    random = np.random.default_rng(seed)
    waves = random.uniform(-SHORTEST, SHORTEST, (WAVES, 2)) * 2 * np.pi / np.max(high - low)
    phases = random.uniform(0, 2 * np.pi, WAVES)
    weights = random.standard_normal((WAVES, placements.count, 2))
    shape = np.tensordot(np.sin((places - low) @ waves.T + phases), weights, axes=1)
    field = fem.Function(placements.space)
    values = field.x.array.reshape(-1, 2)
    for family in range(placements.count):
        blocks = np.unique(placements.blocks[:, :, family])
        values[blocks] = shape[blocks, family]
    vector = field.x.petsc_vec.copy()
    fem_petsc.set_bc(vector, list(bcs), alpha=0.0)
    if size := vector.norm():  # nothing is free where all is prescribed
        vector.scale(1 / size)
    return vector


def bounding_box(placements: Placements) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the smallest and largest x and y (m) of the positions; collective."""
    places, comm = placements.positions, placements.space.mesh.comm
    low = comm.allgather(places.min(axis=0, initial=np.inf))
    high = comm.allgather(places.max(axis=0, initial=-np.inf))
    return np.min(low, axis=0), np.max(high, axis=0)
