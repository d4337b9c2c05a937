"""The stress of a bounded friction at quadrature points.

Such a stress tau enters the balance as a coefficient, and how it follows the increment b
of the measure over a step is left to the solver. That is the only way for a set-valued
law, where tau is no function of b, and the sound way for a steep one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives
from ufl.constantvalue import Zero

from wovenfab.forms.balance import Balance, first_variation, second_variation
from wovenfab.forms.effect import DualFrictionLaw, Term
from wovenfab.forms.friction import mean_over_angles
from wovenfab.forms.kinematics import Point, point_of, point_variation, shear_angle
from wovenfab.model.assembly import compile_expression, compile_expressions

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FrictionStress:
    """The stress of one bounded friction: its fields, its forms, and values at its points.

    The increment of a step is b = m - m_before for a set-valued law, and rate/c for a
    law of the rate c m + (known history), so that tau works on b in both cases.

    Forms are symbols of UFL. Values are arrays of shape (n,) over this rank's own cells, their
    quadrature points and the components of the measure; what they need is compiled at first use.

    Attributes:
        term: The friction with its parameter values.
        balance: What else the scene is made of.
        stress: tau, a coefficient on a quadrature element of the measure's shape.
        tangent: d tau/d b of the linearised law, the same.
        degree: Degree of the quadrature.
    """

    term: Term
    balance: Balance
    stress: Any
    tangent: Any
    degree: int

    @property
    def size(self) -> int:
        """Number of components of the measure."""
        return int(self.stress.ufl_shape[0])

    @property
    def varies(self) -> bool:
        """Whether the largest stress changes with internal variables or the shear angle."""
        return bool(self.term.effect.memory) or self.term.angle is not None

    @property
    def creeps(self) -> bool:
        """Whether the increment below the largest stress is not zero."""
        return not self.term.effect.set_valued

    def residual(self, test: Any) -> Any:
        """Return the virtual work (J) of the stress on a test field."""
        rows = self._varied(test)
        return sum(self.stress[i] * rows[i] for i in range(self.size)) * self._dx

    def jacobian(self, trial: Any, test: Any) -> Any:
        """Return the tangent of the residual, symmetric."""
        point, s, t = self._point(self.balance.field), self._vary(trial), self._vary(test)
        columns, rows = self._varied(trial), self._varied(test)
        steep = sum(self.tangent[i] * columns[i] * rows[i] for i in range(self.size))
        return (steep + second_variation(self._stressed, point, s, t)) * self._dx

    def increment(self) -> Any:
        """Return b, a vector."""
        return ufl.as_vector(self._components(self._increment()))

    def change(self, step: Any) -> Any:
        """Return how b varies along a displacement field, a vector."""
        return ufl.as_vector(self._varied(step))

    def strength(self) -> Any:
        """Return the largest stress, a scalar."""
        return self._law.strength(self.term.values)

    def mean_strength(self) -> Any:
        """Return the mean of the largest stress over the shear angles of a step, a scalar."""
        angle, rate = self.term.angle, self.balance.rate
        if angle is None:
            return self.strength()
        assert rate is not None
        fibres = self.balance.fibres
        start, end = (
            shear_angle(self._point(u).f, fibres) for u in (rate.history[0], self.balance.field)
        )
        return mean_over_angles(self.strength(), angle, start, start + (end - start) / rate.stage)

    def creep(self) -> Any | None:
        """Return b below the largest stress and its derivative by the stress, a vector of both.

        Shape (2 size,); None for a set-valued law.
        """
        creep, rate = self._law.creep, self.balance.rate
        if creep is None:
            return None
        assert rate is not None
        stresses = [ufl.variable(self.stress[i]) for i in range(self.size)]
        creeps = [creep(t, self.term.values) / rate.weights[0] for t in stresses]
        slopes = [ufl.diff(b, t) for b, t in zip(creeps, stresses, strict=True)]
        return ufl.as_vector([*creeps, *slopes])

    def excess(self) -> Any:
        """Return b less the creep, a vector."""
        increment, creep = self.increment(), self.creep()
        if creep is None:
            return increment
        return increment - ufl.as_vector([creep[i] for i in range(self.size)])

    def loss(self) -> Any:
        """Return the energy (J) that a set-valued law dissipates in the step.

        That is zeta |b| of each component, which is tau b where the law is met and
        is never negative; with the mean of zeta over the step where the shear angle changes it.
        """
        lengths = sum(abs(b) for b in self._components(self._increment()))
        return self.term.weight * self.mean_strength() * lengths * self._dx

    @cached_property
    def areas(self) -> Array:
        """The area that each value stands for, m^2."""
        weights = basix.make_quadrature(basix.CellType.triangle, self.degree)[1]
        scales = self.at_points(self._compiled[2])[::2]
        return np.repeat(scales * np.tile(weights, len(self._cells)), self.size)

    def strengths(self) -> Array:
        """Return the largest stresses zeta."""
        return np.repeat(self.at_points(self._compiled[2])[1::2], self.size)

    def mean_strengths(self) -> Array:
        """Return the means of the largest stresses over the shear angles of the step."""
        if self.term.angle is None or self.creeps:
            return self.strengths()
        return self.at_points(self._compiled_mean)

    def increments(self) -> Array:
        """Return the increments b of the present field."""
        return self.at_points(self._compiled[0])

    def changes(self, direction: Array) -> Array:
        """Return the changes of b along a direction of own unknowns (m); collective."""
        self._direction.x.array[: len(direction)] = direction
        self._direction.x.scatter_forward()
        return self.at_points(self._compiled[1])

    def creeps_and_slopes(self) -> Array:
        """Return the creeps at the present stresses and their slopes by them, shape (2, n)."""
        if not self.creeps:
            return np.zeros((2, self.areas.size))
        values = self.at_points(self._compiled[3]).reshape(-1, 2, self.size)
        return np.swapaxes(values, 0, 1).reshape(2, -1)

    def put(self, function: fem.Function, values: Array) -> None:
        """Give the stress or the tangent its values."""
        rows = function.x.array.reshape(-1, self.size)
        rows[self._dofs] = values.reshape(*self._dofs.shape, self.size)

    def by_cell(self, values: Array) -> Array:
        """Return values in rows, one for each cell."""
        return values.reshape(len(self._cells), -1)

    def compiled(self, symbol: Any) -> fem.Expression | None:
        """Return a scalar or vector as an expression of as many components as the stress.

        Collective; None for zero.
        """
        symbol = expand_derivatives(ufl.as_ufl(symbol))
        if isinstance(symbol, Zero):
            return None
        one = fem.Constant(self._mesh, 1.0)  # FFCx takes no expression that is a plain number
        rows = [one * (symbol[i] if symbol.ufl_shape else symbol) for i in range(self.size)]
        return compile_expression(ufl.as_vector(rows), self._points)

    def at_points(self, expression: fem.Expression | None) -> Array:
        """Return the values of a compiled expression, zero for None."""
        if expression is None:
            return np.zeros(self.areas.size)
        values: Array = expression.eval(self._mesh, self._cells)
        return values.ravel()

    @property
    def _mesh(self) -> Any:
        return self.stress.function_space.mesh

    @property
    def _points(self) -> Array:
        """The points in the reference cell, shape (m, 2)."""
        return np.asarray(basix.make_quadrature(basix.CellType.triangle, self.degree)[0])

    @cached_property
    def _cells(self) -> NDArray[np.int32]:
        """This rank's own cells."""
        return np.arange(self._mesh.topology.index_map(2).size_local, dtype=np.int32)

    @cached_property
    def _dofs(self) -> NDArray[np.int32]:
        """The number of each point in the fields, shape (own cells, m)."""
        dofs: NDArray[np.int32] = self.stress.function_space.dofmap.list[: len(self._cells)]
        return dofs

    @cached_property
    def _direction(self) -> fem.Function:
        return fem.Function(self.balance.field.function_space)

    @cached_property
    def _compiled(self) -> list[fem.Expression]:
        """b, its change along a direction, scale of areas and zeta, and the creep if any."""
        given = ufl.as_vector([abs(ufl.JacobianDeterminant(self._mesh)), self.strength()])
        symbols, creep = [self.increment(), self.change(self._direction), given], self.creep()
        return compile_expressions(symbols if creep is None else [*symbols, creep], self._points)

    @cached_property
    def _compiled_mean(self) -> fem.Expression | None:
        return self.compiled(self.mean_strength())

    @property
    def _law(self) -> DualFrictionLaw:
        law = self.term.effect.bound
        assert law is not None
        return law

    @property
    def _dx(self) -> Any:
        return ufl.dx(metadata={"quadrature_degree": self.degree, "quadrature_scheme": "default"})

    def _increment(self) -> Any:
        effect, rate = self.term.effect, self.balance.rate
        assert rate is not None and effect.measure is not None
        now = self._point(self.balance.field)
        if effect.set_valued:
            return effect.measure(now) - effect.measure(self._point(rate.history[0]))
        return self.balance.rate_of(effect, now) / rate.weights[0]

    def _components(self, measure: Any) -> list[Any]:
        return [measure] if measure.ufl_shape == () else [measure[i] for i in range(self.size)]

    def _measured(self, point: Point) -> list[Any]:
        assert self.term.effect.measure is not None
        return self._components(self.term.effect.measure(point))

    def _stressed(self, point: Point) -> Any:
        return sum(self.stress[i] * m for i, m in enumerate(self._measured(point)))

    def _varied(self, field: Any) -> list[Any]:
        point, along = self._point(self.balance.field), self._vary(field)
        return [first_variation(self._component(i), point, along) for i in range(self.size)]

    def _component(self, number: int) -> Callable[[Point], Any]:
        return lambda point: self._measured(point)[number]

    def _point(self, field: Any) -> Point:
        return point_of(field, self.balance.fibres, self.balance.second_gradient)

    def _vary(self, field: Any) -> Sequence[Any]:
        return point_variation(field, self.balance.fibres, self.balance.second_gradient)
