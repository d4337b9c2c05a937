"""Time schemes: how a rate is formed from the states, and where in a step it holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
