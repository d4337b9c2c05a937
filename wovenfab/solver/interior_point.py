"""The algebra of friction at its bound, point by point: a primal-dual interior-point method.

A step minimises W + sum w zeta |b| over the points of the quadrature. Each increment is
split, b = creep(tau) + p - q with p, q >= 0, and the law tau = zeta where p > 0,
tau = -zeta where q > 0, is approached through p (zeta - tau) = q (zeta + tau) = mu as mu
falls to zero. Unlike the states of points (sticking or sliding either way), which flip
from one Newton step to the next where neighbours are tied by stiff yarns, p, q and tau
move continuously, so that few steps are enough however sharp the law is (Mehrotra, SIAM
J. Optim. 1992; Bleyer, CMAME 2018, for viscoplastic flow). A creep of zero is Coulomb.

The quadrature points with such a stress are plain arrays here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives
from ufl.constantvalue import Zero

from wovenfab.forms.friction import PointFriction
from wovenfab.model.assembly import compile_expression, compile_expressions
from wovenfab.model.memory import PointValues

Array = NDArray[np.float64]
#: Largest distance of a stress from its bound at the start, over the bound.
START_ROOM = 0.5
#: Range of the products p (zeta - tau), over their mean, without a correction (Gondzio, 1996).
LEAST, MOST = 0.1, 10.0
#: Distance of a stress from its bound, over the bound, that is round-off.
CLOSEST = 1e-15
#: Stands for infinity.
HUGE = 1e30


@dataclass(frozen=True)
class Aim:
    """What a step aims at.

    Attributes:
        up, down: Aim values of p (zeta - tau) and q (zeta + tau), N/m.
        increment: The increment that belongs to them at the present stress, m.
    """

    up: Array
    down: Array
    increment: Array


@dataclass(frozen=True)
class Increment:
    """A change of stress, p and q."""

    stress: Array
    up: Array
    down: Array


class InteriorPoint:
    """Stress tau and split increments p, q of points, all inside their bounds.

    Stresses are written as of slip friction: N/m^2 and m. Any other pair whose product is
    an energy per area does as well.

    Attributes:
        stress: tau, of size below ``bound``.
    """

    def __init__(self, bound: Array, area: Array) -> None:
        """Take the bound zeta > 0 and the area (m^2) of each point."""
        self.bound, self.area = bound, area
        self.stress = np.zeros_like(bound)
        self._up, self._down = np.zeros_like(bound), np.zeros_like(bound)

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

    def place(self, stress: Array, increment: Array, slip: Array | None = None) -> None:
        """Start at a stress, moved inside its bounds.

        Args:
            stress: It may be beyond its bounds.
            increment: That belongs to it.
            slip: Its error, if both are nearly right.
        """
        share = START_ROOM if slip is None else slip / (np.abs(increment) + slip)
        room = self.bound * np.minimum(START_ROOM, share)
        self.stress = np.clip(stress, room - self.bound, self.bound - room)

    def split(self, increment: Array, slip: Array, level: bool) -> None:
        """Start with p and q from an increment less its creep.

        Args:
            increment: p - q.
            slip: Least value of both, m.
            level: Their products with the room of the stress are about the same everywhere.
        """
        above, below = self._room() if level else (self.bound, self.bound)
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

    def aim(self, creep: Array, level: float, move: Increment | None = None) -> Aim:
        """Return the target of a step.

        Args:
            creep: Creep at the present stress.
            level: mu, N/m.
            move: The predictor, for the second-order terms.
        """
        above, below = self._room()
        up = level + (move.up * move.stress if move else np.zeros_like(above))
        down = level - (move.down * move.stress if move else np.zeros_like(above))
        return Aim(up, down, creep + up / above - down / below)

    def centred(self, aim: Aim, creep: Array, level: float, move: Increment, length: float) -> Aim:
        """Return a target with which products that are far from their mean come nearer to it.

        Args:
            aim: The target before.
            creep: Creep at the present stress.
            level: Mean of all products, N/m.
            move: The step that the target before gives.
            length: Step length at which the products are taken.
        """
        above, below = self._room()
        up = (self._up + length * move.up) * (above - length * move.stress)
        down = (self._down + length * move.down) * (below + length * move.stress)
        least, most = LEAST * level, MOST * level
        more_up = np.maximum(np.clip(up, least, most) - up, -most)
        more_down = np.maximum(np.clip(down, least, most) - down, -most)
        up, down = aim.up + more_up, aim.down + more_down
        return Aim(up, down, creep + up / above - down / below)

    def move(self, stress: Array, aim: Aim) -> Increment:
        """Return the changes of stress, p and q that belong to a change of the stress."""
        above, below = self._room()
        up = (aim.up + self._up * stress) / above - self._up
        down = (aim.down - self._down * stress) / below - self._down
        return Increment(stress, up, down)

    def longest(self, move: Increment) -> float:
        """Return the step length at which the first point reaches a bound."""
        above, below = self._room()
        rooms = (self._up, self._down, above, below)
        changes = (move.up, move.down, -move.stress, move.stress)
        return min(
            float((-room[change < 0] / change[change < 0]).min(initial=np.inf))
            for room, change in zip(rooms, changes, strict=True)
        )

    def advance(self, move: Increment, length: float) -> None:
        """Take a step."""
        most = (1 - CLOSEST) * self.bound  # at the bound itself a creep is infinite
        self.stress = np.clip(self.stress + length * move.stress, -most, most)
        self._up = self._up + length * move.up
        self._down = self._down + length * move.down

    def gap(self, move: Increment | None = None, length: float = 0.0) -> float:
        """Return the energy (J) by which the law is not met, now or after a step."""
        above, below = self._room()
        up, down = self._up, self._down
        if move:
            above, below = above - length * move.stress, below + length * move.stress
            up, down = up + length * move.up, down + length * move.down
        return float(self.area @ (up * above + down * below))

    def loss(self) -> float:
        """Return the energy (J) that p and q dissipate, the scale of a gap."""
        return float(self.area @ (self.bound * (self._up + self._down)))

    def _room(self) -> tuple[Array, Array]:
        """Return the distances of the stress from its two bounds."""
        least = CLOSEST * self.bound
        above, below = self.bound - self.stress, self.bound + self.stress
        return np.maximum(above, least), np.maximum(below, least)


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
        self._rule = points
        given = ufl.as_vector([abs(ufl.JacobianDeterminant(mesh)), friction.strength()])
        symbols, creep = [friction.increment(), friction.change(direction), given], friction.creep()
        self._increment, self._change, self._given, *more = compile_expressions(
            symbols if creep is None else [*symbols, creep], points
        )
        self._creep = more[0] if more else None
        self.varies = bool(friction.term.effect.memory)
        area = self.at(self._given)[::2]
        self.area = np.repeat(area * np.tile(weights, own), self._size)

    @property
    def bound(self) -> Array:
        """The largest stress."""
        return np.repeat(self.at(self._given)[1::2], self._size)

    def increments(self) -> Array:
        return self.at(self._increment)

    def changes(self) -> Array:
        return self.at(self._change)

    def creep(self) -> Array:
        """Return the creep and its slope, shape (2, n)."""
        if self._creep is None:
            return np.zeros((2, self.area.size))
        values = self.at(self._creep).reshape(-1, 2, self._size)
        return np.swapaxes(values, 0, 1).reshape(2, -1)

    def compiled(self, symbol: Any) -> fem.Expression:
        """Return a scalar or vector as an expression of as many components as the stress."""
        shape = ufl.as_ufl(symbol).ufl_shape
        one = fem.Constant(self._mesh, 1.0)  # FFCx takes no expression that is a plain number
        rows = [one * (symbol[i] if shape else symbol) for i in range(self._size)]
        return compile_expression(ufl.as_vector(rows), self._rule)

    def put(self, function: fem.Function, values: Array) -> None:
        rows = function.x.array.reshape(-1, self._size)
        rows[self._dofs] = values.reshape(*self._dofs.shape, self._size)

    def at(self, expression: fem.Expression) -> Array:
        values: Array = expression.eval(self._mesh, self.cells)
        return values.ravel()


class FrictionPoints:
    """All points of some frictions on this rank that may have a bound above zero, one by one.

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
        varying = np.repeat([r.varies for r in self._rules], [r.area.size for r in self._rules])
        self._acting: NDArray[np.bool_] = (
            everywhere > 0
        ) | varying  # one that varies may come from zero
        self._varying = varying[self._acting]
        self._ends = np.cumsum([r.area.size for r in self._rules])[:-1]
        self._comm = space.mesh.comm
        self.bound = everywhere[self._acting]
        self.area = np.concatenate([r.area for r in self._rules])[self._acting]
        self.creeps = any(not f.term.effect.set_valued for f in frictions)

    def renew(self, least: Array) -> bool:
        """Evaluate the bounds anew if any varies; return whether one does.

        Args:
            least: Smallest that a bound which varies may be.
        """
        varies = any(rule.varies for rule in self._rules)
        if varies:
            self.bound[:] = np.maximum(self._all(lambda rule: rule.bound), least * self._varying)
        return varies

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
        sizes = [rule.area.size for rule in self._rules]
        repeated: Array = np.repeat(most, sizes)[self._acting]
        return repeated

    def stiffness(self, diagonal: Callable[[], float]) -> tuple[float, Array]:
        """Return the size of the tangent's diagonal (N/m), and the sheet's stiffness (N/m^3).

        Args:
            diagonal: Assembles the tangent and returns the size of its diagonal, N/m; collective.
        """
        none = stiffness = np.zeros_like(self.bound)
        self.put_stress(none)
        self.put_tangent(none)
        size = diagonal()
        for i in range(len(self._rules)):
            mine = [part + float(i == k) for k, part in enumerate(self._parts(none))]
            here = np.concatenate(mine)[self._acting]
            self.put_tangent(HUGE * here)
            stiffness = stiffness + here * size / (diagonal() / HUGE)
        self.put_tangent(none)
        return size, stiffness

    def compiled(self, symbols: Sequence[Any]) -> list[fem.Expression | None]:
        """Return one expression for each friction, compiled at its points; collective.

        Args:
            symbols: Scalars or vectors; zero gives None.
        """
        expanded = [expand_derivatives(ufl.as_ufl(symbol)) for symbol in symbols]
        pairs = zip(self._rules, expanded, strict=True)
        return [None if isinstance(s, Zero) else rule.compiled(s) for rule, s in pairs]

    def values(self, expressions: Sequence[fem.Expression | None]) -> Array:
        """Return the values of such expressions."""
        pairs = zip(self._rules, expressions, strict=True)
        parts = [np.zeros(r.area.size) if e is None else r.at(e) for r, e in pairs]
        return np.concatenate(parts)[self._acting]

    def _all(self, of: Callable[[_PointRule], Array]) -> Array:
        return np.concatenate([of(rule) for rule in self._rules])[self._acting]

    def _parts(self, values: Array) -> list[Array]:
        everywhere = np.zeros(self._acting.size)
        everywhere[self._acting] = values
        return np.split(everywhere, self._ends)

    def _put(self, values: Array, where: Callable[[PointFriction], Any]) -> None:
        for rule, part in zip(self._rules, self._parts(values), strict=True):
            rule.put(where(rule.friction), part)
