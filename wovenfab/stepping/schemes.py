"""Time schemes: how rates are formed, where in a step they hold, and the error of a step.

The embedded error estimate of a step in time: what rates of one order more would change.

The rate of BDF2 differs from that of the cubic through one state more by
``h (h + a) / 6`` times the third divided derivative, where ``h`` is this step and ``a`` the
last. The dissipated power and the forces are evaluated with both (Hairer, Norsett and Wanner,
Solving Ordinary Differential Equations I, III.5, for the error of formulas of variable step).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.model.model import preserved
from wovenfab.model.snapshot import attributes, take_attributes
from wovenfab.solver.equilibrium import EquilibriumSolver

Array = NDArray[np.float64]
#: Steps of the last length over which the motion is extrapolated by a parabola.
FAR_AHEAD = 1.5


@dataclass(frozen=True)
class Scheme:
    """A scheme that solves one equilibrium a step.

    Attributes:
        name: As in the case file.
        order: Order of accuracy.
        stage: Where in the step equilibrium holds: 1 at its end, 1/2 in the middle.
        memory: Number of earlier states that the rates use.
    """

    name: str
    order: int
    stage: float
    memory: int

    def weights(self, step: float, before: float | None) -> tuple[float, ...]:
        """Return the weights (1/s) of the stage state and the earlier states in a rate.

        Args:
            step: Length of this step, s.
            before: Length of the last step, s; None where the motion starts or its
                velocity jumps, so that the rate must not look back.
        """
        if self.stage < 1 or self.memory == 1 or before is None:
            one = 1 / (self.stage * step)
            return (one, -one, *(0.0 for _ in range(self.memory - 1)))
        return end_weights(step, before)


def end_weights(step: float, before: float) -> tuple[float, float, float]:
    """Return the weights (1/s) of the three-point rate at the end of a step.

    Second order for unequal steps (variable-step BDF2).
    """
    r = step / before
    return (1 + 2 * r) / (1 + r) / step, -(1 + r) / step, r * r / (1 + r) / step


SCHEMES = {
    s.name: s
    for s in (
        Scheme("backward-euler", order=1, stage=1.0, memory=1),
        Scheme("bdf2", order=2, stage=1.0, memory=2),
        Scheme("midpoint", order=2, stage=0.5, memory=2),
    )
}


def extrapolation(
    states: Sequence[NDArray[np.float64]], steps: Sequence[float], ahead: float
) -> NDArray[np.float64]:
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


#: A step with this many times the allowed error is repeated with a shorter length.
REPEAT_FROM = 1.5
#: Safety factor of the next length, and its least and largest ratio to the last one.
SAFETY, LEAST, MOST = 0.85, 0.3, 2.0


@dataclass(frozen=True)
class StepError:
    """The error of one step in time, signed: its answer less a better one.

    Attributes:
        power: Of the dissipated power at its end, W.
        forces: Of the force (N; x, y) that each held edge exerts.
        relative: The larger of both over the largest power and force so far.
    """

    power: float
    forces: Mapping[str, tuple[float, float]]
    relative: float


def rate_error(now: Array, states: Sequence[Array], steps: Sequence[float], step: float) -> Array:
    """Return by how much the rate of a step is too small, m/s.

    Args:
        now: State at its end, m.
        states: Three earlier states, latest first.
        steps: Times between those, s.
        step: Length of the step, s.
    """
    a, b = steps[:2]
    slope = (states[0] - states[1]) / a
    bend = ((now - states[0]) / step - slope) / (step + a)
    earlier = (slope - (states[1] - states[2]) / b) / (a + b)
    return np.asarray(step * (step + a) * (bend - earlier) / (step + a + b))


class TimeErrorEstimator:
    """Measures the error of steps and says how long the next may be."""

    def __init__(self, solver: EquilibriumSolver, tolerance: float) -> None:
        """Start before the first step.

        Args:
            solver: Solver of the problem, whose rates use two earlier states.
            tolerance: Allowed error of power and force, each over its largest size so far.
        """
        self._problem, self._tolerance = solver.problem, tolerance
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
        return min(1.0, self._tolerance if jump else sqrt(self._tolerance))

    def measure(
        self, states: Sequence[Array], steps: Sequence[float], step: float, weights: Sequence[float]
    ) -> StepError:
        """Return the error of the step that has just been solved; collective.

        Args:
            states: Three earlier states, latest first, m.
            steps: Times between those, s.
            step: Length of the step, s.
            weights: Weights of the states in its rates, 1/s.
        """
        lack = rate_error(self._problem.model.field.x.array, states, steps, step)
        problem, earlier = self._problem, self._problem.model.history[0]
        reactions, power = problem.reactions(), self._dissipated()
        with preserved(earlier):
            earlier.x.array[:] += lack / weights[1]
            off_power = power - self._dissipated()
            better = problem.constraints.reactions(problem.evaluate_force())
        forces = {
            name: (x - better[name][0], y - better[name][1]) for name, (x, y) in reactions.items()
        }
        self._power = max(self._power, abs(power))
        self._force = max(self._force, _largest(reactions))
        shares = [
            size / scale
            for size, scale in ((abs(off_power), self._power), (_largest(forces), self._force))
            if scale
        ]
        return StepError(off_power, forces, max(shares, default=0.0))

    def refuses(self, error: StepError) -> bool:
        """Return whether the step must be made again."""
        return error.relative > REPEAT_FROM * self._tolerance

    def growth(self, error: StepError) -> float:
        """Return how long the next step may be over this one; errors are of second order."""
        best = SAFETY * sqrt(self._tolerance / max(error.relative, 1e-30))
        return min(MOST, max(LEAST, best))

    def _dissipated(self) -> float:
        return sum(self._problem.model.dissipated_power().values())


def _largest(forces: Mapping[str, tuple[float, float]]) -> float:
    return max((max(abs(x), abs(y)) for x, y in forces.values()), default=0.0)
