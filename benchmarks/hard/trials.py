"""Other ways to a solution, for comparison only: the solver with one thing done otherwise."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from petsc4py import PETSc

from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.newton import NewtonSolver
from wovenfab.solver.options import SolveResult, SolverOptions
from wovenfab.solver.problem import Problem
from wovenfab.stepping.step_size import CUT, StepSizeControl

Reason = PETSc.SNES.ConvergedReason
#: Iterations of a trust region, whose steps are shorter.
MANY = 60


class Counted(EquilibriumSolver):
    """The solver as it is, with its efforts counted.

    Attributes:
        solves: Number of solves, failed ones included.
        iterations: Their iterations.
    """

    solves = 0
    iterations = 0

    def solve(self) -> SolveResult:
        """Solve and count."""
        outcome = super().solve()
        self.solves += 1
        self.iterations += outcome.iterations
        return outcome


class _UnlimitedNewton(NewtonSolver):
    """Newton's method whose steps may cross the families."""

    def admissible_length(self, y: Any) -> float:
        """Note the step and take all of it."""
        super().admissible_length(y)
        return 1.0


class Unlimited(EquilibriumSolver):
    """The solver without the step limit."""

    newton_solver = _UnlimitedNewton


class _UnsearchedNewton(NewtonSolver):
    """Newton's method without line search."""

    def search_line(self, x: Any, y: Any, longest: float) -> float:
        """Take the longest step."""
        self._search.forget()
        return longest


class Unsearched(EquilibriumSolver):
    """The solver without line search."""

    newton_solver = _UnsearchedNewton


class _PatientNewton(NewtonSolver):
    """Goes on after searches that find no lower potential, to the last iteration."""

    def test(self, snes: Any, iteration: int, norms: tuple[float, float, float]) -> int:
        """End as usual, but for searches without success."""
        self._search.failures = 0
        return super().test(snes, iteration, norms)


class Patient(Counted):
    """Goes on after searches that find no lower potential, to the last iteration."""

    newton_solver = _PatientNewton


class _TrustRegionNewton(NewtonSolver):
    """Newton's method whose first step moves the grips, and a trust region after it."""

    def test(self, snes: Any, iteration: int, norms: tuple[float, float, float]) -> int:
        """End as usual, or when the grips are in place."""
        if snes.getType() == "newtonls" and self.problem.attained:
            self.norm = norms[2]
            return int(Reason.CONVERGED_ITS)
        return super().test(snes, iteration, norms)

    def evaluate_objective(self, snes: Any, x: Any) -> float:
        """Return the potential, J; infinite where families cross."""
        energy = super().evaluate_objective(snes, x)
        return energy if self.crossing.margin() > 0 else float("inf")

    def evaluate_jacobian(self, snes: Any, x: Any, matrix: Any, preconditioner: Any) -> None:
        """Put the tangent in the matrix, in a trust region the plain one."""
        if snes.getType() == "newtontr":
            self.problem.load(x)
            self.problem.model.last.x.array[:] = self.problem.model.field.x.array
        self.form_tangent(x)


class TrustRegion(Counted):
    """PETSc's trust region with the plain tangent, once the grips are in place.

    The first step must raise the potential, for it moves the grips: it is Newton's.
    """

    newton_solver = _TrustRegionNewton

    def solve(self) -> SolveResult:
        """Move the grips by Newton's method and go on with a trust region."""
        snes = self.newton.snes
        snes.setType("newtonls")
        snes.setTolerances(max_it=self._options.max_iterations)
        first = super().solve()
        if not first.converged:
            return first
        snes.setType("newtontr")
        snes.setTolerances(max_it=MANY)
        second = super().solve()
        self.solves -= 1
        return replace(second, iterations=first.iterations + second.iterations)


class Shifted(Counted):
    """Shifts every indefinite tangent until it is definite."""

    def __init__(self, problem: Problem, options: SolverOptions) -> None:
        """Create it as usual, with shifts."""
        super().__init__(problem, replace(options, descend=True))


class Halving(StepSizeControl):
    """Forgets at each planned time what it has learnt, and halves again."""

    def __init__(self, smallest: float) -> None:
        """Begin with whole steps."""
        super().__init__(smallest)
        self._targets: list[float] = []
        self._now = 0.0

    def next(self, now: float, end: float) -> float:
        """Return the nearest time that is still to be reached."""
        self._now = now
        self._targets = self._targets or [end]
        return self._targets[-1]

    def accepted(self, length: float, tangents: int) -> None:
        """Go on to the next time."""
        self._targets.pop()

    def reduce(self, length: float, planned: float) -> bool:
        """Step half as far first."""
        self._targets.append(self._now + CUT * length)
        return CUT * length >= self._smallest * planned

    def bisect(self, until: float, length: float) -> None:
        """Step half as far first."""
        self._targets.append(self._now + CUT * length)
