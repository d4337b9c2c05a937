"""The error of a value that a ladder of ever finer settings approaches, from the ladder alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import expm1, inf, isfinite, log

from scipy.optimize import brentq

#: Observed orders outside are not believed, and the last difference stands for the error.
LEAST_ORDER, MOST_ORDER = 0.3, 12.0
#: Below this share of the value differences are Newton's tolerance and round-off.
ROUND_OFF = 1e-8


@dataclass(frozen=True)
class Ladder:
    """Values of one quantity by one method, from coarse to fine.

    Attributes:
        method: Its name.
        sizes: What goes to zero: 1/sqrt(unknowns), 1/steps or sqrt(tolerance), descending.
        values: The quantity.
        order: Order in theory at best; a higher one is chance, and is not extrapolated with.
        regular: Whether each setting is finer than the last everywhere and alike; else the order
            that shows is chance, too.
    """

    method: str
    sizes: tuple[float, ...]
    values: tuple[float, ...]
    order: float
    regular: bool = True


@dataclass(frozen=True)
class Best:
    """The best answer that is known.

    Attributes:
        value: The quantity.
        error: Estimated error, in its unit.
        method: The method that gave it.
        check: The other method that it was compared with, or nothing.
    """

    value: float
    error: float
    method: str
    check: str = ""

    @property
    def relative(self) -> float:
        """Estimated error as a share of the value."""
        return self.error / abs(self.value) if self.value else inf


def best_of(ladders: Sequence[Ladder]) -> Best:
    """Return the finest value of the method that converges best, with its error.

    The error is what Richardson's extrapolation of the method's own three finest values
    says, and more if the next best method, by an independent discretisation, is farther
    away than that one's own error explains. A method that approaches from one side explains
    nothing on the side it comes from.

    Args:
        ladders: One a method, none empty.
    """
    ranked = sorted(ladders, key=own_error)
    first = ranked[0]
    value, error = first.values[-1], own_error(first)
    second = ranked[1] if len(ranked) > 1 else None
    if second is None or not isfinite(other := own_error(second)):
        return Best(value, error, first.method)
    apart = abs(value - second.values[-1])
    if not _lies_ahead(second, value):
        other = 0.0
    return Best(value, max(error, apart - other), first.method, second.method)


def _lies_ahead(ladder: Ladder, value: float) -> bool:
    """Return whether a value is where a ladder goes: everywhere if it shows no order."""
    if len(ladder.values) < 3 or order_of(ladder.sizes[-3:], ladder.values[-3:]) is None:
        return True
    return (ladder.values[-1] - ladder.values[-2]) * (value - ladder.values[-1]) > 0


def own_error(ladder: Ladder) -> float:
    """Return the error of a ladder's finest value that its last three values suggest.

    Richardson: with order p and ratio r of sizes, |v_n - v_{n-1}| / (r^p - 1), and not less than
    what the difference before leads to expect. Where no order shows, the larger of the two
    differences; of two values order 1 is assumed; of one nothing is known.
    """
    sizes, values = ladder.sizes[-3:], ladder.values[-3:]
    if len(values) < 2:
        return inf
    floor = ROUND_OFF * abs(values[-1])
    last, ratio = abs(values[-1] - values[-2]), sizes[-2] / sizes[-1]
    if len(values) == 2:
        return max(last / (ratio - 1), floor)
    before, ratio_before = abs(values[-2] - values[-3]), sizes[-3] / sizes[-2]
    order = order_of(sizes, values) if ladder.regular else None
    if order is None:
        return max(last, before, floor)
    p = min(order, ladder.order)
    expected = before / (ratio_before**p - 1) / ratio**p
    error: float = max(last / (ratio**p - 1), expected, floor)
    return error


def order_of(sizes: Sequence[float], values: Sequence[float]) -> float | None:
    """Return the order p with which three values approach their limit, or None without one.

    Solves (v_1 - v_2) / (v_2 - v_3) = (h_1^p - h_2^p) / (h_2^p - h_3^p) for sizes of any ratio.
    """
    first, last = values[0] - values[1], values[1] - values[2]
    if abs(last) <= ROUND_OFF * abs(values[2]) or first / last <= 0:
        return None
    a, b = log(sizes[0] / sizes[1]), log(sizes[1] / sizes[2])

    def excess(p: float) -> float:
        # (h_1/h_2)^p - 1 over 1 - (h_3/h_2)^p
        found: float = log(expm1(p * a) / -expm1(-p * b) * last / first)
        return found

    if excess(LEAST_ORDER) > 0 or excess(MOST_ORDER) < 0:
        return None
    order = brentq(excess, LEAST_ORDER, MOST_ORDER, xtol=1e-6)
    return float(order)


def orders_towards(limit: float, ladder: Ladder) -> list[float | None]:
    """Return the order between neighbours of a ladder, from their distances to the limit."""
    found: list[float | None] = []
    points = list(zip(ladder.sizes, (abs(v - limit) for v in ladder.values), strict=True))
    for (h0, e0), (h1, e1) in pairwise(points):
        found.append(log(e0 / e1) / log(h0 / h1) if e0 > 0 and e1 > 0 else None)
    return found


def worst(errors: Mapping[str, float]) -> float:
    """Return the largest of the errors of several quantities."""
    return max(errors.values(), default=inf)
