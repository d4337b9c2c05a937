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
#: Share of its gain by which a whole step may raise the potential over the lowest so far.
LOOSE = 0.1


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
        self._lowest = np.inf  # potential of an iterate of this solve, J
        self._start = system.model.field.x.array.copy()

    def begin(self) -> None:
        """Begin a solve."""
        self.forget()
        self.failures = 0

    def forget(self) -> None:
        """Know nothing of an iterate that no search has led to."""
        self.potential, self.decrement, self._lowest = None, np.inf, np.inf

    def measure(self) -> float:
        """Return the potential (J) of the model's present field, and know it; collective."""
        self.potential = self._system.energy()
        return self.potential

    def along(
        self, slope: float, length: float, noise: Callable[[float], float], loose: bool = False
    ) -> float:
        """Return a length of the barrier's step with sufficient decrease; collective.

        Soft motions of stiff yarns go along curved valleys of the potential. A whole step leaves
        them, and rises a little; the next one, which knows the stress that the first one meant,
        returns to them much farther down (the watchdog technique: Chamberlain, Powell, Lemarechal
        and Pedersen, 1982).

        Args:
            slope: Decrease of the potential per unit length at the iterate, J.
            length: First length to try.
            noise: Returns by how much a potential (J) may seem to rise by rounding alone, J.
            loose: Whether a whole step may rise a little from the lowest potential so far.
        """
        model, step = self._system.model, self._barrier.step
        field, start = model.field.x.array, self._start
        start[:] = field
        before = self.measure() if self.potential is None else self.potential
        self._lowest = min(self._lowest, before)
        loose = loose and length == 1.0 and before == self._lowest
        rise = LOOSE * slope if loose else -np.inf

        def potential(at: float) -> float:
            field[:] = start + at * step.x.array
            return self._system.energy()

        length, self.potential = backtrack(potential, before, slope, length, noise(before), rise)
        field[:] = start
        lost = self.potential is None or length < SHORTEST
        self.failures = self.failures + 1 if lost else 0
        risen = self.potential is not None and self.potential > before + noise(before)
        self.decrement = abs(slope) if length == 1.0 and not risen else np.inf
        return length


def backtrack(
    potential: Callable[[float], float],
    start: float,
    slope: float,
    length: float,
    noise: float,
    rise: float = -np.inf,
) -> tuple[float, float | None]:
    """Return a step length with sufficient decrease, and the potential there.

    Args:
        potential: Returns the potential (J) at a length; collective.
        start: That at length zero, J.
        slope: Its decrease per unit length there, J.
        length: First length to try.
        noise: Increase that rounding alone may feign, J.
        rise: Increase that the first length may bring, J.

    Returns:
        The length, halved as often as needed, and the potential; None where none falls.
    """
    for _ in range(HALVINGS):
        found = potential(length)
        if np.isfinite(found) and found <= start + max(rise, -DECREASE * length * slope) + noise:
            return length, found
        length, rise = length / 2, -np.inf
    return length, None
