"""Newton's method on the incremental potential of a problem, by PETSc's SNES.

SNES calls back for residual and tangent. Before it takes a step, ``limit_step`` makes the
step admissible (no crossing of the families) and, once the prescribed placements are
attained, shortens it until the incremental potential falls enough.

Two modified tangents replace an indefinite one. Where the line search shortens a step, or where
friction at its bound leaves no potential to search on, the positive part of the tangent gives
another one: sharply bent yarns turn, and their potential in Cartesian placements is far from the
tangent's paraboloid. Where a run follows the branches beyond a loss of stability, each indefinite
tangent is shifted instead. The positive part lacks the compressive forces that choose a branch;
with it the compression case needs more steps.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from wovenfab.compat import NOT_FINITE
from wovenfab.model.model import preserved
from wovenfab.solver.globalisation import (
    CROSSING_SHARE,
    Convergence,
    CrossingLimit,
    LineSearch,
    largest_cell,
)
from wovenfab.solver.linear import LinearSolver
from wovenfab.solver.problem import Problem, SolverOptions
from wovenfab.solver.tangent_spectrum import TangentSpectrum, start_vector

logger = logging.getLogger(__name__)
Array = NDArray[np.float64]
Reason = PETSc.SNES.ConvergedReason
_REASONS = {
    value: name for name, value in vars(Reason).items() if isinstance(value, int) and value != 0
}
#: Line searches in a row without a lower potential that end a solve; the second one is
#: along a step by the plain tangent.
STUCK = 2


class _Linear:
    """Newton's linear systems, as PETSc's linear solver of type python."""

    def __init__(self, linear: LinearSolver, held: NDArray[np.int32]) -> None:
        self._linear, self._held = linear, held

    def solve(self, ksp: Any, b: Any, x: Any) -> None:
        """Solve one system; the rows of ``held`` unknowns are the identity's."""
        ksp.setConvergedReason(self._linear.solve(b, x))
        if self._linear.method[0] != "preonly":  # its error would never let them be attained
            x.array_w[self._held] = b.array_r[self._held]

    def view(self, ksp: Any, viewer: Any) -> None:
        """Describe the linear solver, as ``-snes_view`` asks."""
        self._linear.view(viewer)


