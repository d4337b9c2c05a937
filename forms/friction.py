"""Coulomb's law and its smooth approximation, from the rate and from the stress."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import ufl

from wovenfab.forms.balance import Balance
from wovenfab.forms.effect import DualFrictionLaw, Term, Values
from wovenfab.forms.kinematics import point_of


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


def components_of(term: Term, balance: Balance) -> int:
    """Return the number of components of a friction's measure."""
    assert term.effect.measure is not None
    point = point_of(balance.field, balance.fibres, balance.second_gradient)
    shape = term.effect.measure(point).ufl_shape
    return int(shape[0]) if shape else 1
