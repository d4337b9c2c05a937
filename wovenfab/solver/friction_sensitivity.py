"""Derivatives of friction stresses at quadrature points by parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from wovenfab.forms.effect import Target, along_fields, by_parameter
from wovenfab.model.friction_stress import FrictionStress
from wovenfab.solver.problem import Problem

Array = NDArray[np.float64]
#: Compiled expressions, one for each friction; None for zero.
Compiled = list[fem.Expression | None]


class FrictionSensitivity:
    """Changes d tau = D (db - db|tau) of stresses at points by parameters and earlier states.

    D is the tangent; b changes with the states and, at fixed stress, by the bound and by creep.
    """

    def __init__(
        self,
        problem: Problem,
        targets: Sequence[Target],
        changes: Sequence[tuple[fem.Function, fem.Function]],
    ) -> None:
        """Compile what changes at the points for fixed present state and stress; collective.

        Args:
            problem: A problem with friction stresses at points at present.
            targets: The parameters.
            changes: Fields that the laws depend on, each with that along which it changes.
        """
        assert problem.friction is not None
        self._problem, self._friction = problem, problem.friction
        frictions = self._frictions = problem.model.friction_stresses

        def slopes(of: Callable[[FrictionStress], Any]) -> tuple[Compiled, list[Compiled]]:
            """Return the changes of a quantity along the fields, and by each parameter."""

            def by(target: Target, friction: FrictionStress) -> Any:
                terms = [friction.term]
                return by_parameter(target, terms, lambda t: of(replace(friction, term=t)))

            parameters = [[by(t, f) or ufl.zero() for f in frictions] for t in targets]
            along = self._compiled([along_fields(of(f), changes) for f in frictions])
            return along, [self._compiled(row) for row in parameters]

        self._strengths = slopes(FrictionStress.strength)
        self._excesses = slopes(FrictionStress.excess)
        self._tangent: Array = np.zeros(0)
        self._by_bound: Array = np.zeros(0)

    def linearise(self) -> None:
        """Linearise the laws at the solution, and give the forms their tangents."""
        with self._friction.off_bounds():
            self._tangent, self._by_bound = self._friction.linearise()

    def hold(self) -> None:
        """Give the forms no tangents: stresses stay as they are."""
        self._friction.give_tangent(np.zeros_like(self._tangent))

    def add_force(self, target: int, b: Any) -> None:
        """Add the force of the changes at fixed present state; ghosts are not yet summed.

        The fields along which earlier states change must be those of this parameter.

        Args:
            target: Number of the parameter.
            b: PETSc's vector.
        """
        self._problem.add_friction_force(b, self._change(target))

    def stress(self, target: int, along: Array) -> Array:
        """Return the changes by parameter ``target``, which changes own unknowns ``along`` (m)."""
        return np.asarray(self._change(target) + self._tangent * self._friction.changes(along))

    def _change(self, target: int) -> Array:
        def change(slopes: tuple[Compiled, list[Compiled]]) -> Array:
            along, by = slopes
            return self._values(along) + self._values(by[target])

        with self._friction.off_bounds():
            excess, strength = change(self._excesses), change(self._strengths)
        return np.asarray(self._tangent * (excess - self._by_bound * strength))

    def _compiled(self, symbols: Sequence[Any]) -> Compiled:
        """Return one expression for each friction; collective."""
        return [f.compiled(s) for f, s in zip(self._frictions, symbols, strict=True)]

    def _values(self, expressions: Compiled) -> Array:
        pairs = zip(self._frictions, expressions, strict=True)
        return self._friction.gathered([f.at_points(e) for f, e in pairs])
