"""Backtracking along Newton's step until the potential falls enough (Armijo)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

#: Largest number of halvings, and the constant of sufficient decrease.
HALVINGS = 14
DECREASE = 1e-4


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
