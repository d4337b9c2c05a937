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
