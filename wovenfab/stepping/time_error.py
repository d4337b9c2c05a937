"""The embedded error estimate of a step in time: what rates of one order more would change.

The dissipated power and the forces are evaluated with the rate of the scheme and with that of
the polynomial through one state more (Hairer, Norsett and Wanner, Solving Ordinary
Differential Equations I, III.5, for the error of formulas of variable step).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.model.memory import attributes, take_attributes
from wovenfab.model.model import preserved
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.stepping.schemes import Scheme, end_weights

Array = NDArray[np.float64]
#: A step with this many times the allowed error is repeated with a shorter length.
REPEAT_FROM = 1.5
#: Safety factor of the next length, and its least ratio to the last one.
SAFETY, LEAST = 0.85, 0.3


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

    def measure(self, states: Sequence[Array], steps: Sequence[float]) -> StepError | None:
        """Return the error of the step that has just been solved; collective.

        None where the velocity jumped too short a time ago.

        Args:
            states: Earlier states, latest first, m.
            steps: Lengths of the step and of those between these states since the velocity last
                jumped, latest first, s.
        """
        used = self._scheme.order + 1
        if len(steps) < used:
            return None
        lack = rate_error(self._problem.model.field.x.array, states, steps[:used])
        weights = self._scheme.weights(steps)
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
        """Return how long the next step may be over this one."""
        share: float = (self._tolerance / max(error.relative, 1e-30)) ** (1 / self._scheme.order)
        return min(self._scheme.growth, max(LEAST, SAFETY * share))

    def _dissipated(self) -> float:
        return sum(self._problem.model.dissipated_power().values())


def _largest(forces: Mapping[str, tuple[float, float]]) -> float:
    return max((max(abs(x), abs(y)) for x, y in forces.values()), default=0.0)
