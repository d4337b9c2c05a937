"""One equilibrium by PETSc SNES: Newton with exact tangents on the potential.

SNES calls back for residual and Jacobian; before it takes a step, the step is cut
to stay admissible (no crossing of the families) and then, once the prescribed
placements are attained, backtracked until the incremental potential falls enough.
Where friction is too sharp for that, its stress is carried at quadrature points.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from forms.carried import Carried
from wovenfab.model.carrying import carrying
from wovenfab.model.constraints import Constraints
from wovenfab.model.model import Model
from wovenfab.solver.admissible import SHARE, Barrier
from wovenfab.solver.carried import CarriedStress
from wovenfab.solver.controls import Controls, Outcome
from wovenfab.solver.convergence import Convergence
from wovenfab.solver.factor import Factor, create_direct
from wovenfab.solver.inertia import Inertia, start_vector
from wovenfab.solver.search import backtrack
from wovenfab.solver.snes import Options, create_snes, reason_of
from wovenfab.solver.system import System

Reason = PETSc.SNES.ConvergedReason
#: Searches in a row that find no lower potential, the second with the plain tangent, end a solve.
STUCK = 2
#: Iterations after which friction that can be carried is.
PATIENCE = 12


class Equilibrium:
    """Solves for the field that balances the forces; objects are made once.

    Attributes:
        factor: Solves Newton's linear systems.
        inertia: Judges the tangent.
        saddle_at_start: Whether the tangent was indefinite where the last solve began.
    """

    def __init__(self, model: Model, constraints: Constraints, controls: Controls) -> None:
        """Create matrix, vectors, factorisation and SNES for a model."""
        self._plain = model
        self._constraints = constraints
        self._controls = controls
        self.barrier = Barrier(model)
        self._options = Options(controls)
        direct = create_direct(model.comm)
        self._system = System(model, constraints, upper=direct.getPC().getType() == "cholesky")
        self._solution = self._system.residual.duplicate()
        self.factor = Factor(direct, self._system.matrix, controls.keep_from)
        self._snes = self._create_snes()
        self._assembled = np.zeros(self._solution.getLocalSize())  # where the tangent was formed
        self.saddle_at_start = False
        self._convergence = Convergence(controls.tolerance, _largest_cell(model))
        self._norm = 0.0
        self._potential: float | None = None
        self._decrement = np.inf
        self._stuck = 0
        self._most = controls.max_iterations
        # The stress of set-valued friction is always carried, that of others when it must be.
        self._always = self._stresses_of(model) if model.carried else None
        self._system.carried = self._always
        self._sharp: tuple[Model, CarriedStress] | None = None
        self._can_carry = any(t.effect.bound for t in model.balance.terms)
        self.inertia = Inertia(
            self.factor,
            self._system.matrix,
            self._assemble_tangent,
            start_vector(model.placements, constraints.bcs, controls.seed),
        )

    def _create_snes(self) -> Any:
        snes = create_snes(self._plain.comm, self._controls, self.factor)
        snes.setFunction(self._evaluate_residual, self._system.residual)
        snes.setJacobian(self._evaluate_jacobian, self._system.matrix)
        snes.setObjective(self._evaluate_objective)
        snes.setLineSearchPreCheck(self._limit_step)
        snes.setConvergenceTest(self._test)
        return snes

    def solve(self) -> Outcome:
        """Solve from the model's present field towards the constraints' present values.

        The model's ``last`` field must hold the last equilibrium. On success the
        field holds the new one; otherwise it is undefined and the caller restores it.
        """
        if self._model is not self._plain or not self._can_carry:
            self._most = self._controls.max_iterations
            return self._solve()
        self._most = min(self._controls.max_iterations, PATIENCE)
        field, last = self._model.field.x.array, self._model.last.x.array
        start, before = field.copy(), last.copy()
        outcome = self._solve()
        if outcome.converged:
            return outcome
        field[:], last[:] = start, before
        self._carry()
        again = self._solve()
        if not again.converged:  # it was not the friction
            self._system.model, self._system.carried = self._plain, self._always
        return again

    def _carry(self) -> None:
        """Go over to forms that carry the stress of all friction that can be carried."""
        if self._sharp is None:
            model = carrying(self._plain)
            self._sharp = model, self._stresses_of(model)
        self._system.model, self._system.carried = self._sharp
        self._most = self._controls.max_iterations

    def _stresses_of(self, model: Model) -> CarriedStress:
        return CarriedStress(model, self.barrier.step, self._constraints.bcs)

    def _solve(self) -> Outcome:
        """Solve with the present forms."""
        field = self._model.field
        before = self._model.last.x.array[: self._solution.getLocalSize()].copy()
        self._solution.array_w[:] = field.x.array[: self._solution.getLocalSize()]
        self._potential, self._decrement = None, np.inf
        self._stuck, self._norm = 0, np.nan
        self._system.begin()
        self.inertia.restart()
        # Descents meet tangents that are not, and carried stress changes them too much.
        self.factor.definite = not (self._controls.descend or self._carried)
        if self.factor.status < 0:
            self.factor.forget()
        if self._carried:
            self._carried.begin(self._system.size_of_tangent)
        self._snes.solve(None, self._solution)
        self._system.load(self._solution)
        reason, iterations = self._snes.getConvergedReason(), self._snes.getIterationNumber()
        negatives = 0
        if reason > 0:
            negatives = self.inertia.judge(self._unseen(before) if iterations else np.inf)
            self._convergence.accept(self._system.force_norm, self._potential or 0.0)
        return Outcome(
            converged=reason > 0,
            reason=reason_of(self._snes),
            iterations=iterations,
            residual=self._norm,
            negatives=negatives,
        )

    def keep(self) -> None:
        """Take what friction carries for that of the accepted state."""
        if self._carried:
            self._carried.keep()

    def restore(self) -> None:
        """Go back to what friction carried in the accepted state."""
        if self._carried:
            self._carried.restore()

    def _unseen(self, before: NDArray[np.float64]) -> float:
        """Return how far from here the tangent was formed, over the way from the last solution."""
        now = self._solution.array_r
        ways = [float(np.abs(now - x).max(initial=0.0)) for x in (self._assembled, before)]
        step, whole = np.max(self._model.comm.allgather(ways), axis=0)
        return step / whole if whole > 0 else np.inf

    @property
    def force(self) -> NDArray[np.float64]:
        """Internal force (N) at this rank's unknowns at the last iterate."""
        return self._system.force

    def evaluate_force(self) -> NDArray[np.float64]:
        """Return the internal force (N) of the model's present field at own unknowns."""
        return self._system.evaluate_force()

    @property
    def _model(self) -> Model:
        return self._system.model

    @property
    def _carried(self) -> CarriedStress | None:
        return self._system.carried

    @property
    def carried(self) -> tuple[Carried, ...]:
        """The frictions whose stress is carried at quadrature points now."""
        return self._model.carried

    def plastic_force(self) -> NDArray[np.float64] | float:
        """Return the part of the force (N) of set-valued friction; 0 without any."""
        if not self._plain.push:
            return 0.0
        return self._system.force_of(self._plain.push)

    def tangent(self) -> Any:
        """Return the tangent (N/m) of the model's present state, prescribed rows of one."""
        self._assemble_tangent()
        return self._system.matrix

    def watch(self, tell: Callable[[], None]) -> None:
        """Call ``tell`` on every rank at each iterate, with the model's field set to it."""

        def look(snes: Any, *_: Any) -> None:
            self._system.load(snes.getSolution())
            tell()

        self._snes.setMonitor(look)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self._options.clear()
        self.inertia.destroy()
        self.factor.destroy()
        for stresses in (self._always, self._sharp[1] if self._sharp else None):
            if stresses:
                stresses.destroy()
        for item in (self._snes, self._solution, self._system):
            item.destroy()

    def _evaluate_residual(self, snes: Any, x: Any, b: Any) -> None:
        self._system.load(x)
        self._system.evaluate_residual(b)

    def _evaluate_jacobian(self, snes: Any, x: Any, matrix: Any, preconditioner: Any) -> None:
        self._system.load(x)
        self._assembled[:] = x.array_r
        size = self._system.evaluate_tangent()
        self._convergence.measure(size, x.norm(PETSc.NormType.INFINITY))

    def _assemble_tangent(self) -> None:
        """Put the tangent of the model's present field in the matrix, the plain one."""
        self._model.last.x.array[:] = self._model.field.x.array
        self._solution.array_w[:] = self._model.field.x.array[: self._solution.getLocalSize()]
        self._evaluate_jacobian(self._snes, self._solution, None, None)

    def _evaluate_objective(self, snes: Any, x: Any) -> float:
        self._system.load(x)
        return self.energy()

    def energy(self) -> float:
        """Return the incremental potential (J) of the model's present field; collective."""
        return self._system.energy()

    def _limit_step(self, x: Any, y: Any) -> bool:
        """Shorten the step so that x - y is admissible and lowers the potential."""
        self._system.load(x)
        model, barrier = self._model, self.barrier
        if not self._snes.getIterationNumber():
            self.saddle_at_start = self.inertia.saddle
        if self._system.attained and self._controls.descend:
            self.inertia.descend(self._snes.getFunction()[0], y)
        model.last.x.array[:] = model.field.x.array
        inside = self._carried.correct(self.factor, y) if self._carried else 1.0
        barrier.step.x.array[: y.getLocalSize()] = -y.array_r
        barrier.step.x.scatter_forward()
        limit = SHARE * barrier.limit() if self._controls.step_limit else 1.0
        length = min(inside, limit)
        if self._carried:
            self._carried.go(length)
        elif self._system.attained and self._controls.line_search:
            length = self._backtrack(y, length)
        else:
            self._potential, self._decrement = None, np.inf
        if length < 1.0:
            y.scale(length)
            return True
        return False

    def _backtrack(self, y: Any, length: float) -> float:
        """Return a step length with sufficient decrease of the incremental potential."""
        field, step, last = self._model.field, self.barrier.step, self._model.last
        start = self.energy() if self._potential is None else self._potential
        slope = float(self._snes.getFunction()[0].dot(y))  # decrease per unit length
        noise = self._convergence.noise(start)

        def potential(at: float) -> float:
            field.x.array[:] = last.x.array + at * step.x.array
            return self.energy()

        length, self._potential = backtrack(potential, start, slope, length, noise)
        self._stuck = self._stuck + 1 if self._potential is None else 0
        self._decrement = abs(slope) if length == 1.0 else np.inf
        return length

    def _test(self, snes: Any, iteration: int, norms: tuple[float, float, float]) -> int:
        """End where forces balance or nothing is gained any more."""
        residual = self._norm = norms[2]
        if not np.isfinite([residual, self._system.force_norm]).all():
            return int(Reason.DIVERGED_FNORM_NAN)
        if self._system.attained and self._is_lawful():
            reason = self._convergence.reason(
                residual, self._system.force_norm, self._decrement, self._potential or 0.0
            )
            if reason is not None:
                return reason
        if self._stuck >= STUCK:
            return int(Reason.DIVERGED_LINE_SEARCH)
        if iteration >= self._most:
            return int(Reason.DIVERGED_MAX_IT)
        return int(Reason.CONVERGED_ITERATING)

    def _is_lawful(self) -> bool:
        """Return whether the carried stresses meet their laws."""
        if self._carried is None:
            return True
        return self._carried.settled(self._controls.tolerance, self._scale_of_energy)

    def _scale_of_energy(self) -> float:
        """Return the largest energy (J) of an equilibrium so far, and of this state."""
        self._potential = self.energy()
        return self._convergence.scale_of(self._potential)


def _largest_cell(model: Model) -> float:
    """Return the size of the largest cell, m; collective."""
    mesh = model.sheet.mesh
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    return float(model.comm.allreduce(mesh.h(2, cells).max(initial=0.0), op=MPI.MAX))
