"""Newton's steps with friction whose stress is a variable at quadrature points.

Each step solves twice with one factor of the tangent (Mehrotra): the predictor aims at the law
itself, the corrector adds the centring and the second-order terms that the predictor gives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from wovenfab.forms.effect import Target, along_fields, by_parameter
from wovenfab.forms.friction import PointFriction
from wovenfab.model.model import Model
from wovenfab.solver.interior_point import HUGE, Aim, FrictionPoints, Increment, InteriorPoint
from wovenfab.solver.linear import LinearSolver

Array = NDArray[np.float64]
#: Largest length of a step over that at which a bound is reached; exponent of the centring.
SHARE, CENTRING = 0.995, 4
#: Largest number of centrality corrections; step length from which none is tried; gain in length
#: that a correction aims at, and the one that it must give.
CORRECTIONS, FAR, GAIN, LEAST_GAIN = 4, 0.95, 0.15, 0.01
#: Stiffness of friction over that of the sheet, as stiff as its yarns in tension, maybe a million
#: times softer in shear: in the first iteration at most, before any step and, later, largest; and
#: at most over the secant: the bound over the largest increment of the last step.
FIRST, UNKNOWN, LARGEST, SECANT = 1e-3, 1e-5, 1e3, 3.0
#: Least p and q at the start over a large increment: in general and, where the last step goes on,
#: at least, and over the share of energy by which the laws are missed.
START_SLIP, NEAREST, PER_MISS = 0.1, 0.003, 0.2
#: That share from which it does not go on, and from which the first iteration led nowhere.
MISLED, LOST = 0.5, 10.0
#: Increment that counts as none, over the one at which the first stiffness reaches the bound.
NOTHING = 1e-6
#: Energy by which the law may be missed over the tolerance and what is lost, or the sheet has.
OF_LOSS, OF_ENERGY = 100.0, 0.1
#: Least bound that varies, over the stress by which the sheet resists a displacement as large as a
#: cell: friction of no bound at all has no interior, and one that is left out cannot come back.
LEAST_BOUND = 1e-12
#: Where the law is linearised: stiffness of a point that sticks, over that of the sheet, and least
#: distance of a stress from its bound, over the bound.
STUCK, INSIDE = 1e7, 1e-12
#: Values at points that later steps depend on.
MEMORY = ("_accepted", "_stiffness", "_secant", "_last")


class PointStress:
    """The friction stresses of a model at quadrature points, through Newton's steps.

    Attributes:
        points: Where they are.
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
        self.points = points = FrictionPoints(model.point_frictions, model.space)
        self._interior = InteriorPoint(points.bound, points.area)
        self._area = self._sum(float(points.area.sum()))
        self.forget()
        self._started = self._moved = False
        self._increment = self._tangent = self._creep = self._least = self._stress
        self._move: Increment | None = None
        self._force, self._solution = (model.field.x.petsc_vec.duplicate() for _ in range(2))

    def forget(self) -> None:
        """Forget earlier steps."""
        none = np.zeros_like(self.points.bound)
        self._accepted = self._stress = none  # the present stress
        self._stiffness = none  # of the sheet, as seen by each point, N/m^3
        self._secant = none  # most that the last step suggests for the first iteration, N/m^3
        self._last: Array | None = None  # d tau/d b at its end, N/m^3
        self._goes_on = False  # whether the present step goes on as the last one
        self.diagonal = 0.0

    def begin(self, diagonal: Callable[[], float]) -> None:
        """Begin a step at the accepted stresses; collective.

        Args:
            diagonal: Assembles the tangent and returns the size of its diagonal, N/m.
        """
        self._started = self._moved = False
        points = self.points
        if not self.diagonal:
            self.diagonal, self._stiffness = points.stiffness(diagonal)
            self._secant = UNKNOWN * self._stiffness
        if points.renew(LEAST_BOUND * np.sqrt(self.diagonal * self._stiffness)):
            self._accepted = np.clip(self._accepted, -points.bound, points.bound)
        self._least = NOTHING * points.bound / (FIRST * self._stiffness)
        self._increment = points.increments()
        self._set_stress(self._accepted)
        extrapolated = self._last is not None and self._sum(float(self._increment.any())) > 0
        self._goes_on = extrapolated and self._share_missed()[0] < MISLED

    def accept(self) -> None:
        """Take the present stresses as those of the accepted state; collective."""
        self._accepted = self._stress
        largest = self.points.largest(self._increment)
        if self._sum(float(largest.any())) and not self._idle:  # a rank may have no such point
            self._secant = SECANT * self.points.bound / np.maximum(largest, 1 / HUGE)
        self._last = self._present_tangent() if self._started else None

    def restore(self) -> None:
        """Go back to the stresses of the accepted state."""
        self._last = None
        self._set_stress(self._accepted)

    def snapshot(self) -> dict[str, Any]:
        """Return the accepted stresses, and stiffnesses once they are known."""
        known = ((name, v) for name in MEMORY if (v := getattr(self, name)) is not None)
        values = {name: self.points.by_cell(v) for name, v in known}
        return values | {"diagonal": self.diagonal}

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on with those of a snapshot."""
        for name in filter(snapshot.get, MEMORY):
            setattr(self, name, self.points.of_cells(snapshot[name]))
        self.diagonal = snapshot["diagonal"]
        self._set_stress(self._accepted)

    def prepare_force(self, attained: bool) -> None:
        """Give the forms the stresses of the model's present field; collective.

        Args:
            attained: Whether the field has the prescribed placements.
        """
        if self._idle:
            self._set_stress(np.zeros_like(self._accepted))
            return
        self._increment = self.points.increments()
        if self._started:
            self._set_stress(self._interior.stress)
            return
        self._extrapolate()
        if attained and self._moved and not self._start():
            self._goes_on = self._moved = False  # the first step once more, as if all slid
            self._extrapolate()

    def prepare_tangent(self) -> None:
        """Give the forms d tau/d b."""
        tangent = self._present_tangent() if self._started else self._first()
        self._tangent = tangent * float(not self._idle)
        self.points.put_tangent(self._tangent)

    def add_force(self, b: Any) -> None:
        """Add the force (N) of the stresses to a vector, ghosts not yet summed."""
        if not self._idle:
            for form in self._forms.values():
                fem_petsc.assemble_vector(b, form)

    def add_force_of(self, stresses: Array, b: Any) -> None:
        """Add the force (N) of other stresses to a vector, ghosts not yet summed."""
        self.points.put_stress(stresses)
        self.add_force(b)
        self.points.put_stress(self._stress)

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

    def advance(self, length: float) -> float:
        """Take a step, and return its length.

        A first step by the tangents of the last step is taken whole or not at all: where the
        motion turned in the last step, points that stick are extrapolated as if they slid, and
        the step that takes this back may be far too long. The next one is then as if all slid.

        Args:
            length: The largest that keeps the iterate admissible, up to one.
        """
        if self._goes_on and not self._started and length < 1.0:
            self._goes_on = False
            return 0.0
        if self._started and self._move is not None:
            self._interior.advance(self._move, length)
        self._moved = not self._idle
        return length

    def obeys_law(self, tolerance: float, energy: Callable[[], float]) -> bool:
        """Return whether the stresses obey their laws; collective.

        Args:
            tolerance: Energy by which a law may be missed, relative.
            energy: Returns the energy (J) of the sheet, which counts where little is lost.
        """
        if self._idle:
            return True
        if not self._started:  # nothing has moved, and nothing creeps
            active = self.points.creeps or bool(self._increment.any())
            return not self._sum(float(active))
        gap, loss = self._sum(self._interior.gap()), self._sum(self._interior.loss())
        return gap <= OF_LOSS * tolerance * loss or gap <= OF_ENERGY * tolerance * energy()

    def linearise(self) -> tuple[Array, Array]:
        """Linearise the law at the solution, and give the forms the tangent.

        Points that stick are as good as rigid. Where a point is about to slide or to stick, the
        law has a kink, and this is one of its slopes or between them.

        Returns:
            d tau/d b, and d b/d zeta at fixed stress, at each point.
        """
        tangent = by_bound = np.zeros_like(self._accepted)
        if not self._idle:
            tangent = STUCK * self._stiffness
            if self._started:
                tangent, by_bound = self._present_tangent(STUCK), -self._interior.bound_slope()
        self.points.put_tangent(tangent)
        return tangent, by_bound

    @contextmanager
    def off_bounds(self) -> Iterator[None]:
        """Give the forms stresses that are not at their bounds even by round-off."""
        most = (1 - INSIDE) * self.points.bound
        self.points.put_stress(np.clip(self._stress, -most, most))
        yield
        self.points.put_stress(self._stress)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self._force.destroy()
        self._solution.destroy()

    @property
    def _idle(self) -> bool:
        """Whether there is no friction: left out for the initial state, or without strength."""
        return float(self._acting.value) == 0 or self._area == 0

    def _first(self) -> Array:
        """Return d tau/d b for the first iteration: that of the last step, or as if all slid."""
        slid = np.minimum(FIRST * self._stiffness, self._secant)
        return np.asarray(self._last if self._goes_on else slid)

    def _present_tangent(self, largest: float = LARGEST) -> Array:
        self._creep, slope = self.points.creep()
        return self._interior.tangent(slope, largest * self._stiffness)

    def _extrapolate(self) -> None:
        """Go on from the accepted stresses by the first tangent."""
        first = self._first()
        self.points.put_tangent(first)  # what is prescribed and not yet attained acts by it
        self._set_stress(self._accepted + first * self._increment)

    def _share_missed(self) -> tuple[float, Array]:
        """Return the energy by which laws are missed over the loss, b less creep; collective."""
        with self.off_bounds():
            sliding = self._increment - self.points.creep()[0]
        soft = np.minimum(self._first(), FIRST * self._stiffness)
        parts = self._interior.missed_and_lost(sliding, self._stress, self._least, soft)
        return self._sum(parts[0]) / self._sum(parts[1]), sliding

    def _start(self) -> bool:
        """Start the interior-point method where the first step has led, unless that is nowhere."""
        interior, (share, sliding) = self._interior, self._share_missed()
        if self._goes_on and share > LOST:
            return False
        near = self._goes_on and share < MISLED
        slip = np.maximum(self.points.largest(self._increment), self._least)
        slip *= np.clip(PER_MISS * share, NEAREST, START_SLIP) if near else START_SLIP
        interior.place(self._stress, sliding, slip if near else None)
        self._set_stress(interior.stress)
        interior.split(self._increment - self.points.creep()[0], slip, level=near)
        self._started = True
        return True

    def _longest(self, move: Increment) -> float:
        """Return the step length at which the first point reaches a bound; collective."""
        return float(self._comm.allreduce(self._interior.longest(move), op=MPI.MIN))

    def _solve(self, linear: LinearSolver, plain: Any, aim: Aim) -> Increment:
        """Solve for the displacements of a target; return the change of the stresses.

        The displacements are left in ``_solution``, to be subtracted.

        Args:
            linear: Solves with the tangent.
            plain: Newton's step for stresses as they are.
            aim: Target of the stresses.
        """
        excess = self._tangent * (self._increment - aim.increment)
        self.points.put_stress(excess)
        with self._force.localForm() as local:
            local.set(0.0)
        self.add_force(self._force)
        self._force.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        fem_petsc.set_bc(self._force, self._bcs, alpha=0.0)
        linear.solve(self._force, self._solution)
        self._solution.axpy(1.0, plain)
        changes = self.points.changes(-self._solution.array_r)
        return self._interior.move(excess + self._tangent * changes, aim)

    def _set_stress(self, stress: Array) -> None:
        self._stress = stress
        self.points.put_stress(stress)

    def _sum(self, value: float) -> float:
        return float(self._comm.allreduce(value, op=MPI.SUM))


class PointSensitivity:
    """Changes d tau = D (db - db|tau) of stresses at points by parameters and earlier states.

    D is the tangent; b changes with the states and, at fixed stress, by the bound and by creep.
    """

    def __init__(
        self,
        model: Model,
        stress: PointStress,
        targets: Sequence[Target],
        changes: Sequence[tuple[fem.Function, fem.Function]],
    ) -> None:
        """Compile what changes at the points for fixed present state and stress; collective.

        Args:
            model: The model with point friction.
            stress: Its stresses.
            targets: The parameters.
            changes: Fields that the laws depend on, each with that along which it changes.
        """
        self._stress, points, frictions = stress, stress.points, model.point_frictions

        def slopes(of: Callable[[PointFriction], Any]) -> tuple[Any, list[Any]]:
            """Return the changes of a quantity along the fields, and by each parameter."""

            def by(target: Target, friction: PointFriction) -> Any:
                terms = [friction.term]
                return by_parameter(target, terms, lambda t: of(replace(friction, term=t)))

            parameters = [[by(t, f) or ufl.zero() for f in frictions] for t in targets]
            along = points.compiled([along_fields(of(f), changes) for f in frictions])
            return along, [points.compiled(row) for row in parameters]

        self._strengths = slopes(PointFriction.strength)
        self._excesses = slopes(PointFriction.excess)
        self._tangent: Array = np.zeros(0)
        self._by_bound: Array = np.zeros(0)

    def linearise(self) -> None:
        """Linearise the laws at the solution, and give the forms their tangents."""
        with self._stress.off_bounds():
            self._tangent, self._by_bound = self._stress.linearise()

    def hold(self) -> None:
        """Give the forms no tangents: stresses stay as they are."""
        self._stress.points.put_tangent(np.zeros_like(self._tangent))

    def add_force(self, target: int, b: Any) -> None:
        """Add the force of the changes at fixed present state; ghosts are not yet summed.

        The fields along which earlier states change must be those of this parameter.

        Args:
            target: Number of the parameter.
            b: PETSc's vector.
        """
        self._stress.add_force_of(self._change(target), b)

    def stress(self, target: int, along: Array) -> Array:
        """Return the changes by parameter ``target``, which changes own unknowns ``along`` (m)."""
        return np.asarray(self._change(target) + self._tangent * self._stress.points.changes(along))

    def _change(self, target: int) -> Array:
        def change(slopes: tuple[Any, list[Any]]) -> Array:
            along, by = slopes
            return self._stress.points.values(along) + self._stress.points.values(by[target])

        with self._stress.off_bounds():
            excess, strength = change(self._excesses), change(self._strengths)
        return np.asarray(self._tangent * (excess - self._by_bound * strength))
