"""Where two families first align along a step, in exact arithmetic."""

from __future__ import annotations

from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

#: Digits of the root.
DIGITS = 60


def exact_crossing(f: NDArray[np.float64], df: NDArray[np.float64]) -> float:
    """Return the smallest positive s at which (f_1 + s df_1) × (f_2 + s df_2) = 0.

    The coefficients of the quadratic are rational numbers without any rounding, its root
    has 60 digits.

    Args:
        f: Fibre derivatives (f_1, f_2), shape (2, 2).
        df: Their changes, shape (2, 2).

    Returns:
        Infinity where there is none.
    """
    (p, q), (r, s) = ([[Fraction(float(x)) for x in v] for v in m] for m in (f, df))
    c, b, a = _cross(p, q), _cross(r, q) + _cross(p, s), _cross(r, s)
    discriminant = b * b - 4 * a * c
    if a == 0:
        roots = [-c / b] if b else []
        return float(min((x for x in roots if x > 0), default=np.inf))
    if discriminant < 0:
        return float("inf")
    with localcontext() as context:
        context.prec = DIGITS
        root = _decimal(discriminant).sqrt()
        roots = [(-_decimal(b) + sign * root) / _decimal(2 * a) for sign in (1, -1)]
        return float(min((x for x in roots if x > 0), default=Decimal("Infinity")))


def _cross(a: list[Fraction], b: list[Fraction]) -> Fraction:
    return a[0] * b[1] - a[1] * b[0]


def _decimal(x: Fraction) -> Decimal:
    return Decimal(x.numerator) / Decimal(x.denominator)
