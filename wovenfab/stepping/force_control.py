"""Force control: the displacement of the program for which its conjugate force is a given one.

Where a step has its equilibrium, the conjugate force F is a function of the displacement u alone,
which equilibrium for prescribed placements gives. F(u) is solved for u by Newton's method inside a
bracket. The first slope is that of the tangent K at an equilibrium: with the change w of the
prescribed placements with u and the free part of K, dF/du = (w - y).K w with K_free y = K w, the
Schur complement; where w changes with u this is the greatest part of it. Later slopes are secants.
Each equilibrium begins from the last one, moved along its change with u. F is the work of the
internal force on w - y rather than on w, so that what is left of the residual counts to second
order only.

Where a force is prescribed, an equilibrium is stable if it is so at fixed u and dF/du is positive
(Haynsworth's inertia theorem). A slope that is not positive lies beyond a limit point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.problem import SolveResult
from wovenfab.solver.tangent_spectrum import bounding_box

if TYPE_CHECKING:
    from wovenfab.stepping.state import State

Array = NDArray[np.float64]
#: Change of the force over the largest one up to which rounding may decide: an error that stays is
#: good enough, and no secant is drawn.
ROUNDED = 1e-7
#: Equilibria for one step at most.
MOST = 20
#: Largest change of the displacement at once, over the size of the sheet.
FARTHEST = 0.1


@dataclass(frozen=True)
class _Point:
    """A stable equilibrium on the way.

    Attributes:
        displacement: Of the program, m.
        lack: Force that is missing, N.
        field: This rank's own unknowns, m.
        slope: dF/du, N/m.
        change: Of the field with the displacement.
    """

    displacement: float
    lack: float
    field: Array
    slope: float
    change: Array


@dataclass(frozen=True)
class Unstable:
    """An equilibrium of which the force falls with the displacement.

    Attributes:
        displacement: Of the program, m.
        field: Unknowns with ghosts, m.
        mode: Their change with the displacement; its largest component is 1 m.
    """

    displacement: float
    field: Array
    mode: Array


class ForceControl:
    """Finds the displacement of a step from the force at its end.

    Attributes:
        beyond: Equilibrium beyond a limit point that the last step met, or None.
    """

    def __init__(self, solver: EquilibriumSolver, refuses: Callable[[SolveResult], bool]) -> None:
        """Find the size of the sheet; collective.

        Args:
            solver: Solver of the problem.
            refuses: Whether an equilibrium must not be accepted, since it is no minimum.
        """
        self._solver, self._problem = solver, solver.problem
        self._refuses = refuses
        low, high = bounding_box(self._problem.model.placements)
        self._farthest = FARTHEST * float(np.max(high - low))
        self._y: Array = np.zeros(self._problem.model.placements.owned)
        self.beyond: Unstable | None = None

    def solve(self, state: State, target: float, scale: float) -> SolveResult:
        """Solve for the stage state of a step with a force; collective.

        Args:
            state: At the start of the step; the model's field and ``reached`` are a guess.
            target: Force, N.
            scale: The largest force, N.
        """
        field, own = self._problem.model.field.x, self._problem.model.placements.owned
        allowed = self._solver.newton.options.tolerance * scale
        low, high = -np.inf, np.inf  # displacements between which the force is attained
        last: _Point | None = None
        iterations, u, self.beyond = 0, state.reached, None
        self._y[:] = 0.0
        for _ in range(MOST):
            result = state.solve_for(u)
            iterations += result.iterations
            result = replace(result, iterations=iterations)
            point = None
            if result.converged and not self._refuses(result):
                lack = target - self._reached(u)
                size = abs(lack)
                if size <= allowed:
                    return result
                if last and size <= ROUNDED * scale and size > abs(last.lack) / 2:
                    return result
                point = self._point(u, lack, last, ROUNDED * scale)
                if point and not last:
                    point = replace(point, lack=target - self._reached(u))
            if not point:
                return replace(result, converged=result.converged and not self.beyond)
            low, high = (u, high) if lack > 0 else (low, u)
            following = u + max(-self._farthest, min(lack / point.slope, self._farthest))
            if not low < following < high:
                following = (low + high) / 2
            field.array[:own] = point.field + (following - u) * point.change
            field.scatter_forward()
            last, u = point, following
        return replace(result, converged=False, reason="DIVERGED_FORCE")

    def _point(self, u: float, lack: float, last: _Point | None, least: float) -> _Point | None:
        """Return the present equilibrium, or None if its force falls with the displacement."""
        field = self._problem.model.field.x.array[: self._problem.model.placements.owned].copy()
        if last is not None and abs(last.lack - lack) <= least:
            return replace(last, displacement=u, lack=lack, field=field)
        if last is not None:
            way = u - last.displacement
            slope, change = (last.lack - lack) / way, (field - last.field) / way
            if slope > 0:
                return _Point(u, lack, field, slope, change)
        slope, change = self._linearise(u)
        if slope > 0:
            return _Point(u, lack, field, slope, change)
        self.beyond = self._unstable(u, change)
        return None

    def _linearise(self, u: float) -> tuple[float, Array]:
        """Return dF/du (N/m) and the change of own unknowns with u at the present state."""
        problem, solver = self._problem, self._solver
        model, friction = problem.model, problem.friction
        rate = problem.constraints.rate(u)
        if friction:
            with friction.off_bounds():
                friction.linearise()
            model.last.x.array[:] = model.field.x.array
            problem.size_of_tangent(solver.matrix)
            solver.linear.definite = False
        else:
            solver.tangent()
        stiffness = problem.stiffness_along(rate)
        moved, own = stiffness - model.loading.rate(), len(stiffness)
        self._y = self._solve(stiffness)
        slope = float((rate[:own] - self._y) @ moved)
        return float(model.comm.allreduce(slope)), rate[:own] - self._solve(moved)

    def _solve(self, force: Array) -> Array:
        """Return the displacements (m) of free unknowns by forces (N) and the present tangent."""
        problem, solver = self._problem, self._solver
        b, x = problem.residual, solver.newton.solution
        b.array_w[:] = force
        fem_petsc.set_bc(b, problem.constraints.bcs, alpha=0.0)
        solver.linear.solve(b, x)
        return np.array(x.array_r)

    def _reached(self, u: float) -> float:
        """Return the conjugate force (N) in the equilibrium just found; collective."""
        force, rate = self._problem.force, self._problem.constraints.rate(u)
        mine = float((rate[: len(force)] - self._y) @ force)
        return float(self._problem.model.comm.allreduce(mine))

    def _unstable(self, u: float, change: Array) -> Unstable:
        """Return the present state as one beyond a limit point; collective."""
        field = self._problem.model.field
        comm = self._problem.model.comm
        largest = comm.allreduce(float(np.abs(change).max(initial=0.0)), op=MPI.MAX)
        mode = field.copy()
        mode.x.array[: len(change)] = change / largest
        mode.x.scatter_forward()
        return Unstable(u, field.x.array.copy(), mode.x.array.copy())
