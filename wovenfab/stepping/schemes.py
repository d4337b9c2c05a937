"""Time schemes: how a rate is formed, where in a step it holds, and the error of a step.

The error is an embedded estimate: the dissipated power and the forces are evaluated with the rate
of the scheme and with that of the polynomial through one state more (Hairer, Norsett and Wanner,
Solving Ordinary Differential Equations I, III.5, for the error of formulas of variable step).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.model.memory import attributes, take_attributes
from wovenfab.model.model import preserved

if TYPE_CHECKING:
    from wovenfab.solver.equilibrium import EquilibriumSolver

Array = NDArray[np.float64]
#: Steps of the last length over which the motion is extrapolated by a parabola.
FAR_AHEAD = 1.5
#: A step with this many times the allowed error is repeated with a shorter length.
REPEAT_FROM = 1.5
#: Safety factor of the next length, and its least ratio to the last one.
SAFETY, LEAST = 0.85, 0.3
#: Growth once after steps whose lengths differ by this ratio at most. A planned step is made in
#: equal parts: halves would never become a whole one again if each step grew by less than two.
#: BDF of third order is zero-stable where even such steps follow one another.
DOUBLE, EVEN = 2.0, 1 + 1e-6


@dataclass(frozen=True)
class Scheme:
    """A scheme that solves one equilibrium a step.

    Attributes:
        name: As in the case file.
        order: Order of accuracy.
        stage: Where in the step equilibrium holds: 1 at its end, 1/2 in the middle.
        memory: Number of earlier states that the rates use.
        growth: Largest ratio of a step to the last one where steps adapt. BDF is zero-stable
            below 1 + sqrt(2) and 1.534 for orders 2 and 3 (Calvo, Grande and Grigorieff 1990,
            doi:10.1007/BF01386434).
    """

    name: str
    order: int
    stage: float
    memory: int
    growth: float = 2.0

    @property
    def measures_error(self) -> bool:
        """Whether the error of a step can be measured, by a rate of one order more."""
        return self.stage == 1 and self.order > 1

    def weights(self, steps: Sequence[float]) -> tuple[float, ...]:
        """Return the weights (1/s) of the stage state and the earlier states in a rate.

        Args:
            steps: Lengths of this step and of those before it, latest first, s. The rate does
                not look back beyond them: where the velocity jumps there is this one alone.
        """
        if self.stage == 1:
            return self.weights_at_end(steps)
        one = 1 / (self.stage * steps[0])
        return (one, -one, *(0.0 for _ in range(self.memory - 1)))

    def weights_at_end(self, steps: Sequence[float]) -> tuple[float, ...]:
        """Return the weights (1/s) in the rate at the end of a step; as :meth:`weights`."""
        used = end_weights(steps[: self.memory])
        return (*used, *(0.0 for _ in range(self.memory + 1 - len(used))))


def end_weights(steps: Sequence[float]) -> tuple[float, ...]:
    """Return the weights (1/s) of the states in the rate at the end of a step.

    The rate is that of the polynomial through the state there and the earlier ones: BDF for
    steps of unequal length, of as many orders as there are steps.

    Args:
        steps: Lengths of this step and of those before it, latest first, s.
    """
    ages = np.cumsum(steps)
    others = [np.delete(ages, j) for j in range(len(ages))]
    weights = [
        -float(np.prod(other / (other - age)) / age)
        for age, other in zip(ages, others, strict=True)
    ]
    return (-sum(weights), *weights)


SCHEMES = {
    s.name: s
    for s in (
        Scheme("backward-euler", order=1, stage=1.0, memory=1),
        Scheme("bdf2", order=2, stage=1.0, memory=2),
        Scheme("bdf3", order=3, stage=1.0, memory=3, growth=1.5),
        Scheme("midpoint", order=2, stage=0.5, memory=2),
    )
}


def extrapolation(states: Sequence[Array], steps: Sequence[float], ahead: float) -> Array:
    """Return the change over ``ahead`` (s) of the polynomial through the last states.

    Linear through two states, quadratic through three (Newton's divided differences)
    where that is not far.

    Args:
        states: Latest first.
        steps: Times between them, s.
        ahead: Time from the latest, s.
    """
    slope = (states[0] - states[1]) / steps[0]
    change = ahead * slope
    if len(steps) > 1 and ahead <= FAR_AHEAD * steps[0]:
        earlier = (states[1] - states[2]) / steps[1]
        change = change + ahead * (ahead + steps[0]) * (slope - earlier) / (steps[0] + steps[1])
    return np.asarray(change)


@dataclass(frozen=True)
class StepError:
    """The error of one step in time, signed: its answer less a better one.

    Attributes:
        power: Of the dissipated power at its end, W.
        force: Of the force that is conjugate to the program, N.
        relative: The larger one of the errors of power and of the forces of edges over the largest
            power and force so far.
    """

    power: float
    force: float
    relative: float


def rate_error(now: Array, states: Sequence[Array], steps: Sequence[float]) -> Array:
    """Return by how much the rate of a step by BDF is too small, m/s.

    Args:
        now: State at its end, m.
        states: Earlier states, one more than the order, latest first.
        steps: Lengths of the step and of those between these states, latest first, s.
    """
    better, own = end_weights(steps), end_weights(steps[:-1])
    lacks = (more - less for more, less in zip(better, (*own, 0.0), strict=True))
    return np.asarray(sum(w * s for w, s in zip(lacks, (now, *states), strict=False)))


class TimeErrorEstimator:
    """Measures the error of steps and says how long the next may be."""

    def __init__(self, solver: EquilibriumSolver, scheme: Scheme, tolerance: float) -> None:
        """Start before the first step.

        Args:
            solver: Solver of the problem.
            scheme: A scheme that measures errors.
            tolerance: Allowed error of power and force, each over its largest size so far.
        """
        self._problem, self._scheme, self._tolerance = solver.problem, scheme, tolerance
        self._power = self._force = 0.0

    def snapshot(self) -> dict[str, Any]:
        """Return the largest power and force so far."""
        return attributes(self, "_power", "_force")

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on with those of a snapshot."""
        take_attributes(self, snapshot, "_power", "_force")

    def first(self, jump: bool) -> float:
        """Return the length of first steps over a planned one; their error is not known yet.

        Args:
            jump: The velocity jumps, so that their rates are of first order alone.
        """
        return min(1.0, self._tolerance if jump else self._tolerance**0.5)

    def measure(
        self, states: Sequence[Array], steps: Sequence[float], virtual: Array
    ) -> StepError | None:
        """Return the error of the step that has just been solved; collective.

        None where the velocity jumped too short a time ago.

        Args:
            states: Earlier states, latest first, m.
            steps: Lengths of the step and of those between these states since the velocity last
                jumped, latest first, s.
            virtual: Displacements (1) on which the work of reactions is the recorded force.
        """
        used = self._scheme.order + 1
        if len(steps) < used:
            return None
        lack = rate_error(self._problem.model.field.x.array, states, steps[:used])
        weights = self._scheme.weights(steps)
        problem, earlier = self._problem, self._problem.model.history[0]
        constraints, now, power = problem.constraints, problem.force, self._dissipated()
        with preserved(earlier):
            earlier.x.array[:] += lack / weights[1]
            off_power = power - self._dissipated()
            off_force = now - problem.evaluate_force()
        off_edges = _largest(constraints.reactions(off_force))
        self._power = max(self._power, abs(power))
        self._force = max(self._force, _largest(constraints.reactions(now)))
        shares = [
            size / scale
            for size, scale in ((abs(off_power), self._power), (off_edges, self._force))
            if scale
        ]
        along, _ = constraints.conjugate(off_force, virtual)
        return StepError(off_power, along, max(shares, default=0.0))

    def refuses(self, error: StepError) -> bool:
        """Return whether the step must be made again."""
        return error.relative > REPEAT_FROM * self._tolerance

    def growth(self, error: StepError, steps: Sequence[float]) -> float:
        """Return how long the next step may be over this one.

        Args:
            error: Of this step.
            steps: Lengths of this step and of those before it, latest first, s.
        """
        share: float = (self._tolerance / max(error.relative, 1e-30)) ** (1 / self._scheme.order)
        last = steps[: self._scheme.memory]
        is_even = len(last) == self._scheme.memory and max(last) <= EVEN * min(last)
        most = max(self._scheme.growth, DOUBLE) if is_even else self._scheme.growth
        return min(most, max(LEAST, SAFETY * share))

    def _dissipated(self) -> float:
        return sum(self._problem.model.dissipated_power().values())


def _largest(forces: Mapping[str, tuple[float, float]]) -> float:
    return max((hypot(x, y) for x, y in forces.values()), default=0.0)
