"""The spectrum of the tangent by its factor: minimum or saddle, softest mode, definite tangents.

L D L' has as many negative pivots as the tangent has negative eigenvalues (Sylvester), so
that the factor of each Newton step tells at no cost whether the state is a minimum of the
incremental potential. Prescribed unknowns have rows of the identity: they count as positive,
and nothing here moves them.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from wovenfab.model.spaces import Placements
from wovenfab.solver.linear import LinearSolver, create_direct

logger = logging.getLogger(__name__)
#: Inverse iterations for a mode at most, and the change of the eigenvalue that ends them.
MOST_SWEEPS, SAME = 400, 1e-7
#: Accuracy of an inverse iteration where the factor is an older one: with a tenth it hardly sees
#: a mode that has become softer since.
ROUGH = 0.01
#: Share of the start vector that is added at each step, so that no new softest mode is missed.
MIXED = 0.1
#: Newton's last matrix decides if it was formed nearer to the solution than this share of the
#: distance between solutions.
UNSEEN = 0.1
#: Waves and their largest number along the sheet in the field that starts the iteration.
WAVES, SHORTEST = 24, 5
#: Growth of the shift that makes a tangent definite, and how often it may grow.
GROWTH, TRIALS = 4.0, 60


class TangentSpectrum:
    """Eigenvalues and modified tangents by the factor of Newton's matrix.

    Attributes:
        modification: How the matrix differs from the tangent: ``"shifted"`` or
            ``"positive part"``; None where it does not.
    """

    def __init__(
        self, linear: LinearSolver, matrix: Any, assemble: Callable[[], None], start: Any
    ) -> None:
        """Use the factor of Newton's steps if it counts negative pivots, else an own one.

        Args:
            linear: Solves Newton's systems.
            matrix: Its matrix.
            assemble: Assembles the tangent of the present state.
            start: Start vector of inverse iteration, zero where prescribed.
        """
        self._matrix, self._assemble = matrix, assemble
        self._own = None
        if not linear.counts:
            direct = create_direct(matrix.comm, linear.prefix, options=False)
            self._own = LinearSolver(direct, matrix)
        self._linear = self._own or linear
        self._start = start
        self._soft, self._image = start.copy(), start.duplicate()
        self._moves = start.norm() > 0  # whether anything is free
        self._value: float | None = None  # smallest eigenvalue at the last solution, N/m
        self.modification: str | None = None
        self._shift = 0.0  # of the present matrix, N/m

    def judge(self, unseen: float) -> int:
        """Return the number of negative eigenvalues of the tangent at a solution; collective.

        Newton's last matrix was formed one step before the solution. If that step was
        short it decides, unless it is indefinite, or so soft that another change as large
        as the one since the last solution would make it so. Then, and after a large step,
        the tangent at the solution itself is factorised.

        Args:
            unseen: Distance from the solution at which that matrix was formed, over the
                distance of the last solution.
        """
        if not self._moves:
            return 0
        before = self._value
        known = unseen <= UNSEEN and not self._own and not self.altered
        if known and before is not None and not self._linear.negatives:
            self._soft.axpy(MIXED, self._start)
            value = self._sweep()  # may have had to factorise
            if value > before - value and not self._linear.negatives:
                self._value = value
                return 0
        self._refactor()
        negatives = self._linear.negatives
        self._value = None if negatives else self._sweep()
        return negatives

    def snapshot(self) -> dict[str, Any]:
        """Return the softest vector and its eigenvalue, as far as they are known."""
        return {"soft": self._soft.array_r.copy(), "value": self._value}

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on with those of a snapshot."""
        self._soft.array_w[:] = snapshot["soft"][: self._soft.getLocalSize()]
        self._value = snapshot["value"]

    def begin(self) -> None:
        """Note the smallest eigenvalue where a solve begins, if none is known; collective.

        Newton's first matrix, which is of that state, must just have been solved with.
        """
        fresh = self._linear.is_present and not self._own and not self._linear.negatives
        if self._moves and self._value is None and fresh:
            self._value = self._sweep()

    @property
    def saddle(self) -> bool:
        """Whether Newton's last matrix is indefinite, as far as its factor counts."""
        return not self._own and self._linear.negatives > 0

    def mode(self) -> NDArray[np.float64]:
        """Return the eigenvector of the lowest eigenvalue in the present state; collective.

        Returns:
            At this rank's own unknowns, of length one over all; its sign follows from
            the start vector alone.
        """
        self._refactor()
        if self._linear.negatives:
            self._make_definite()
        self._start.copy(self._soft)
        last = np.inf
        for _ in range(MOST_SWEEPS):
            value = self._sweep()
            if abs(value - last) <= SAME * abs(value):
                break
            last = value
        if self._soft.dot(self._start) < 0:
            self._soft.scale(-1.0)
        return np.array(self._soft.array_r)

    @property
    def altered(self) -> bool:
        """Whether the matrix is not the tangent."""
        return self.modification is not None

    def shift(self, force: Any, step: Any) -> None:
        """Replace Newton's step by that of a shifted tangent where the tangent is indefinite.

        The tangent is shifted by a multiple of the identity until it is definite.

        Args:
            force: Residual force.
            step: Newton's step, to be subtracted; it is overwritten.
        """
        self._modify(None)
        if self._own:
            self._linear.renew()
        if self._linear.negatives:
            self._make_definite()
            self._linear.solve(force, step)

    def replace(self, force: Any, step: Any) -> bool:
        """Replace Newton's step by that of the tangent's positive part, now in the matrix.

        Args:
            force: Residual force.
            step: Newton's step, to be subtracted; it is overwritten.

        Returns:
            Whether the matrix is definite; if not, the step stays.
        """
        self._modify("positive part")
        self._linear.renew()
        if self._linear.negatives:
            return False
        self._linear.solve(force, step)
        return True

    def restart(self) -> None:
        """Forget a matrix that is not the tangent, and its factor."""
        if self.altered:
            self._linear.forget()
        self._modify(None)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for item in (self._own, self._start, self._soft, self._image):
            if item is not None:
                item.destroy()

    def _refactor(self) -> None:
        self._assemble()
        self._modify(None)
        self._linear.renew()

    def _modify(self, modification: str | None, shift: float = 0.0) -> None:
        """Note what the matrix is."""
        if modification and modification != self.modification:
            logger.info("indefinite tangent: the step is by the %s one", modification)
        self.modification, self._shift = modification, shift

    def _make_definite(self) -> None:
        """Shift the matrix until its factor has no negative pivot."""
        shift = 2 * abs(self._sweep())
        for _ in range(TRIALS):
            self._matrix.shift(shift - self._shift)
            self._modify("shifted", shift)
            self._linear.renew()
            if not self._linear.negatives:
                return
            shift *= GROWTH

    def _sweep(self) -> float:
        """Iterate once with the inverse; return the Rayleigh quotient (N/m) of the softest vector.

        From the start vector, one iteration has the smallest eigenvalue to a thousandth.
        """
        self._linear.solve(self._soft, self._image, ROUGH)
        size = self._image.norm()
        self._matrix.mult(self._image, self._soft)
        value: float = self._image.dot(self._soft) / size**2
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
    families = range(placements.count)
    rows = np.stack([shape[placements.blocks[:, :, i], i] for i in families], axis=2)
    field.x.array[:] = placements.from_cells(rows)
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