class NewtonSolver:
    """Solves a problem with its present forms; objects are created once.

    Attributes:
        problem: Residual, tangent and potential.
        linear: Solves the linear systems.
        crossing: Step length at which the families would cross.
        snes: PETSc's solver.
        solution: Its unknowns, m.
        spectrum: Eigenvalues of the tangent.
        step: The last step that was judged, before it was shortened, at own unknowns, m.
        formed: Number of tangents that were formed so far, for whatever purpose.
        norm: Norm of the residual force at the last iterate, N.
        saddle_at_start: Whether the tangent was indefinite where the last solve began.
        on_iteration: Called at each iterate, on every rank; what it raises ends the solve.
    """

    def __init__(
        self,
        problem: Problem,
        matrix: Any,
        options: SolverOptions,
        linear: LinearSolver,
        crossing: CrossingLimit,
        prefix: str = "",
    ) -> None:
        """Create vectors and SNES; PETSc's options must be set.

        Args:
            problem: Residual, tangent and potential.
            matrix: For its tangent.
            options: Tolerances and alternatives.
            linear: Solves the linear systems.
            crossing: Step length at which the families would cross.
            prefix: Beginning of the names of its PETSc options.
        """
        self.problem, self.options, self.linear, self.crossing = problem, options, linear, crossing
        self.solution = problem.residual.duplicate()
        self._matrix = matrix
        self.norm, self.formed, self.saddle_at_start = 0.0, 0, False
        # The last solution, where the tangent was formed, the last step.
        self._before, self._assembled, self.step = np.zeros((3, self.solution.getLocalSize()))
        model = problem.model
        cell_size = largest_cell(model.sheet.mesh)
        self._convergence = Convergence(options.tolerance, cell_size, model.unknowns)
        self.line_search = LineSearch(problem)
        self._length, self._cg = 0.0, 0  # of the last step
        self._most = options.max_iterations
        self.on_iteration: Callable[[], None] = lambda: None
        self.snes = self._create_snes(prefix)
        start = start_vector(problem.model.placements, problem.constraints.bcs, options.seed)
        self.spectrum = TangentSpectrum(linear, matrix, self.assemble_tangent, start)

    def solve(self, most: int) -> int:
        """Solve from the model's present field; return PETSc's reason.

        The model's ``last`` field must hold the last solution.

        Args:
            most: Number of iterations.
        """
        problem = self.problem
        problem.constraints.complete(problem.model.field)
        self.solution.array_w[:] = problem.model.field.x.array[: self.solution.getLocalSize()]
        self.norm, self._most = np.nan, most
        self._before[:] = problem.model.last.x.array[: self._before.size]
        problem.begin()
        self.line_search.begin()
        self.spectrum.restart()
        # Shifted tangents and stress at points change the matrix too much for an older factor.
        self.linear.definite = not (self.options.descend or problem.friction)
        if self.linear.status < 0:
            self.linear.forget()
        if problem.friction:
            problem.friction.begin(lambda: problem.size_of_tangent(self._matrix))
        self.snes.solve(None, self.solution)
        problem.load(self.solution)
        return int(self.snes.getConvergedReason())

    def snapshot(self) -> dict[str, Any]:
        """Return what later solves depend on."""
        return {
            "convergence": self._convergence.snapshot(),
            "spectrum": self.spectrum.snapshot(),
            "linear": self.linear.snapshot(),
        }

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on from a snapshot; the first tangent is factorised anew."""
        self.linear.resume(snapshot["linear"])
        self.spectrum.resume(snapshot["spectrum"])
        self._convergence.resume(snapshot["convergence"])

    @property
    def reason(self) -> str:
        """PETSc's name of the reason for which the last solve ended."""
        value: int = self.snes.getConvergedReason()
        name: str = _REASONS.get(value, str(value))
        return name

    def judge(self) -> int:
        """Return the number of negative eigenvalues at a solution; note its force and energy."""
        moved = self.snes.getIterationNumber() > 0
        negatives = self.spectrum.judge(self._distance(self._assembled) if moved else np.inf)
        self._convergence.accept(self.problem.force_norm, self.line_search.potential or 0.0)
        return negatives

    def assemble_tangent(self) -> None:
        """Assemble the plain tangent of the model's present field."""
        model = self.problem.model
        model.last.x.array[:] = model.field.x.array
        self.solution.array_w[:] = model.field.x.array[: self.solution.getLocalSize()]
        self.form_tangent(self.solution)

    def evaluate_residual(self, snes: Any, x: Any, b: Any) -> None:
        """Put the residual in ``b``."""
        self.problem.load(x)
        self.problem.evaluate_residual(b)

    def evaluate_jacobian(self, snes: Any, x: Any, matrix: Any, preconditioner: Any) -> None:
        """Assemble the tangent."""
        self.spectrum.restart()
        self.form_tangent(x)

    def form_tangent(self, x: Any) -> None:
        """Assemble the tangent at given unknowns."""
        self.formed += 1
        self.problem.load(x)
        self._assembled[:] = x.array_r
        size = self.problem.evaluate_tangent(self._matrix)
        self._convergence.measure(size, x.norm(PETSc.NormType.INFINITY))

    def evaluate_objective(self, snes: Any, x: Any) -> float:
        """Return the potential, J."""
        self.problem.load(x)
        return self.problem.energy()

    def limit_step(self, x: Any, y: Any) -> bool:
        """Shorten the step so that x - y is admissible and lowers the potential, and take it."""
        problem, model = self.problem, self.problem.model
        problem.load(x)
        self._cg = self.linear.iterations
        if not self.snes.getIterationNumber():
            self.saddle_at_start = self.spectrum.saddle
            self.spectrum.begin()
        if problem.attained and self.options.descend:
            self.spectrum.shift(self.snes.getFunction()[0], y)
        model.last.x.array[:] = model.field.x.array
        inside = 1.0
        if problem.friction:
            # No line search shortens the far step that an indefinite tangent may give.
            if problem.friction.started and self.spectrum.saddle:
                self._take_positive_part(x, y)
            inside = self._correct(y)
        length = min(inside, self.admissible_length(y))
        if problem.friction:
            self.line_search.note(length)
            length = problem.friction.admitted(length)
        elif problem.attained:
            length = self.search_line(x, y, length)
        else:
            self.line_search.forget()
        self._length = length
        if length < 1.0:
            y.scale(length)
        if length > 0.0:
            problem.advance(x, y, length)
        return length < 1.0

    def _correct(self, y: Any) -> float:
        """Correct Newton's step by the stresses of friction; return its largest length."""
        assert self.problem.friction is not None

        def solve(stress: Array) -> Array:
            self.linear.solve(self.problem.friction_force(stress), y)
            return np.array(y.array_r)

        step, inside = self.problem.friction.correct(np.array(y.array_r), solve)
        y.array_w[:] = step
        return inside

    def admissible_length(self, y: Any) -> float:
        """Return the largest length of a step (to be subtracted) that is surely admissible."""
        self.step[:] = -y.array_r
        return CROSSING_SHARE * self.crossing.limit(self.step)

    def search_line(self, x: Any, y: Any, longest: float) -> float:
        """Return a step length that lowers the potential, of another step if need be.

        Args:
            x: The iterate.
            y: Newton's step, to be subtracted; that by the positive part may overwrite it.
            longest: First length to try.
        """
        search, force = self.line_search, self.snes.getFunction()[0]
        roundoff = self._convergence.energy_roundoff
        before, saddle = (search.potential, search.failures), self.spectrum.saddle
        length = search.along(self.step, force.dot(y), longest, roundoff, loose=not saddle)
        if length == longest or not saddle:
            return length
        if not self._take_positive_part(x, y):
            return length
        search.potential, search.failures = before
        longest = min(self.admissible_length(y), 1.0)
        length = search.along(self.step, force.dot(y), longest, roundoff)
        search.decrement = np.inf  # only the tangent itself converges quadratically
        return length

    def _take_positive_part(self, x: Any, y: Any) -> bool:
        """Replace Newton's step by that of the tangent's positive part; return whether it is.

        Args:
            x: The iterate.
            y: Newton's step, to be subtracted; it is overwritten.
        """
        weight = self.problem.model.geometric_weight
        with preserved(weight):
            weight.value = 0.0
            self.form_tangent(x)
        return self.spectrum.replace(self.snes.getFunction()[0], y)

    def test(self, snes: Any, iteration: int, norms: tuple[float, float, float]) -> int:
        """Return PETSc's reason to end the solve, or that it goes on."""
        self.on_iteration()
        residual = norms[2]
        self.norm = residual
        if logger.isEnabledFor(logging.DEBUG):
            self._log(iteration, residual)
        if not np.isfinite([residual, self.problem.force_norm]).all():
            return int(getattr(Reason, NOT_FINITE))
        if self.problem.attained and self._obeys_friction_laws():
            reason = self._convergence.reason(
                residual,
                self.problem.force_norm,
                None if self.problem.friction else self.line_search.decrement,
                self.line_search.potential or 0.0,
            )
            if reason is not None:
                return reason
        if self.line_search.failures >= STUCK:
            return int(Reason.DIVERGED_LINE_SEARCH)
        if iteration >= self._most:
            return int(Reason.DIVERGED_MAX_IT)
        return int(Reason.CONVERGED_ITERATING)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.spectrum.destroy()
        self.snes.destroy()
        self.solution.destroy()

    def _create_snes(self, prefix: str) -> Any:
        snes = PETSc.SNES().create(self.problem.model.comm)
        snes.setOptionsPrefix(prefix)
        snes.setType("newtonls")
        snes.setTolerances(max_it=self.options.max_iterations)
        ksp = snes.getKSP()
        ksp.setOptionsPrefix(f"{prefix}newton_")  # those without newton_ are of the direct solver
        snes.setFromOptions()
        ksp.setType("python")
        ksp.setPythonContext(_Linear(self.linear, self.problem.constraints.own))
        ksp.getPC().setType("none")
        snes.setFunction(self.evaluate_residual, self.problem.residual)
        snes.setJacobian(self.evaluate_jacobian, self._matrix)
        snes.setObjective(self.evaluate_objective)
        snes.setLineSearchPreCheck(self.limit_step)
        snes.setConvergenceTest(self.test)
        return snes

    def _obeys_friction_laws(self) -> bool:
        """Return whether the stresses at points obey their laws."""
        friction, tolerance = self.problem.friction, self.options.tolerance
        return friction is None or friction.obeys_law(tolerance, self._energy_scale)

    def _energy_scale(self) -> float:
        """Return the largest energy (J) of an equilibrium so far, and of this state."""
        return self._convergence.scale_of(self.line_search.measure())

    def _distance(self, place: Array) -> float:
        """Return the distance of unknowns from the present ones, relative; collective.

        It is over the distance of the present ones from the last solution.
        """
        now = self.solution.array_r
        distances = [float(np.abs(now - x).max(initial=0.0)) for x in (place, self._before)]
        step, whole = np.max(self.problem.model.comm.allgather(distances), axis=0)
        return float(step / whole) if whole > 0 else np.inf

    def _log(self, iteration: int, residual: float) -> None:
        """Log the iterate and the step that led to it; collective."""
        norms = self.problem.residual_norms()
        potential = self.line_search.potential
        if potential is None:
            potential = self.problem.energy()
        step = "start"
        if iteration:
            tangent = self.spectrum.modification or "plain"
            linear = f"{self._cg} CG iterations" if self._cg else "new factor"
            step = f"step {self._length:.3g}, tangent {tangent}, {linear}"
        fields = ", ".join(f"|r_{i}| {norm:.3e}" for i, norm in enumerate(norms, start=1))
        logger.debug(
            "%3d |r| %.6e N (%s), potential %.9e J, %s",
            iteration,
            residual,
            fields,
            potential,
            step,
        )
