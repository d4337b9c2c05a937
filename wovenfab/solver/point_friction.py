"""Newton's steps with friction whose stress is a variable at quadrature points.

Each step solves twice with one factor of the tangent (Mehrotra): the predictor aims at the law
itself, the corrector adds the centring and the second-order terms that the predictor gives.
``FrictionPoints`` are the points as plain arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from forms.friction import PointFriction
from wovenfab.model.assembly import compile_expression
from wovenfab.model.model import Model
from wovenfab.model.snapshot import PointValues
from wovenfab.solver.interior_point import Increment, InteriorPoint, Target
from wovenfab.solver.linear import LinearSolver

Array = NDArray[np.float64]


class _PointRule:
    """The points of one friction on this rank's own cells; values by cell, point, component."""

    def __init__(self, friction: PointFriction, direction: fem.Function) -> None:
        space = friction.stress.function_space
        mesh = self._mesh = space.mesh
        own = mesh.topology.index_map(2).size_local
        self.cells = np.arange(own, dtype=np.int32)
        self._dofs = space.dofmap.list[:own]
        self._size = friction.size
        self.friction = friction
        points, weights = basix.make_quadrature(basix.CellType.triangle, friction.degree)
        self._increment = compile_expression(friction.increment(), points)
        self._change = compile_expression(friction.change(direction), points)
        creep = friction.creep()
        self._creep = None if creep is None else compile_expression(creep, points)
        given = ufl.as_vector([abs(ufl.JacobianDeterminant(mesh)), friction.strength()])
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
        values = self._at(self._creep).reshape(-1, 2, self._size)
        return np.swapaxes(values, 0, 1).reshape(2, -1)

    def put(self, function: fem.Function, values: Array) -> None:
        rows = function.x.array.reshape(-1, self._size)
        rows[self._dofs] = values.reshape(*self._dofs.shape, self._size)

    def _at(self, expression: fem.Expression) -> Array:
        values: Array = expression.eval(self._mesh, self.cells)
        return values.ravel()


class FrictionPoints:
    """All points of some frictions on this rank that have a bound above zero, one by one.

    Attributes:
        bound: Largest stress zeta at each, shape (n,), as are all values here.
        area: Area that each stands for, m^2.
        creeps: Whether any law creeps below its bound.
    """

    def __init__(self, frictions: Sequence[PointFriction], space: fem.FunctionSpace) -> None:
        """Evaluate bounds and areas.

        Args:
            frictions: The frictions.
            space: Space of the placements.
        """
        self._direction = fem.Function(space)
        self._rules = [_PointRule(f, self._direction) for f in frictions]
        everywhere = np.concatenate([r.bound for r in self._rules])
        self._acting = everywhere > 0
        self._ends = np.cumsum([r.bound.size for r in self._rules])[:-1]
        self._comm = space.mesh.comm
        self.bound = everywhere[self._acting]
        self.area = np.concatenate([r.area for r in self._rules])[self._acting]
        self.creeps = any(not f.term.effect.set_valued for f in frictions)

    def increments(self) -> Array:
        """Return the increments b of the model's present field."""
        return self._all(_PointRule.increments)

    def changes(self, direction: Array) -> Array:
        """Return the change of b along a direction of own unknowns (m); collective."""
        self._direction.x.array[: len(direction)] = direction
        self._direction.x.scatter_forward()
        return self._all(_PointRule.changes)

    def creep(self) -> tuple[Array, Array]:
        """Return b below the bound and its slope by the stress, at the forms' stresses."""
        both = np.hstack([rule.creep() for rule in self._rules])[:, self._acting]
        return both[0], both[1]

    def put_stress(self, values: Array) -> None:
        """Give the forms these stresses."""
        self._put(values, lambda f: f.stress)

    def put_tangent(self, values: Array) -> None:
        """Give the forms these tangents d tau/d b."""
        self._put(values, lambda f: f.tangent)

    def by_cell(self, values: Array) -> PointValues:
        """Return values by friction and cell."""
        parts = zip(self._rules, self._parts(values), strict=True)
        return PointValues(tuple(part.reshape(len(rule.cells), -1) for rule, part in parts))

    def of_cells(self, values: PointValues) -> Array:
        """Return values that were given by friction and cell."""
        everywhere: Array = np.concatenate([part.ravel() for part in values.parts])
        return everywhere[self._acting]

    def largest(self, values: Array) -> Array:
        """Return for each value the largest absolute one of its friction; collective."""
        mine = [float(np.abs(part).max(initial=0.0)) for part in self._parts(values)]
        most = np.max(self._comm.allgather(mine), axis=0)
        sizes = [rule.bound.size for rule in self._rules]
        repeated: Array = np.repeat(most, sizes)[self._acting]
        return repeated

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
            rule.put(where(rule.friction), part)


