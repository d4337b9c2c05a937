"""The algebra of friction at its bound, point by point: a primal-dual interior-point method.

A step minimises W + sum w zeta |b| over the points of the quadrature. Each increment is
split, b = creep(tau) + p - q with p, q >= 0, and the law tau = zeta where p > 0,
tau = -zeta where q > 0, is approached through p (zeta - tau) = q (zeta + tau) = mu as mu
falls to zero. Unlike the states of points (sticking or sliding either way), which flip
from one Newton step to the next where neighbours are tied by stiff yarns, p, q and tau
move continuously, so that few steps are enough however sharp the law is (Mehrotra, SIAM
J. Optim. 1992; Bleyer, CMAME 2018, for viscoplastic flow). A creep of zero is Coulomb.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Start of the method: largest stress over its bound, and p and q over a large increment.
START_STRESS, START_SLIP = 0.5, 0.1
#: Range of the products p (zeta - tau), over their mean, without a correction (Gondzio, 1996).
LEAST, MOST = 0.1, 10.0
#: Distance of a stress from its bound, over the bound, that is round-off.
CLOSEST = 1e-15


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

    def place(self, stress: Array) -> None:
        """Start at a stress, moved well inside its bounds."""
        limit = START_STRESS * self.bound
        self.stress = np.clip(stress, -limit, limit)

    def split(self, increment: Array, large: Array) -> None:
        """Start with p and q from an increment less its creep, and what is a large one."""
        self._up = np.maximum(increment, 0.0) + START_SLIP * large
        self._down = np.maximum(-increment, 0.0) + START_SLIP * large

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
        self.stress = np.clip(self.stress + length * move.stress, -self.bound, self.bound)
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
