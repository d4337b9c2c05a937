"""Coulomb's law, its smooth approximation, and friction with its stress at quadrature points.

Such a stress tau enters the balance as a coefficient, and how it follows the increment b
of the measure over a step is left to the solver. That is the only way for a set-valued
law, where tau is no function of b, and the sound way for a steep one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import ufl

from wovenfab.forms.balance import Balance, first_variation, second_variation
from wovenfab.forms.effect import DualFrictionLaw, Term, Values
from wovenfab.forms.kinematics import Point, point_of, point_variation


def log_cosh(x: Any) -> Any:
    """Return log(cosh(x)) without overflow for any ``x``.

    The sign is a constant for differentiation, so that the second derivative is
    right at x = 0, where that of UFL's ``abs`` is not.
    """
    size = ufl.conditional(ufl.ge(x, 0), 1.0, -1.0) * x
    return size + ufl.ln(1 + ufl.exp(-2 * size)) - ufl.ln(2.0)


def smoothed_coulomb(rate: Any, strength: Any, slope: Any) -> Any:
    """Return zeta/eta log cosh(eta rate), whose derivative is zeta tanh(eta rate).

    Args:
        rate: Scalar rate.
        strength: Largest friction zeta, reached at high rates.
        slope: eta, the inverse of the rate at which friction saturates.
    """
    return strength / slope * log_cosh(slope * rate)


def smooth_bound(strength: Callable[[Values], Any]) -> DualFrictionLaw:
    """Return the smooth law from the stress, with a strength zeta and a slope eta of the values."""
    return DualFrictionLaw(strength, partial(_creep, strength))


def _creep(strength: Callable[[Values], Any], stress: Any, values: Values) -> Any:
    """Return the rate artanh(stress/zeta)/eta."""
    zeta = strength(values)
    return ufl.ln((zeta + stress) / (zeta - stress)) / (2 * values["slope"])


def _strength(values: Values) -> Any:
    return values["strength"]


#: The smooth law from the stress, and Coulomb's: no rate below the strength, any at it.
SMOOTH, COULOMB = smooth_bound(_strength), DualFrictionLaw(_strength)


@dataclass(frozen=True)
class PointFriction:
    """A bounded friction of a scene with its stress as a coefficient.

    The increment of a step is b = m - m_before for a set-valued law, and rate/c for a
    law of the rate c m + (known history), so that tau works on b in both cases.

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
        return self._bound.strength(self.term.values)

    def creep(self) -> Any | None:
        """Return b below the bound and its derivative by the stress, a vector of both.

        Shape (2 size,); None for a set-valued law.
        """
        creep, rate = self._bound.creep, self.balance.rate
        if creep is None:
            return None
        assert rate is not None
        stresses = [ufl.variable(self.stress[i]) for i in range(self.size)]
        creeps = [creep(t, self.term.values) / rate.weights[0] for t in stresses]
        slopes = [ufl.diff(b, t) for b, t in zip(creeps, stresses, strict=True)]
        return ufl.as_vector([*creeps, *slopes])

    def excess(self) -> Any:
        """Return b less the creep below the bound, a vector."""
        increment, creep = self.increment(), self.creep()
        if creep is None:
            return increment
        return increment - ufl.as_vector([creep[i] for i in range(self.size)])

    def loss(self) -> Any:
        """Return the energy (J) that a set-valued law dissipates in the step.

        That is zeta |b| of each component, which is tau b where the law is met and
        is never negative.
        """
        lengths = sum(abs(b) for b in self._components(self._increment()))
        return self.term.weight * self.strength() * lengths * self._dx

    @property
    def _bound(self) -> Any:
        return self.term.effect.bound

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


def components_of(term: Term, balance: Balance) -> int:
    """Return the number of components of a friction's measure."""
    assert term.effect.measure is not None
    point = point_of(balance.field, balance.fibres, balance.second_gradient)
    shape = term.effect.measure(point).ufl_shape
    return int(shape[0]) if shape else 1
