"""The search for a lower potential along Newton's steps, by backtracking (Armijo)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wovenfab.solver.admissible import Barrier
from wovenfab.solver.system import System

#: Largest number of halvings, and the constant of sufficient decrease.
HALVINGS = 14
DECREASE = 1e-4
#: A shorter step finds nothing either: the next one would be as short, at the barrier shorter.
SHORTEST = 1e-4


class Search:
    """Searches along the steps of one solve after the other.

    Attributes:
        potential: That of the present iterate (J), where it is known.
        decrement: Energy that the last step gains by its slope if it was a full one, J.
        failures: Searches in a row that found no lower potential.
    """

    def __init__(self, system: System, barrier: Barrier) -> None:
        """Search the potential of a system along the step of a barrier."""
        self._system, self._barrier = system, barrier
        self.potential: float | None = None
        self.decrement, self.failures = np.inf, 0

    def begin(self) -> None:
        """Begin a solve."""
        self.forget()
        self.failures = 0

    def forget(self) -> None:
        """Know nothing of an iterate that no search has led to."""
        self.potential, self.decrement = None, np.inf

    def measure(self) -> float:
        """Return the potential (J) of the model's present field, and know it; collective."""
        self.potential = self._system.energy()
        return self.potential

    def along(self, slope: float, length: float, noise: Callable[[float], float]) -> float:
        """Return a length of the barrier's step with sufficient decrease; collective.

        Args:
            slope: Decrease of the potential per unit length at the iterate, J.
            length: First length to try.
            noise: Returns by how much a potential (J) may seem to rise by rounding alone, J.
        """
        model, step = self._system.model, self._barrier.step
        field, start = model.field.x.array, model.field.x.array.copy()
        before = self.measure() if self.potential is None else self.potential

        def potential(at: float) -> float:
            field[:] = start + at * step.x.array
            return self._system.energy()

        length, self.potential = backtrack(potential, before, slope, length, noise(before))
        field[:] = start
        lost = self.potential is None or length < SHORTEST
        self.failures = self.failures + 1 if lost else 0
        self.decrement = abs(slope) if length == 1.0 else np.inf
        return length


def backtrack(
    potential: Callable[[float], float], start: float, slope: float, length: float, noise: float
) -> tuple[float, float | None]:
    """Return a step length with sufficient decrease, and the potential there.

    Args:
        potential: Returns the potential (J) at a length; collective.
        start: That at length zero, J.
        slope: Its decrease per unit length there, J.
        length: First length to try.
        noise: Increase that rounding alone may feign, J.

    Returns:
        The length, halved as often as needed, and the potential; None where none falls.
    """
    for _ in range(HALVINGS):
        found = potential(length)
        if np.isfinite(found) and found <= start - DECREASE * length * slope + noise:
            return length, found
        length /= 2
    return length, None