#: Largest length of a step over that at which a bound is reached; exponent of the centring.
SHARE, CENTRING = 0.995, 4
#: Largest number of centrality corrections; step length from which none is tried; gain in
#: length that a correction aims at, and the one that it must give.
CORRECTIONS, FAR, GAIN, LEAST_GAIN = 4, 0.95, 0.15, 0.01
#: Stiffness of the friction in the first step, and its largest one later, both over that of
#: the sheet. The solution depends on neither.
FIRST, LARGEST = 1e-3, 1e3
#: Increment that counts as none, over the one at which the first stiffness reaches the bound.
NOTHING = 1e-6
#: Energy by which the law may be missed, in units of the tolerance: over the dissipated energy,
#: or where that is small over the energy of the sheet.
OF_LOSS, OF_ENERGY = 10.0, 0.1
HUGE = 1e30


class PointStress:
    """The friction stresses of a model at quadrature points, through Newton's steps.

    Attributes:
        diagonal: Size of the diagonal of the tangent without friction, N/m.
    """

    def __init__(self, model: Model, bcs: Sequence[fem.DirichletBC]) -> None:
        """Start without stress.

        Args:
            model: A model with point friction.
            bcs: Prescribed placements.
        """
        self._forms, self._bcs, self._comm = model.friction_force, list(bcs), model.comm
        self._acting = model.friction
        self._points = points = FrictionPoints(model.point_frictions, model.space)
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
        self._solution = self._force.duplicate()

    def begin(self, diagonal: Callable[[], float]) -> None:
        """Begin a step at the accepted stresses; collective.

        Args:
            diagonal: Assembles the tangent and returns the size of its diagonal, N/m.
        """
        self._started = self._moved = False
        if self._stiffness is None:
            self._stiffness = self._sheet_stiffness(diagonal)

    def accept(self) -> None:
        """Take the present stresses as those of the accepted state."""
        self._accepted = self._stress

    def restore(self) -> None:
        """Go back to the stresses of the accepted state."""
        self._set_stress(self._accepted)

    def snapshot(self) -> dict[str, Any]:
        """Return the accepted stresses, and the stiffness once it is known."""
        return {
            "accepted": self._points.by_cell(self._accepted),
            "stiffness": None if self._stiffness is None else self._points.by_cell(self._stiffness),
            "diagonal": self.diagonal,
        }

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on with those of a snapshot."""
        self._accepted = self._points.of_cells(snapshot["accepted"])
        if snapshot["stiffness"]:
            self._stiffness = self._points.of_cells(snapshot["stiffness"])
        self.diagonal = snapshot["diagonal"]
        self.restore()

    def prepare_force(self, attained: bool) -> None:
        """Give the forms the stresses of the model's present field; collective.

        Args:
            attained: Whether the field has the prescribed placements.
        """
        if self._idle:
            self._set_stress(np.zeros_like(self._accepted))
            return
        self._increment = self._points.increments()
        if self._started:
            self._set_stress(self._interior.stress)
            return
        assert self._stiffness is not None
        first = FIRST * self._stiffness
        self._points.put_tangent(first)
        self._set_stress(self._accepted + first * self._increment)
        if attained and self._moved:
            self._start()

    def prepare_tangent(self) -> None:
        """Give the forms d tau/d b."""
        assert self._stiffness is not None
        self._tangent = FIRST * self._stiffness * float(not self._idle)
        if self._started:
            self._creep, slope = self._points.creep()
            self._tangent = self._interior.tangent(slope, LARGEST * self._stiffness)
        self._points.put_tangent(self._tangent)

    def add_force(self, b: Any) -> None:
        """Add the force (N) of the stresses to a vector, ghosts not yet summed."""
        if not self._idle:
            for form in self._forms:
                fem_petsc.assemble_vector(b, form)

    def correct(self, linear: LinearSolver, y: Any) -> float:
        """Complete Newton's step; collective.

        Args:
            linear: Solves with the tangent.
            y: Newton's step, to be subtracted, for stresses as they are; overwritten.

        Returns:
            Largest step length that keeps the stresses inside their bounds.
        """
        if not self._started:
            return 1.0
        interior, plain = self._interior, y.copy()
        move = self._solve(linear, plain, interior.aim(self._creep, 0.0))
        now = self._sum(interior.gap())
        then = self._sum(interior.gap(move, min(1.0, self._longest(move))))
        level = (then / now) ** CENTRING * now / (2 * self._area)
        aim, longest, reach = interior.aim(self._creep, level, move), 0.0, -1.0
        for _ in range(1 + CORRECTIONS):
            tried = self._solve(linear, plain, aim)
            length = self._longest(tried)
            if min(1.0, length) < reach + LEAST_GAIN:
                break
            self._solution.copy(y)
            self._move, longest, reach = tried, length, min(1.0, length)
            if reach >= FAR:
                break
            aim = interior.centred(aim, self._creep, level, tried, min(1.0, reach + GAIN))
        plain.destroy()
        # Steps come the closer to the bounds the less is missing, for quick convergence.
        share = 1 - min(1 - SHARE, now / self._sum(interior.loss()))
        return min(1.0, share * longest)

    def advance(self, length: float) -> None:
        """Take a step of some length."""
        if self._started:
            assert self._move is not None
            self._interior.advance(self._move, length)
        self._moved = not self._idle

    def obeys_law(self, tolerance: float, energy: Callable[[], float]) -> bool:
        """Return whether the stresses obey their laws; collective.

        Args:
            tolerance: Energy by which a law may be missed, relative.
            energy: Returns the energy (J) of the sheet, which counts where little is lost.
        """
        if self._idle:
            return True
        if not self._started:  # nothing has moved, and nothing creeps
            active = self._points.creeps or bool(self._increment.any())
            return not self._sum(float(active))
        gap, loss = self._sum(self._interior.gap()), self._sum(self._interior.loss())
        return gap <= OF_LOSS * tolerance * loss or gap <= OF_ENERGY * tolerance * energy()

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self._force.destroy()
        self._solution.destroy()

    @property
    def _idle(self) -> bool:
        """Whether there is no friction: left out for the initial state, or without strength."""
        return float(self._acting.value) == 0 or self._area == 0

    def _start(self) -> None:
        """Start the interior-point method from where the first step has led."""
        points, interior = self._points, self._interior
        assert self._stiffness is not None
        least = NOTHING * points.bound / (FIRST * self._stiffness)
        interior.place(self._stress)
        self._set_stress(interior.stress)
        creep, _ = points.creep()
        slip = np.maximum(points.largest(self._increment), least)
        interior.split(self._increment - creep, slip)
        self._started = True

    def _longest(self, move: Increment) -> float:
        """Return the step length at which the first point reaches a bound; collective."""
        return float(self._comm.allreduce(self._interior.longest(move), op=MPI.MIN))

    def _solve(self, linear: LinearSolver, plain: Any, aim: Target) -> Increment:
        """Solve for the displacements of a target; return the change of the stresses.

        The displacements are left in ``_solution``, to be subtracted.

        Args:
            linear: Solves with the tangent.
            plain: Newton's step for stresses as they are.
            aim: Target of the stresses.
        """
        excess = self._tangent * (self._increment - aim.increment)
        self._points.put_stress(excess)
        with self._force.localForm() as local:
            local.set(0.0)
        self.add_force(self._force)
        self._force.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        fem_petsc.set_bc(self._force, self._bcs, alpha=0.0)
        linear.solve(self._force, self._solution)
        self._solution.axpy(1.0, plain)
        changes = self._points.changes(-self._solution.array_r)
        return self._interior.move(excess + self._tangent * changes, aim)

    def _sheet_stiffness(self, diagonal: Callable[[], float]) -> Array:
        """Return the stiffness (N/m^3) of the sheet at each point, by the tangents' sizes."""
        points = self._points
        none = np.zeros_like(points.bound)
        points.put_stress(none)
        points.put_tangent(none)
        self.diagonal = diagonal()
        stiffness = none
        for mine in points.one_by_one():
            points.put_tangent(HUGE * mine)
            stiffness = stiffness + mine * self.diagonal / (diagonal() / HUGE)
        points.put_tangent(none)
        return stiffness

    def _set_stress(self, stress: Array) -> None:
        self._stress = stress
        self._points.put_stress(stress)

    def _sum(self, value: float) -> float:
        return float(self._comm.allreduce(value, op=MPI.SUM))
