"""Two parallel jaws with a rectangular sample between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Jaws:
    """How a sample is held, and how the program moves one jaw against the other.

    Attributes:
        distance: Between the jaws at rest, m.
        width: Of the sample along the jaws, m.
        centre: Of the sample at rest, m.
        direction: Unit vector from the first jaw to the second.
        factor: Travel of the second jaw against the first per displacement of the program.
        offset: That travel (m) at zero displacement.
        free: Whether the distance is free to change, as under a constant tension.
    """

    distance: float
    width: float
    centre: tuple[float, float]
    direction: tuple[float, float]
    factor: float = 1.0
    offset: float = 0.0
    free: bool = False

    @property
    def area(self) -> float:
        """Area of the sample at rest, m^2."""
        return self.distance * self.width

    def travel(self, displacement: Values) -> Values:
        """Return the travel (m) at displacements of the program (m), of the same shape."""
        return self.factor * displacement + self.offset

    def force(self, conjugate: Values) -> Values:
        """Return the force along the travel (N) from that conjugate to the program (N)."""
        return np.asarray(conjugate / self.factor)

    def position(self, points: Values) -> tuple[Values, Values]:
        """Return how far points are from the centre along the direction and across it (m).

        Args:
            points: At rest, m, shape (n, 2).

        Returns:
            Two arrays of shape (n,).
        """
        (x, y), away = self.direction, points - np.asarray(self.centre)
        return away @ np.array([x, y]), away @ np.array([-y, x])
