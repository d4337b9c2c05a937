"""Friction at its bound: a primal-dual interior-point method within Newton's steps.

A step minimises W + sum w zeta |b| over the points of the quadrature. Each increment is
split, b = creep(tau) + p - q with p, q >= 0, and the law tau = zeta where p > 0,
tau = -zeta where q > 0, is approached along the central path p (zeta - tau) = q (zeta + tau)
= mu as the barrier parameter mu falls to zero. Unlike the states of points (sticking or
sliding either way), which flip from one Newton step to the next where neighbours are tied by
stiff yarns, p, q and tau move continuously, so that few steps are enough however sharp the law
is (Mehrotra, SIAM J. Optim. 1992; Bleyer, CMAME 2018, for viscoplastic flow). A creep of zero
is Coulomb.

Each step solves twice with one factor of the tangent (Mehrotra): the predictor's target is the
law itself, the corrector adds the centring and the second-order terms that the predictor gives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.model.friction_stress import FrictionStress
from wovenfab.model.memory import PointValues, attributes

Array = NDArray[np.float64]
#: Largest length of a step over that at which a bound is reached; exponent of the centring.
SHARE, CENTRING = 0.995, 4
#: Largest number of centrality corrections; largest product p (zeta - tau), over their mean, that
#: needs none (Gondzio, 1996).
CORRECTIONS, MOST = 4, 10.0
#: Stiffness of friction over that of the sheet, as stiff as its yarns in tension, maybe a million
#: times softer in shear: in the first iteration and, later, at most, to limit round-off.
FIRST, LARGEST = 1e-3, 1e3
#: Least p and q at the start over a large increment: in general and, where the last step goes on,
#: over the share of energy by which the laws are missed.
START_SLIP, PER_MISS = 0.1, 0.2
#: Largest distance of a stress from its bound at the start, over the bound.
START_ROOM = 0.5
#: What is as good as none: an increment, over the one at which the first stiffness reaches the
#: bound; the distance of a stress from its bound where the law is linearised, over the bound; a
#: bound that varies, over the stress by which the sheet resists a displacement as large as a cell
#: (friction of no bound at all has no interior, and one that is left out cannot come back).
NOTHING = 1e-12
#: Energy by which the law may be missed, over the tolerance and the energy of the sheet.
OF_ENERGY = 0.1
#: Stiffness of a point that sticks, over that of the sheet, where the law is linearised at the end.
STUCK = 1e7
#: Distance of a stress from its bound, over the bound, that is round-off.
CLOSEST = 1e-15
#: Stands for infinity.
HUGE = 1e30
#: Values at points that later steps depend on.
MEMORY = "_accepted", "_stiffness", "_last_tangent"


class CentralPathTarget(NamedTuple):
    """The target of a step on the central path or near it.

    Attributes:
        up, down: Target values of p (zeta - tau) and q (zeta + tau), N/m.
        increment: The increment that belongs to them at the present stress, m.
    """

    up: Array
    down: Array
    increment: Array


class Direction(NamedTuple):
    """A search direction: changes of tau, p and q for a step of length one."""

    stress: Array
    up: Array
    down: Array


class InteriorPoint:
    """Stresses tau and split increments p, q of all bounded frictions, through Newton's steps.

    They are unknowns as the placements are: they change with Newton's steps, and no residual or
    tangent changes them. In the first iterations of a step, until the prescribed placements are
    attained, the stress is extrapolated from the accepted one; from there on it is an iterate
    inside its bounds.

    Values are arrays of shape (n,) over the points on this rank that may have a bound above zero.
    They are written as of slip friction: N/m^2 and m. Any other pair whose product is an energy
    per area does as well.

    Attributes:
        bound: Largest stress zeta.
        area: Area that each value stands for, m^2.
        stress: tau, as the forms have it.
        diagonal: Size of the diagonal of the tangent without friction, N/m; 0 if unknown.
        started: Whether the stress is an iterate of the method.
    """

    def __init__(self, frictions: Sequence[FrictionStress], comm: MPI.Comm, factor: Any) -> None:
        """Start without stress; collective.

        Args:
            frictions: The frictions.
            comm: Communicator of the mesh.
            factor: Constant that scales all friction: 1, or 0 for an initial state.
        """
        self._frictions, self._comm, self._factor = tuple(frictions), comm, factor
        sizes = self._sizes = [f.areas.size for f in frictions]
        everywhere = np.concatenate([f.strengths() for f in frictions])
        varying = np.repeat([f.varies for f in frictions], sizes)
        # One that varies may come from zero.
        self._included: NDArray[np.bool_] = (everywhere > 0) | varying
        self._varying = varying[self._included]
        self.bound = everywhere[self._included]
        self.area = self.gathered([f.areas for f in frictions])
        self._total_area = self._sum(float(self.area.sum()))
        self.diagonal = 0.0
        none = np.zeros_like(self.bound)
        self.stress = self._up = self._down = none
        self._increment = none  # b at the present iterate
        self._direction = Direction(none, none, none)  # of the next step
        self._accepted = none  # stress of the accepted state
        self._stiffness = none  # of the sheet, as seen by each point, N/m^3
        self._least = none  # increment that counts as none
        self._last_tangent: Array | None = None  # d tau/d b at the end of the last step, N/m^3
        self._goes_on = False  # whether the present step goes on as the last one
        self.started = False

    @property
    def varies(self) -> bool:
        """Whether the bound of any friction changes from step to step."""
        return any(f.varies for f in self._frictions)

    @property
    def acts(self) -> bool:
        """Whether there is friction; none is left out for the initial state, or of no strength."""
        return float(self._factor.value) != 0 and self._total_area > 0

    def begin(self, diagonal: Callable[[], float]) -> None:
        """Begin a step at the accepted stresses and the model's present field; collective.

        Args:
            diagonal: Assembles the tangent and returns the size of its diagonal, N/m.
        """
        self.started = False
        if not self.diagonal:
            self._measure_stiffness(diagonal)
        if self._renew_bound(NOTHING * np.sqrt(self.diagonal * self._stiffness)):
            self._accepted = np.clip(self._accepted, -self.bound, self.bound)
        self._least = NOTHING * self.bound / (FIRST * self._stiffness)
        self._increment = self._all(FrictionStress.increments)
        self._set_stress(self._accepted)
        moves = self._last_tangent is not None and self._sum(float(self._increment.any())) > 0
        self._goes_on = moves and self._share_missed()[0] < 1  # less is missed than lost
        self._extrapolate()

    def accept(self) -> None:
        """Take the present stresses as those of the accepted state; collective."""
        self._accepted = self.stress
        self._last_tangent = self._linearised()[1] if self.started else None

    def restore(self) -> None:
        """Go back to the stresses of the accepted state."""
        self._last_tangent, self.started = None, False
        self._set_stress(self._accepted)

    def snapshot(self) -> dict[str, Any]:
        """Return the accepted stresses, and stiffnesses once they are known."""
        known = {k: self._by_cell(v) for k, v in attributes(self, *MEMORY).items() if v is not None}
        return known | {"diagonal": self.diagonal}

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on with those of a snapshot."""
        for name in MEMORY:
            if values := snapshot.get(name.lstrip("_")):
                setattr(self, name, self.gathered([part.ravel() for part in values.parts]))
        self.diagonal = snapshot["diagonal"]
        self._set_stress(self._accepted)

    def put_tangent(self) -> None:
        """Give the forms d tau/d b of the present iterate."""
        self.give_tangent(self._linearised()[1] if self.started else self._first_tangent())

    def correct(self, step: Array, solve: Callable[[Array], Array]) -> tuple[Array, float]:
        """Find Newton's step and the search direction of the stresses; collective.

        Args:
            step: Newton's step of own unknowns (m), to be subtracted, for stresses as they are.
            solve: Returns the displacements (m) by the force of given stresses.

        Returns:
            The step that belongs to the direction, and the largest length that keeps the
            stresses inside their bounds, up to one.
        """
        if not self.started:
            return step, 1.0
        creep, tangent = self._linearised()

        def towards(target: CentralPathTarget) -> tuple[Array, Direction]:
            excess = tangent * (self._increment - target.increment)
            displacement = solve(excess) + step
            changes = self.changes(-displacement)
            return displacement, self.direction(excess + tangent * changes, target)

        _, predictor = towards(self.target(creep, 0.0))
        now = self._sum(self.gap())
        then = self._sum(self.gap(predictor, min(1.0, self._longest(predictor))))
        mu = (then / now) ** CENTRING * now / (2 * self._total_area)
        target, longest, corrected = self.target(creep, mu, predictor), -1.0, step
        for _ in range(1 + CORRECTIONS):
            displacement, tried = towards(target)
            length = self._longest(tried)
            if length <= longest:
                break
            corrected, self._direction, longest = displacement, tried, length
            if longest >= 1:
                break
            target = self.nearer(target, creep, mu, tried)
        # Steps come the closer to the bounds the less is missing, for quick convergence.
        share = 1 - min(1 - SHARE, now / self._sum(self.loss()))
        return corrected, min(1.0, share * longest)

    def admitted(self, length: float) -> float:
        """Return the length of a step, up to the one given: zero refuses it.

        A first step by the tangents of the last step is taken whole or not at all: where the
        motion turned in the last step, points that stick are extrapolated as if they slid, and
        the step that takes this back may be far too long. The next one is then as if all slid.

        Args:
            length: The largest that keeps the iterate admissible, up to one.
        """
        if self._goes_on and not self.started and length < 1.0:
            self._goes_on = False
            self._extrapolate()
            return 0.0
        return length

    def advance(self, length: float, attained: bool) -> None:
        """Take a step that the model's present field has taken; collective.

        Args:
            length: Of the step.
            attained: Whether the field has the prescribed placements.
        """
        if not self.acts:
            return
        self._increment = self._all(FrictionStress.increments)
        if self.started:
            self.take_step(self._direction, length)
            return
        self._extrapolate()
        if attained:
            self._start()

    def obeys_law(self, tolerance: float, energy: Callable[[], float]) -> bool:
        """Return whether the stresses obey their laws; collective.

        Args:
            tolerance: Energy by which a law may be missed, relative.
            energy: Returns the energy (J) of the sheet, which counts where little is lost.
        """
        if not self.acts:
            return True
        if not self.started:  # nothing has moved, and nothing creeps
            active = any(f.creeps for f in self._frictions) or bool(self._increment.any())
            return not self._sum(float(active))
        gap, loss = self._sum(self.gap()), self._sum(self.loss())
        return gap <= tolerance * loss or gap <= OF_ENERGY * tolerance * energy()

    def linearise(self) -> tuple[Array, Array]:
        """Linearise the law at the solution, and give the forms the tangent.

        Points that stick are as good as rigid. Where a point is about to slide or to stick, the
        law has a kink, and this is one of its slopes or between them.

        Returns:
            d tau/d b, and d b/d zeta at fixed stress, at each point.
        """
        tangent = by_bound = np.zeros_like(self._accepted)
        if self.acts:
            tangent = STUCK * self._stiffness
            if self.started:
                tangent, by_bound = self._linearised(STUCK)[1], -self.bound_slope()
        self.give_tangent(tangent)
        return tangent, by_bound

    @contextmanager
    def in_forms(self, stress: Array) -> Iterator[None]:
        """Give the forms other stresses, and then the present ones again."""
        self._put(stress, lambda f: f.stress)
        try:
            yield
        finally:
            self._put(self.stress, lambda f: f.stress)

    def mean_over_step(self) -> Array:
        """Return the stresses whose work on the increments is what the step loses."""
        share: Array = self._all(FrictionStress.mean_strengths) / self.bound
        return self.stress * share

    def off_bounds(self) -> Any:
        """Give the forms stresses that are not at their bounds even by round-off; a context."""
        most = (1 - NOTHING) * self.bound
        return self.in_forms(np.clip(self.stress, -most, most))

    def give_tangent(self, values: Array) -> None:
        """Give the forms tangents d tau/d b, none where no friction acts."""
        self._put(values * float(self.acts), lambda f: f.tangent)

    def changes(self, direction: Array) -> Array:
        """Return the change of b along a direction of own unknowns (m); collective."""
        return self._all(lambda f: f.changes(direction))

    def gathered(self, parts: Sequence[Array]) -> Array:
        """Return the values here from those at all points of each friction."""
        return np.concatenate(parts)[self._included]

    def missed_and_lost(
        self, increment: Array, stress: Array, least: Array, soft: Array
    ) -> tuple[float, float]:
        """Return the energies (J) by which Coulomb's law is missed and which is lost.

        Args:
            increment: b.
            stress: It may be beyond its bounds.
            least: Increment that counts as none.
            soft: Stiffness by which a stress beyond its bound leads to another increment, N/m^3.
        """
        inside = np.clip(stress, -self.bound, self.bound)
        beyond = self.bound * np.abs(stress - inside) / soft
        missed = self.bound * np.abs(increment) - inside * increment + beyond
        lost = self.bound * np.maximum(np.abs(increment), least)
        return float(self.area @ missed), float(self.area @ lost)

    def start_stress(self, stress: Array, increment: Array, slip: Array | None = None) -> None:
        """Start at a stress, moved inside its bounds.

        Args:
            stress: It may be beyond its bounds.
            increment: That belongs to it.
            slip: Its error, if both are nearly right.
        """
        share = START_ROOM if slip is None else slip / (np.abs(increment) + slip)
        room = self.bound * np.minimum(START_ROOM, share)
        self._set_stress(np.clip(stress, room - self.bound, self.bound - room))

    def start_split(self, increment: Array, slip: Array, near: bool) -> None:
        """Start with p and q from an increment less its creep.

        Args:
            increment: p - q.
            slip: Least value of both, m.
            near: Near the central path: p (zeta - tau) and q (zeta + tau) are about the same
                everywhere.
        """
        above, below = self._room() if near else (self.bound, self.bound)
        up, down = slip * self.bound / above, slip * self.bound / below
        self._up, self._down = np.maximum(up, down + increment), np.maximum(down, up - increment)

    def tangent(self, creep_slope: Array, most: Array) -> Array:
        """Return d tau/d b of the linearised law, N/m^3.

        Args:
            creep_slope: d creep/d tau.
            most: Largest value, to limit round-off.
        """
        above, below = self._room()
        return np.minimum(1 / (self._up / above + self._down / below + creep_slope), most)

    def bound_slope(self) -> Array:
        """Return d (q - p)/d zeta at fixed stress and products, m^3/N."""
        above, below = self._room()
        return self._up / above - self._down / below

    def target(
        self, creep: Array, mu: float, predictor: Direction | None = None
    ) -> CentralPathTarget:
        """Return the target of a step.

        Args:
            creep: Creep at the present stress.
            mu: Barrier parameter, N/m.
            predictor: For the second-order terms.
        """
        above, below = self._room()
        up = mu + (predictor.up * predictor.stress if predictor else np.zeros_like(above))
        down = mu - (predictor.down * predictor.stress if predictor else np.zeros_like(above))
        return CentralPathTarget(up, down, creep + up / above - down / below)

    def nearer(
        self, target: CentralPathTarget, creep: Array, mu: float, direction: Direction
    ) -> CentralPathTarget:
        """Return a target by which products far from the central path come nearer to it.

        Args:
            target: The target before.
            creep: Creep at the present stress.
            mu: Mean of all products, N/m.
            direction: That of the target before; the products are those of its whole length.
        """
        above, below = self._room()
        up = (self._up + direction.up) * (above - direction.stress)
        down = (self._down + direction.down) * (below + direction.stress)
        most = MOST * mu
        more_up = np.maximum(np.clip(up, 0.0, most) - up, -most)
        more_down = np.maximum(np.clip(down, 0.0, most) - down, -most)
        up, down = target.up + more_up, target.down + more_down
        return CentralPathTarget(up, down, creep + up / above - down / below)

    def direction(self, stress: Array, target: CentralPathTarget) -> Direction:
        """Return the changes of tau, p and q that belong to a change of the stress."""
        above, below = self._room()
        up = (target.up + self._up * stress) / above - self._up
        down = (target.down - self._down * stress) / below - self._down
        return Direction(stress, up, down)

    def longest(self, direction: Direction) -> float:
        """Return the step length at which the first point of this rank reaches a bound."""
        above, below = self._room()
        rooms = (self._up, self._down, above, below)
        changes = (direction.up, direction.down, -direction.stress, direction.stress)
        return min(
            float((-room[change < 0] / change[change < 0]).min(initial=np.inf))
            for room, change in zip(rooms, changes, strict=True)
        )

    def take_step(self, direction: Direction, length: float) -> None:
        """Go along a direction."""
        most = (1 - CLOSEST) * self.bound  # at the bound itself a creep is infinite
        self._set_stress(np.clip(self.stress + length * direction.stress, -most, most))
        self._up = self._up + length * direction.up
        self._down = self._down + length * direction.down

    def gap(self, direction: Direction | None = None, length: float = 0.0) -> float:
        """Return the complementarity gap of this rank: the energy (J) by which the law is missed.

        Args:
            direction: To a place along it; the present iterate unless given.
            length: Of the step to that place.
        """
        above, below = self._room()
        up, down = self._up, self._down
        if direction:
            above, below = above - length * direction.stress, below + length * direction.stress
            up, down = up + length * direction.up, down + length * direction.down
        return float(self.area @ (up * above + down * below))

    def loss(self) -> float:
        """Return the energy (J) that p and q dissipate on this rank, the scale of a gap."""
        return float(self.area @ (self.bound * (self._up + self._down)))

    def _room(self) -> tuple[Array, Array]:
        """Return the distances of the stress from its two bounds."""
        least = CLOSEST * self.bound
        above, below = self.bound - self.stress, self.bound + self.stress
        return np.maximum(above, least), np.maximum(below, least)

    def _first_tangent(self) -> Array:
        """Return d tau/d b for the first iteration: that of the last step, or as if all slid."""
        return np.asarray(self._last_tangent if self._goes_on else FIRST * self._stiffness)

    def _linearised(self, largest: float = LARGEST) -> tuple[Array, Array]:
        """Return the creep at the present stress, and d tau/d b of the linearised law."""
        creep, slope = self._creep()
        return creep, self.tangent(slope, largest * self._stiffness)

    def _creep(self) -> Array:
        """Return b below the bound and its slope by the stress, shape (2, n)."""
        both: Array = np.hstack([f.creeps_and_slopes() for f in self._frictions])
        return both[:, self._included]

    def _extrapolate(self) -> None:
        """Go on from the accepted stresses by the first tangent."""
        first = self._first_tangent()
        self.give_tangent(first)  # what is prescribed and not yet attained acts by it
        self._set_stress((self._accepted + first * self._increment) * float(self.acts))

    def _share_missed(self) -> tuple[float, Array]:
        """Return the energy by which laws are missed over the loss, b less creep; collective."""
        with self.off_bounds():
            sliding = self._increment - self._creep()[0]
        soft = np.minimum(self._first_tangent(), FIRST * self._stiffness)
        parts = self.missed_and_lost(sliding, self.stress, self._least, soft)
        return self._sum(parts[0]) / self._sum(parts[1]), sliding

    def _start(self) -> None:
        """Start the method where the first step has led; collective."""
        share, sliding = self._share_missed()
        near = self._goes_on and share < 1
        part = min(PER_MISS * share, START_SLIP) if near else START_SLIP
        slip = np.maximum(part * self._largest(self._increment), self._least)
        self.start_stress(self.stress, sliding, slip if near else None)
        self.start_split(self._increment - self._creep()[0], slip, near)
        self.started = True

    def _longest(self, direction: Direction) -> float:
        """Return the step length at which the first point reaches a bound; collective."""
        return float(self._comm.allreduce(self.longest(direction), op=MPI.MIN))

    def _measure_stiffness(self, diagonal: Callable[[], float]) -> None:
        """Measure the size of the tangent's diagonal, and the sheet's stiffness; collective.

        Friction of infinite stiffness adds to the diagonal what the sheet's stiffness is over.

        Args:
            diagonal: Assembles the tangent and returns the size of its diagonal, N/m.
        """
        none = stiffness = np.zeros_like(self.bound)
        self._put(none, lambda f: f.stress)
        self._put(none, lambda f: f.tangent)
        size = diagonal()
        for i in range(len(self._frictions)):
            one = self.gathered([np.full(n, float(i == k)) for k, n in enumerate(self._sizes)])
            self._put(HUGE * one, lambda f: f.tangent)
            stiffness = stiffness + one * size / (diagonal() / HUGE)
        self._put(none, lambda f: f.tangent)
        self.diagonal, self._stiffness = size, stiffness

    def _renew_bound(self, least: Array) -> bool:
        """Evaluate the bounds anew if any varies; return whether one does.

        Args:
            least: Smallest that a bound which varies may be.
        """
        if self.varies:
            self.bound = np.maximum(self._all(FrictionStress.strengths), least * self._varying)
        return self.varies

    def _largest(self, values: Array) -> Array:
        """Return for each value the largest absolute one of its friction; collective."""
        mine = [float(np.abs(part).max(initial=0.0)) for part in self._parts(values)]
        most = np.max(self._comm.allgather(mine), axis=0)
        repeated: Array = np.repeat(most, self._sizes)[self._included]
        return repeated

    def _all(self, of: Callable[[FrictionStress], Array]) -> Array:
        """Return values of all frictions."""
        return self.gathered([of(f) for f in self._frictions])

    def _parts(self, values: Array) -> list[Array]:
        """Return the values at all points of each friction, zero at those that are left out."""
        everywhere = np.zeros(self._included.size)
        everywhere[self._included] = values
        return np.split(everywhere, np.cumsum(self._sizes)[:-1])

    def _by_cell(self, values: Array) -> PointValues:
        parts = zip(self._frictions, self._parts(values), strict=True)
        return PointValues(tuple(f.by_cell(part) for f, part in parts))

    def _put(self, values: Array, where: Callable[[FrictionStress], Any]) -> None:
        """Give a field of each friction its values."""
        for f, part in zip(self._frictions, self._parts(values), strict=True):
            f.put(where(f), part)

    def _set_stress(self, stress: Array) -> None:
        self.stress = stress
        self._put(stress, lambda f: f.stress)

    def _sum(self, value: float) -> float:
        return float(self._comm.allreduce(value, op=MPI.SUM))
