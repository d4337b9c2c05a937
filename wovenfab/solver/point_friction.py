"""The quadrature points at which stresses are carried, as plain arrays.

Newton's steps with friction whose stress is carried at quadrature points.

Each step solves twice with one factor of the tangent: where the stresses would go if the
law were to be met at once, and there again with the centring and the second-order terms
that this teaches (Mehrotra's predictor and corrector).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from forms.point_friction import PointFriction
from wovenfab.model.compiler import compile_expression
from wovenfab.model.model import Model
from wovenfab.solver.interior_point import Increment, InteriorPoint, Target
from wovenfab.solver.linear import LinearSolver

Array = NDArray[np.float64]


class _PointRule:
    """The points of one friction on this rank's own cells; values by cell, point, component."""

    def __init__(self, carried: PointFriction, step: fem.Function) -> None:
        space = carried.stress.function_space
        mesh = self._mesh = space.mesh
        own = mesh.topology.index_map(2).size_local
        self._cells = np.arange(own, dtype=np.int32)
        self._dofs = space.dofmap.list[:own]
        self._size = carried.size
        self.carried = carried
        points, weights = basix.make_quadrature(basix.CellType.triangle, carried.degree)
        self._increment = compile_expression(carried.increment(), points)
        self._change = compile_expression(carried.change(step), points)
        creep = carried.creep()
        self._creep = None if creep is None else compile_expression(creep, points)
        given = ufl.as_vector([abs(ufl.JacobianDeterminant(mesh)), carried.strength()])
        area, bound = self._at(compile_expression(given, points)).reshape(-1, 2).T
        self.area = np.repeat(area * np.tile(weights, own), self._size)
        self.bound = np.repeat(bound, self._size)

    def increments(self) -> Array:
        return self._at(self._increment)

    def changes(self) -> Array:
        return self._at(self._change)

    def creep(self) -> Array:
        """Return the creep and its slope, shape (2, n)."""
        if self._creep is None:
            return np.zeros((2, self.bound.size))
        found = self._at(self._creep).reshape(-1, 2, self._size)
        return np.swapaxes(found, 0, 1).reshape(2, -1)

    def put(self, function: fem.Function, values: Array) -> None:
        rows = function.x.array.reshape(-1, self._size)
        rows[self._dofs] = values.reshape(*self._dofs.shape, self._size)

    def _at(self, expression: fem.Expression) -> Array:
        found: Array = expression.eval(self._mesh, self._cells)
        return found.ravel()


class FrictionPoints:
    """All points of some frictions on this rank that have a bound above zero, one by one.

    Attributes:
        bound: Largest stress zeta at each, shape (n,), as are all values here.
        area: Area that each stands for, m^2.
        creeps: Whether any law creeps below its bound.
    """

    def __init__(self, carried: Sequence[PointFriction], step: fem.Function) -> None:
        """Find them.

        Args:
            carried: The frictions.
            step: Displacement field along which changes are taken.
        """
        self._rules = [_PointRule(c, step) for c in carried]
        everywhere = np.concatenate([r.bound for r in self._rules])
        self._acting = everywhere > 0
        self._ends = np.cumsum([r.bound.size for r in self._rules])[:-1]
        self._comm = step.function_space.mesh.comm
        self.bound = everywhere[self._acting]
        self.area = np.concatenate([r.area for r in self._rules])[self._acting]
        self.creeps = any(not c.term.effect.set_valued for c in carried)

    def increments(self) -> Array:
        """Return the increments b of the model's present field."""
        return self._all(_PointRule.increments)

    def changes(self) -> Array:
        """Return how b varies along the step."""
        return self._all(_PointRule.changes)

    def creep(self) -> tuple[Array, Array]:
        """Return b below the bound and its slope by the stress, at the stresses put."""
        both = np.hstack([rule.creep() for rule in self._rules])[:, self._acting]
        return both[0], both[1]

    def put_stress(self, values: Array) -> None:
        """Let the forms have these stresses."""
        self._put(values, lambda c: c.stress)

    def put_tangent(self, values: Array) -> None:
        """Let the forms have these tangents d tau/d b."""
        self._put(values, lambda c: c.tangent)

    def largest(self, values: Array) -> Array:
        """Return for each value the largest size of those of its friction; collective."""
        mine = [float(np.abs(part).max(initial=0.0)) for part in self._parts(values)]
        most = np.max(self._comm.allgather(mine), axis=0)
        sizes = [rule.bound.size for rule in self._rules]
        found: Array = np.repeat(most, sizes)[self._acting]
        return found

    def one_by_one(self) -> list[Array]:
        """Return for each friction an array that is one at its points, zero at the others."""
        parts = self._parts(np.ones_like(self.bound))
        return [
            np.concatenate([p * float(i == k) for k, p in enumerate(parts)])[self._acting]
            for i in range(len(parts))
        ]

    def _all(self, of: Callable[[_PointRule], Array]) -> Array:
        return np.concatenate([of(rule) for rule in self._rules])[self._acting]

    def _parts(self, values: Array) -> list[Array]:
        everywhere = np.zeros(self._acting.size)
        everywhere[self._acting] = values
        return np.split(everywhere, self._ends)

    def _put(self, values: Array, where: Callable[[PointFriction], Any]) -> None:
        for rule, part in zip(self._rules, self._parts(values), strict=True):
            rule.put(where(rule.carried), part)


