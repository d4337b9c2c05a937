"""Derivatives of a balance by material parameters and by earlier states, as symbols.

A step solves R(u, earlier states; p) = 0. Its derivative by a parameter p is the tangent-linear
equation

    dR/du du/dp = - dR/dp - sum_j dR/du_j du_j/dp,

whose two parts on the right are the forms of this module. They come from the same potentials as
the balance itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import ufl

from forms.balance import Balance
from forms.effect import Term
from forms.friction import PointFriction


@dataclass(frozen=True)
class Target:
    """A material parameter that something is differentiated by.

    Attributes:
        effect: Name of its effect.
        parameter: Name of the parameter.
        families: The families whose values follow it, 0, 1 or both; it is ignored where both
            have the same one.
        direction: Derivative of the value by the parameter, from the reference position: 1
            unless the value is a formula of several parameters.
    """

    effect: str
    parameter: str
    families: tuple[int, ...] = (0, 1)
    direction: Callable[[Any], Any] | None = None

    def __str__(self) -> str:
        """Return ``effect.parameter``, and the family if it is one of two."""
        name = f"{self.effect}.{self.parameter}"
        return name if len(self.families) == 2 else f"{name}[{self.families[0] + 1}]"


def by_parameter(target: Target, terms: Sequence[Term], form: Callable[[Term], Any]) -> Any | None:
    """Return the derivative of a form by a parameter; None if the form does not depend on it.

    Args:
        target: The parameter.
        terms: The effects, of which one may have it.
        form: Returns the form, or an expression, of one effect.
    """
    for term in terms:
        if term.effect.name == target.effect and target.parameter in term.values:
            return _derivative(target, term, form)
    return None


def _derivative(target: Target, term: Term, form: Callable[[Term], Any]) -> Any | None:
    value = term.values[target.parameter]
    per_family = isinstance(value, tuple)
    values = list(value) if per_family else [value]
    chosen = target.families if per_family else (0,)
    for family in chosen:
        values[family] = ufl.variable(values[family])
    named = {**term.values, target.parameter: tuple(values) if per_family else values[0]}
    total = form(replace(term, values=named))
    if total is None:
        return None
    parts = [_scaled(ufl.diff(total, values[family]), target, values) for family in chosen]
    return sum(parts[1:], parts[0])


def _scaled(form: Any, target: Target, values: Sequence[Any]) -> Any:
    if target.direction is None:
        return form
    mesh = ufl.domain.extract_unique_domain(values[0].ufl_operands[0])
    return target.direction(ufl.SpatialCoordinate(mesh)) * form


@dataclass(frozen=True)
class BalanceDerivatives:
    """Derivatives of a balance.

    Attributes:
        balance: The balance.
    """

    balance: Balance

    def residual(self, target: Target, test: Any) -> Any | None:
        """Return the derivative of the residual inside the sheet by a parameter (N by its unit)."""
        return by_parameter(
            target, self.balance.terms, lambda term: self._alone(term).residual(test)
        )

    def line_residual(self, target: Target, family: int, field: Any, test: Any) -> Any | None:
        """Return the same of what stands on facets and edges, for one family."""

        def form(term: Term) -> Any | None:
            lines = self._alone(term).lines(family, field)
            return sum(line.residual(test) for line in lines) if lines else None

        return by_parameter(target, self.balance.terms, form)

    def residual_along(self, directions: Sequence[Any], test: Any) -> Any | None:
        """Return how the residual changes along fields of the earlier states, one for each."""
        lossy = self._with_rates()
        if lossy is None:
            return None
        assert self.balance.rate is not None
        form = lossy.residual(test)
        pairs = zip(self.balance.rate.history, directions, strict=True)
        return sum(ufl.derivative(form, state, along) for state, along in pairs)

    def power(self, target: Target) -> Any | None:
        """Return the derivative of the dissipated power by a parameter (W by its unit)."""
        return by_parameter(target, self.balance.terms, lambda term: self._alone(term).power())

    def power_along(self, now: Any, directions: Sequence[Any]) -> Any | None:
        """Return how the dissipated power (W) changes along fields of all states.

        Args:
            now: Change of the present state.
            directions: Changes of the earlier ones.
        """
        power = self.balance.power()
        if power is None:
            return None
        assert self.balance.rate is not None
        pairs = zip(
            (self.balance.field, *self.balance.rate.history), (now, *directions), strict=True
        )
        return sum(ufl.derivative(power, state, along) for state, along in pairs)

    def _alone(self, term: Term) -> Balance:
        """Return the balance of one effect, without loads."""
        return replace(self.balance, terms=(term,), loads=())

    def _with_rates(self) -> Balance | None:
        terms = tuple(t for t in self.balance.terms if t.effect.dissipation is not None)
        return replace(self.balance, terms=terms, loads=()) if terms else None


def strength_by(target: Target, friction: PointFriction) -> Any | None:
    """Return the derivative of a point friction's largest stress by a parameter, a scalar."""
    return by_parameter(target, [friction.term], lambda t: replace(friction, term=t).strength())


def creep_by(target: Target, friction: PointFriction) -> Any | None:
    """Return that of its creep, shape (components,); None for a set-valued law."""
    size = friction.size

    def creep(term: Term) -> Any | None:
        return replace(friction, term=term).creep()

    whole = by_parameter(target, [friction.term], creep)
    return None if whole is None else ufl.as_vector([whole[i] for i in range(size)])


def increment_along(friction: PointFriction, directions: Sequence[Any]) -> Any:
    """Return how the increment b changes along fields of the earlier states, a vector."""
    assert friction.balance.rate is not None
    pairs = zip(friction.balance.rate.history, directions, strict=True)
    increment = friction.increment()
    return sum(
        (ufl.derivative(increment, state, along) for state, along in pairs),
        ufl.zero(increment.ufl_shape),
    )


def loss_by(target: Target, friction: PointFriction) -> Any | None:
    """Return the derivative of the energy that a set-valued law dissipates in the step."""
    return by_parameter(target, [friction.term], lambda t: replace(friction, term=t).loss())


def loss_along(friction: PointFriction, now: Any, directions: Sequence[Any]) -> Any:
    """Return how that energy (J) changes along fields of all states."""
    balance = friction.balance
    assert balance.rate is not None
    pairs = zip((balance.field, *balance.rate.history), (now, *directions), strict=True)
    return sum(ufl.derivative(friction.loss(), state, along) for state, along in pairs)
