"""The equilibrium of a problem: Newton's method, and stress at points where friction is sharp.

Where Newton's method fails on the smooth friction law, the stress becomes a variable at
quadrature points for some steps. The factor of the tangent shows whether a solution is a minimum.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.model.model import Model, with_friction_stress
from wovenfab.solver.back_off import BackOff
from wovenfab.solver.globalisation import CrossingLimit
from wovenfab.solver.interior_point import InteriorPoint
from wovenfab.solver.linear import LinearSolver, create_direct
from wovenfab.solver.newton import NewtonSolver
from wovenfab.solver.problem import PetscOptions, Problem, SolveResult, SolverOptions
from wovenfab.solver.tangent_spectrum import TangentSpectrum

logger = logging.getLogger(__name__)
#: Iterations after which bounded friction gets its stress at points.
SMOOTH_ITERATIONS = 12


class EquilibriumSolver:
    """Solves for the field that balances the forces; PETSc objects are created once.

    Attributes:
        problem: What is solved.
        model: Its model with smooth laws, whatever is solved at present.
        crossing: Where the families would cross along a direction.
        linear: Solves Newton's linear systems.
        newton: Newton's method.
        newton_solver: Its class; a subclass may replace it.
    """

    newton_solver: type[NewtonSolver] = NewtonSolver

    def __init__(self, problem: Problem, options: SolverOptions | None = None) -> None:
        """Create matrix, factorisation and SNES; collective.

        Args:
            problem: The problem; it is destroyed with this object.
            options: Tolerances and alternatives; the usual ones unless given.

        Raises:
            OptionError: If PETSc cannot use an option.
        """
        model, options = problem.model, options or SolverOptions()
        self.problem, self._options, self.model = problem, options, model
        self._accepted = model.field.x.array.copy()
        self.crossing = CrossingLimit(model)
        self._petsc_options = PetscOptions(options.options)
        prefix = self._petsc_options.prefix
        with self._petsc_options.blamed():
            direct = create_direct(model.comm, prefix)
            self._matrix = problem.create_tangent(upper=direct.getPC().getType() == "cholesky")
            accuracy = sqrt(options.tolerance)
            self.linear = LinearSolver(direct, self._matrix, options.keep_factor, accuracy)
            self.newton = self.newton_solver(
                problem, self._matrix, options, self.linear, self.crossing, prefix
            )
            if self._petsc_options.given:
                self._try_options()
        # Set-valued friction always has its stress at points, other friction when it must.
        self._set_valued = interior_point_of(model) if model.friction_stresses else None
        problem.friction = self._set_valued
        self._sharp: tuple[Model, InteriorPoint] | None = None
        self._can_use_points = any(t.effect.bound for t in model.balance.terms)
        self._smooth_law = BackOff("friction by its smooth law fails")

    def advance(self, program: float, second: float = 0.0, duration: float = 1.0) -> SolveResult:
        """Solve for a value of the program, from the model's present equilibrium; collective.

        This is a step of a loop of one's own: look at the result and at the model's field, then
        call :meth:`accept` or :meth:`reject`. Rates are formed by backward Euler.

        Args:
            program: Displacement of the program, m.
            second: That of the second program, m.
            duration: Of the step, s; it matters where an effect depends on rates.
        """
        model, problem = self.model, self.problem
        self._accepted = model.field.x.array.copy()
        for i, weight in enumerate(model.rate_weights):
            weight.value = (1.0, -1.0)[i] / duration if i < 2 else 0.0
        for field in model.history:
            field.x.array[:] = self._accepted
        if model.memory:
            model.memory.begin(self._accepted, duration)
        model.last.x.array[:] = self._accepted
        problem.prescribe_second(second)
        problem.prescribe(program)
        return self.solve()

    def reject(self) -> None:
        """Go back to the equilibrium from which :meth:`advance` began; collective."""
        self.model.field.x.array[:] = self._accepted
        self.restore()

    def solve(self, allow_fallback: bool = True) -> SolveResult:
        """Solve from the model's present field towards the constraints' present values.

        The model's ``last`` field must hold the last equilibrium. On success the
        field holds the new one; otherwise it is undefined and the caller restores it.
        Collective.

        Args:
            allow_fallback: Where the smooth law fails, solve again with the stress at points; not
                needed if there is another start to try.
        """
        problem, most = self.problem, self._options.max_iterations
        if self._is_sharp or not self._can_use_points:
            return self._solve(most)
        field, last = problem.model.field.x.array, problem.model.last.x.array
        start, before = field.copy(), last.copy()
        result = self._solve(min(most, SMOOTH_ITERATIONS))
        if result.converged or not allow_fallback:
            return result
        field[:], last[:] = start, before
        self._use_points()
        again = self._solve(most)
        if again.converged:
            logger.info(
                "friction has its stress at quadrature points: Newton's method on the smooth law "
                "ended with %s after %d iterations", result.reason, result.iterations,
            )  # fmt: skip
            self._smooth_law.fail()
        else:  # the friction was not the cause
            self._use_smooth_law()
        return again

    def accept(self) -> None:
        """Take the present stress at points as that of the accepted state."""
        if self.problem.friction:
            self.problem.friction.accept()
        if self._is_sharp and not self._smooth_law.waits:
            self._use_smooth_law()
        elif self._is_sharp:
            self._smooth_law.skip()
        else:
            self._smooth_law.reset()

    def restore(self) -> None:
        """Go back to the stress at points of the accepted state."""
        if self.problem.friction:
            self.problem.friction.restore()

    def snapshot(self) -> dict[str, Any]:
        """Return what later solves depend on."""
        stress = self.problem.friction
        return {
            "sharp": self._is_sharp,
            "smooth_law": self._smooth_law.snapshot(),
            "stress": stress.snapshot() if stress else None,
            "sharp_stress": self._sharp[1].snapshot() if self._sharp else None,
            "newton": self.newton.snapshot(),
        }

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on from a snapshot; collective."""
        if kept := snapshot["sharp_stress"]:
            self._use_points()
            assert self.problem.friction is not None
            self.problem.friction.resume(kept)
            self._use_smooth_law()
        if snapshot["sharp"]:
            self._use_points()
        self._smooth_law.resume(snapshot["smooth_law"])
        if self.problem.friction and snapshot["stress"]:
            self.problem.friction.resume(snapshot["stress"])
        self.newton.resume(snapshot["newton"])

    @property
    def matrix(self) -> Any:
        """PETSc's matrix of the last tangent."""
        return self._matrix

    @property
    def spectrum(self) -> TangentSpectrum:
        """Eigenvalues of the tangent, by its factor."""
        return self.newton.spectrum

    @property
    def saddle_at_start(self) -> bool:
        """Whether the tangent was indefinite where the last solve began."""
        return self.newton.saddle_at_start

    def plastic_force(self) -> NDArray[np.float64] | float:
        """Return the part of the force (N) of set-valued friction; 0 without any."""
        forms = self.model.friction_force
        return self.problem.force_of(forms) if forms else 0.0

    def mean_plastic_force(self) -> NDArray[np.float64] | float:
        """Return that part (N) as it acts in the mean of the step that has been solved."""
        friction = self.problem.friction
        if friction is None or not friction.varies:
            return self.plastic_force()
        with friction.in_forms(friction.mean_over_step()):
            return self.plastic_force()

    def tangent(self) -> Any:
        """Return the tangent (N/m) of the model's present state, prescribed rows of one."""
        self.newton.assemble_tangent()
        return self._matrix

    def unread_options(self) -> list[str]:
        """Return the user's options that PETSc has not read so far."""
        return self._petsc_options.unread()

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self._petsc_options.clear()
        self.newton.destroy()
        self.linear.destroy()
        self._matrix.destroy()
        self.problem.destroy()

    def _solve(self, most: int) -> SolveResult:
        """Solve with the present forms and at most so many iterations."""
        newton = self.newton
        reason = newton.solve(most)
        return SolveResult(
            converged=reason > 0,
            reason=newton.reason,
            iterations=newton.snes.getIterationNumber(),
            residual=newton.norm,
            negatives=newton.judge() if reason > 0 else 0,
        )

    def _try_options(self) -> None:
        """Factorise once before anything is written: PETSc reads some options only then."""
        self.newton.assemble_tangent()
        self.linear.solve(self.problem.residual, self.newton.solution)
        self.linear.forget()
        self.newton.solution.set(0.0)

    @property
    def _is_sharp(self) -> bool:
        """Whether all bounded friction has its stress at points at present."""
        return self.problem.model is not self.model

    def _use_points(self) -> None:
        """Change to forms with the stress of all bounded friction at points.

        Stresses and stiffnesses of the last time are where it starts: nearer than none, since a
        smooth law gives the stress by the rate alone.
        """
        if self._sharp is None:
            model = with_friction_stress(self.model)
            self._sharp = model, interior_point_of(model)
        self.problem.model, self.problem.friction = self._sharp
        self.problem.friction.restore()

    def _use_smooth_law(self) -> None:
        """Change back to the model's own forms."""
        self.problem.model, self.problem.friction = self.model, self._set_valued


def interior_point_of(model: Model) -> InteriorPoint:
    """Return the interior-point method for the friction stresses of a model; collective."""
    return InteriorPoint(model.friction_stresses, model.comm, model.friction)