#: Share of the way to the bounds that a step may take, and exponent of the centring.
SHARE, CENTRING = 0.995, 4
#: Most corrections that bring stray points back, step length with which none is tried,
#: and how much longer a step is hoped to become and must become by one.
CORRECTIONS, FAR, GAIN, LEAST_GAIN = 4, 0.95, 0.15, 0.01
#: Stiffness of the friction in the step that finds where to start, and its largest one
#: later, both over that of the sheet. The solution depends on neither.
FIRST, LARGEST = 1e-3, 1e3
#: Increment that is nothing, over the one at which the first stiffness reaches the bound.
NOTHING = 1e-6
#: Energy by which the law may be missed, in units of the tolerance: over the energy that
#: is dissipated, or where that is little over the energy of the sheet.
OF_LOSS, OF_ENERGY = 10.0, 0.1
HUGE = 1e30


class PointStress:
    """The carried stresses of a model through Newton's steps.

    Attributes:
        diagonal: Size of the diagonal of the tangent without friction, N/m.
    """

    def __init__(self, model: Model, step: fem.Function, bcs: Sequence[fem.DirichletBC]) -> None:
        """Find the points.

        Args:
            model: A model that carries stresses.
            step: Displacement field along which changes are taken.
            bcs: Prescribed placements.
        """
        self._push, self._bcs, self._comm = model.push, list(bcs), model.comm
        self._factor = model.friction
        self._step = step
        self._points = points = FrictionPoints(model.carried, step)
        self._interior = InteriorPoint(points.bound, points.area)
        self._area = self._sum(float(points.area.sum()))
        self._stress = np.zeros_like(points.bound)  # the present one
        self._accepted = self._stress
        self._stiffness: Array | None = None  # of the sheet, as seen by each point, N/m^3
        self.diagonal = 0.0
        self._started = self._moved = False
        self._increment = self._tangent = self._creep = self._stress
        self._move: Increment | None = None
        self._force = model.field.x.petsc_vec.duplicate()
        self._answer = self._force.duplicate()

    def begin(self, diagonal: Callable[[], float]) -> None:
        """Begin a step at the accepted stresses; collective.

        Args:
            diagonal: Assembles the tangent and returns the size of its diagonal, N/m.
        """
        self._started = self._moved = False
        if self._stiffness is None:
            self._stiffness = self._sheet_stiffness(diagonal)

    def keep(self) -> None:
        """Take the present stresses for those of the accepted state."""
        self._accepted = self._stress

    def restore(self) -> None:
        """Go back to the stresses of the accepted state."""
        self._show(self._accepted)

    def prepare_force(self, attained: bool) -> None:
        """Write the stresses that belong to the model's present field; collective.

        Args:
            attained: Whether the grips are in place.
        """
        if self._idle:
            self._show(np.zeros_like(self._accepted))
            return
        self._increment = self._points.increments()
        if self._started:
            self._show(self._interior.stress)
            return
        assert self._stiffness is not None
        first = FIRST * self._stiffness
        self._points.put_tangent(first)
        self._show(self._accepted + first * self._increment)
        if attained and self._moved:
            self._start()

    def prepare_tangent(self) -> None:
        """Write d tau/d b there."""
        assert self._stiffness is not None
        self._tangent = FIRST * self._stiffness * float(not self._idle)
        if self._started:
            self._creep, slope = self._points.creep()
            self._tangent = self._interior.tangent(slope, LARGEST * self._stiffness)
        self._points.put_tangent(self._tangent)

    def add_force(self, b: Any) -> None:
        """Add the force (N) of the stresses to a vector, ghosts not yet summed."""
        if not self._idle:
            for form in self._push:
                fem_petsc.assemble_vector(b, form)

    def correct(self, factor: LinearSolver, y: Any) -> float:
        """Complete Newton's step; collective.

        Args:
            factor: That of the tangent.
            y: Newton's step, to be subtracted, for stresses as they are; overwritten.

        Returns:
            Largest step length that keeps the stresses inside their bounds.
        """
        if not self._started:
            return 1.0
        interior, plain = self._interior, y.copy()
        move = self._solve(factor, plain, interior.aim(self._creep, 0.0))
        now = self._sum(interior.gap())
        then = self._sum(interior.gap(move, min(1.0, self._farthest(move))))
        level = (then / now) ** CENTRING * now / (2 * self._area)
        aim, farthest, reach = interior.aim(self._creep, level, move), 0.0, -1.0
        for _ in range(1 + CORRECTIONS):
            tried = self._solve(factor, plain, aim)
            farther = self._farthest(tried)
            if min(1.0, farther) < reach + LEAST_GAIN:
                break
            self._answer.copy(y)
            self._move, farthest, reach = tried, farther, min(1.0, farther)
            if reach >= FAR:
                break
            aim = interior.centred(aim, self._creep, level, tried, min(1.0, reach + GAIN))
        plain.destroy()
        # Steps come the closer to the bounds the less is missing, for quick convergence.
        share = 1 - min(1 - SHARE, now / self._sum(interior.loss()))
        return min(1.0, share * farthest)

    def go(self, length: float) -> None:
        """Take a step of some length."""
        if self._started:
            assert self._move is not None
            self._interior.go(self._move, length)
        self._moved = not self._idle

    def settled(self, tolerance: float, energy: Callable[[], float]) -> bool:
        """Return whether the law is met; collective.

        Args:
            tolerance: Energy by which it may be missed, relative.
            energy: Returns the energy (J) of the sheet, which counts where little is lost.
        """
        if self._idle:
            return True
        if not self._started:  # nothing has moved, and nothing creeps
            busy = self._points.creeps or bool(self._increment.any())
            return not self._sum(float(busy))
        gap, loss = self._sum(self._interior.gap()), self._sum(self._interior.loss())
        return gap <= OF_LOSS * tolerance * loss or gap <= OF_ENERGY * tolerance * energy()

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self._force.destroy()
        self._answer.destroy()

    @property
    def _idle(self) -> bool:
        """Whether there is no friction: left out to come to rest, or without strength."""
        return float(self._factor.value) == 0 or self._area == 0

    def _start(self) -> None:
        """Start the interior-point method from where the first step has led."""
        points, interior = self._points, self._interior
        assert self._stiffness is not None
        least = NOTHING * points.bound / (FIRST * self._stiffness)
        interior.place(self._stress)
        self._show(interior.stress)
        creep, _ = points.creep()
        slip = np.maximum(points.largest(self._increment), least)
        interior.split(self._increment - creep, slip)
        self._started = True

    def _farthest(self, move: Increment) -> float:
        """Return the step length at which the first point reaches a bound; collective."""
        return float(self._comm.allreduce(self._interior.farthest(move), op=MPI.MIN))

    def _solve(self, factor: LinearSolver, plain: Any, aim: Target) -> Increment:
        """Solve for the displacements that an aim leads to; return how the stresses follow.

        The displacements are left in ``_answer``, to be subtracted.

        Args:
            factor: That of the tangent.
            plain: Newton's step for stresses as they are.
            aim: What the stresses aim at.
        """
        excess = self._tangent * (self._increment - aim.increment)
        self._points.put_stress(excess)
        with self._force.localForm() as local:
            local.set(0.0)
        self.add_force(self._force)
        self._force.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        fem_petsc.set_bc(self._force, self._bcs, alpha=0.0)
        factor.solve(self._force, self._answer)
        self._answer.axpy(1.0, plain)
        self._step.x.array[: plain.getLocalSize()] = -self._answer.array_r
        self._step.x.scatter_forward()
        return self._interior.move(excess + self._tangent * self._points.changes(), aim)

    def _sheet_stiffness(self, diagonal: Callable[[], float]) -> Array:
        """Return the stiffness of the sheet as each point sees it, by the tangents' sizes."""
        points = self._points
        none = np.zeros_like(points.bound)
        points.put_stress(none)
        points.put_tangent(none)
        self.diagonal = diagonal()
        found = none
        for mine in points.one_by_one():
            points.put_tangent(HUGE * mine)
            found = found + mine * self.diagonal / (diagonal() / HUGE)
        return found

    def _show(self, stress: Array) -> None:
        self._stress = stress
        self._points.put_stress(stress)

    def _sum(self, value: float) -> float:
        return float(self._comm.allreduce(value, op=MPI.SUM))
