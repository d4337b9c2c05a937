"""Coulomb's law and its smooth stand-in, which both kinds of friction share."""

from __future__ import annotations

from typing import Any

import ufl

from forms.effect import Bound, Values


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


def _strength(values: Values) -> Any:
    return values["strength"]


def _creep(stress: Any, values: Values) -> Any:
    """Return the rate artanh(stress/zeta)/eta."""
    zeta = values["strength"]
    return ufl.ln((zeta + stress) / (zeta - stress)) / (2 * values["slope"])


#: The smooth law from the stress, and Coulomb's: no rate below the strength, any at it.
SMOOTH, COULOMB = Bound(_strength, _creep), Bound(_strength)
