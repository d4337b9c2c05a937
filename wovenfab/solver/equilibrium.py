"""One equilibrium: the forms that are solved, and what is known of the solution.

Newton's method seeks it. Where friction is too sharp for that, its stress is carried at
quadrature points instead, from then on. A solution is judged by the factor of its tangent.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from forms.point_friction import PointFriction
from wovenfab.model.constraints import Constraints
from wovenfab.model.model import Model
from wovenfab.model.point_stress import with_point_friction
from wovenfab.solver.globalisation import CrossingLimit
from wovenfab.solver.linear import LinearSolver, create_direct
from wovenfab.solver.newton import NewtonSolver, PetscOptions, reason_of
from wovenfab.solver.options import SolveResult, SolverOptions
from wovenfab.solver.point_friction import PointStress
from wovenfab.solver.problem import Problem
from wovenfab.solver.tangent_spectrum import TangentSpectrum

#: Iterations after which friction that can be carried is.
PATIENCE = 12


class EquilibriumSolver:
    """Solves for the field that balances the forces; objects are made once.

    Attributes:
        method: How a system is solved; another one may be tried in its place.
        barrier: Where the families would cross.
        factor: Solves Newton's linear systems.
    """

    method: type[NewtonSolver] = NewtonSolver

    def __init__(self, model: Model, constraints: Constraints, controls: SolverOptions) -> None:
        """Create matrix, vectors, factorisation and SNES for a model."""
        self._plain = model
        self._constraints = constraints
        self._controls = controls
        self.barrier = CrossingLimit(model)
        self._options = PetscOptions(controls)
        direct = create_direct(model.comm)
        self._system = Problem(model, constraints, upper=direct.getPC().getType() == "cholesky")
        self.factor = LinearSolver(
            direct, self._system.matrix, controls.keep_from, sqrt(controls.tolerance)
        )
        self._newton = self.method(self._system, constraints, controls, self.factor, self.barrier)
        # The stress of set-valued friction is always carried, that of others when it must be.
        self._always = self._stresses_of(model) if model.carried else None
        self._system.carried = self._always
        self._sharp: tuple[Model, PointStress] | None = None
        self._can_carry = any(t.effect.bound for t in model.balance.terms)

    def solve(self) -> SolveResult:
        """Solve from the model's present field towards the constraints' present values.

        The model's ``last`` field must hold the last equilibrium. On success the
        field holds the new one; otherwise it is undefined and the caller restores it.
        """
        if self._model is not self._plain or not self._can_carry:
            return self._solve(self._controls.max_iterations)
        field, last = self._model.field.x.array, self._model.last.x.array
        start, before = field.copy(), last.copy()
        outcome = self._solve(min(self._controls.max_iterations, PATIENCE))
        if outcome.converged:
            return outcome
        field[:], last[:] = start, before
        self._carry()
        again = self._solve(self._controls.max_iterations)
        if not again.converged:  # it was not the friction
            self._system.model, self._system.carried = self._plain, self._always
        return again

    def keep(self) -> None:
        """Take what friction carries for that of the accepted state."""
        if self._carried:
            self._carried.keep()

    def restore(self) -> None:
        """Go back to what friction carried in the accepted state."""
        if self._carried:
            self._carried.restore()

    @property
    def inertia(self) -> TangentSpectrum:
        """Judges the tangent."""
        return self._newton.inertia

    @property
    def saddle_at_start(self) -> bool:
        """Whether the tangent was indefinite where the last solve began."""
        return self._newton.saddle_at_start

    @property
    def force(self) -> NDArray[np.float64]:
        """Internal force (N) at this rank's unknowns at the last iterate."""
        return self._system.force

    def evaluate_force(self) -> NDArray[np.float64]:
        """Return the internal force (N) of the model's present field at own unknowns."""
        return self._system.evaluate_force()

    @property
    def carried(self) -> tuple[PointFriction, ...]:
        """The frictions whose stress is carried at quadrature points now."""
        return self._model.carried

    def plastic_force(self) -> NDArray[np.float64] | float:
        """Return the part of the force (N) of set-valued friction; 0 without any."""
        if not self._plain.push:
            return 0.0
        return self._system.force_of(self._plain.push)

    def energy(self) -> float:
        """Return the incremental potential (J) of the model's present field; collective."""
        return self._system.energy()

    def tangent(self) -> Any:
        """Return the tangent (N/m) of the model's present state, prescribed rows of one."""
        self._newton.assemble_tangent()
        return self._system.matrix

    def watch(self, tell: Callable[[], None]) -> None:
        """Call ``tell`` on every rank at each iterate, with the model's field set to it."""
        self._newton.watch(tell)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self._options.clear()
        self._newton.destroy()
        self.factor.destroy()
        for stresses in (self._always, self._sharp[1] if self._sharp else None):
            if stresses:
                stresses.destroy()
        self._system.destroy()

    def _solve(self, most: int) -> SolveResult:
        """Solve with the present forms and at most so many iterations."""
        newton = self._newton
        reason = newton.solve(most)
        return SolveResult(
            converged=reason > 0,
            reason=reason_of(newton.snes),
            iterations=newton.snes.getIterationNumber(),
            residual=newton.norm,
            negatives=newton.judge() if reason > 0 else 0,
            tangents=newton.tangents,
        )

    def _carry(self) -> None:
        """Go over to forms that carry the stress of all friction that can be carried."""
        if self._sharp is None:
            model = with_point_friction(self._plain)
            self._sharp = model, self._stresses_of(model)
        self._system.model, self._system.carried = self._sharp

    def _stresses_of(self, model: Model) -> PointStress:
        return PointStress(model, self.barrier.step, self._constraints.bcs)

    @property
    def _model(self) -> Model:
        return self._system.model

    @property
    def _carried(self) -> PointStress | None:
        return self._system.carried
