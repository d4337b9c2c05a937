"""The laws of friction with stress at quadrature points, linearised for tangent-linear equations.

A stress follows d tau = D (db - db|tau): its tangent D, the change of the increment b with the
present and the earlier states, and that which a parameter causes at fixed stress, by the bound and
by creep.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from forms.friction import PointFriction
from forms.sensitivity import Target, creep_by, increment_along, strength_by
from wovenfab.model.model import Model
from wovenfab.solver.point_friction import PointStress

Array = NDArray[np.float64]


class PointSensitivity:
    """How the stresses at points change with parameters and earlier states."""

    def __init__(
        self,
        model: Model,
        stress: PointStress,
        targets: Sequence[Target],
        earlier: Sequence[fem.Function],
    ) -> None:
        """Compile what parameters change at the points; collective.

        Args:
            model: The model with point friction.
            stress: Its stresses.
            targets: The parameters.
            earlier: Fields along which the earlier states change.
        """
        self._stress, points = stress, stress.points
        frictions = model.point_frictions
        self._along = points.compiled([increment_along(f, earlier) for f in frictions])

        def of_all(by: Callable[[Target, PointFriction], Any | None]) -> list[Any]:
            symbols = [[by(t, f) or ufl.zero() for f in frictions] for t in targets]
            return [points.compiled(row) for row in symbols]

        self._strengths, self._creeps = of_all(strength_by), of_all(creep_by)
        self._tangent: Array = np.zeros(0)
        self._by_parameter: list[Array] = []  # changes of the increments at fixed stresses

    def linearise(self) -> None:
        """Linearise the laws at the solution, and give the forms their tangents."""
        points = self._stress.points
        with self._stress.off_bounds():
            self._tangent, by_bound = self._stress.linearise()
            pairs = zip(self._creeps, self._strengths, strict=True)
            self._by_parameter = [points.values(c) + by_bound * points.values(s) for c, s in pairs]

    def hold(self) -> None:
        """Give the forms no tangents: stresses stay as they are."""
        self._stress.points.put_tangent(np.zeros_like(self._tangent))

    def add_force(self, target: int, b: Any) -> None:
        """Add the force of the changes at fixed present state; ghosts are not yet summed.

        The fields along which earlier states change must be those of this parameter.

        Args:
            target: Number of the parameter.
            b: PETSc's vector.
        """
        self._stress.add_force_of(self._change(target), b)

    def stress(self, target: int, along: Array) -> Array:
        """Return the change of the stresses by a parameter.

        Args:
            target: Its number.
            along: Change of the present state at own unknowns.
        """
        return np.asarray(self._change(target) + self._tangent * self._stress.points.changes(along))

    def add_force_of(self, stresses: Array, b: Any) -> None:
        """Add the force of given stresses; ghosts are not yet summed."""
        self._stress.add_force_of(stresses, b)

    def _change(self, target: int) -> Array:
        points = self._stress.points
        change = points.values(self._along) - self._by_parameter[target]
        return np.asarray(self._tangent * change)
