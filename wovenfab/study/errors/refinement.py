"""Errors of values that ever higher degrees, or ever more steps, approach: from these values alone.

The one way in which wovenfab estimates an error by refinement: degrees of elements, numbers of
steps and sizes of cells of a fit are all taken to follow ``limit + C n^-r``.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import copysign

from scipy.optimize import brentq

#: Slowest and fastest convergence that is believed: exponents of degree. Beside a singularity
#: r^l an energy converges like p^-4l (Babuska and Suri 1987), and l is 1/4 at least: where a
#: clamped side of a cut meets its free one.
SLOWEST, FASTEST = 1.0, 40.0
#: Fastest convergence that is believed where four degrees show no faster one, and where the values
#: turn: layers that coarse cells do not resolve let the loss change little from degree 4 to degree
#: 5, and yet be too large. Degree 2 is too soft there and degree 3 too stiff, as is the next.
FASTEST_UNSHOWN = 5.0


def ratio_of_changes(counts: Sequence[float], r: float) -> float:
    """Return the first change over the second of three values that converge like ``n^-r``."""
    low, middle, high = counts
    return float((low**-r - middle**-r) / (middle**-r - high**-r))


def exponent(
    counts: Sequence[float], observed: float, fastest: float, slowest: float = SLOWEST
) -> float:
    """Return the exponent r of convergence that the changes of three values show.

    Args:
        counts: What grows: three degrees, or numbers of steps or of cells, ascending.
        observed: First change over the second.
        fastest: Largest r that is believed.
        slowest: Least one.
    """
    if observed <= ratio_of_changes(counts, slowest):
        return slowest
    most = min(observed, ratio_of_changes(counts, fastest))
    return float(brentq(lambda r: ratio_of_changes(counts, r) - most, slowest, fastest))


def error_of_degrees(
    degrees: Sequence[float], values: Sequence[float], fastest: float = FASTEST
) -> tuple[float, float, float]:
    """Return the errors of three values, as from elements of three degrees on one mesh.

    The values are taken to follow ``limit + C p^-r``, as they do where corners are
    singular; where they converge faster, r comes out large and the error of each is
    nearly its distance from the next. A last change that is smaller than the fastest
    convergence explains is taken to be as large as that: two degrees may agree by chance,
    above all where the values turn. A degree below the three tells more: changes may fall
    geometrically, as those of smooth solutions do.

    Args:
        degrees: Three degrees, or numbers of steps, one after another, or four.
        values: The values.
        fastest: Largest r that is believed.

    Returns:
        Signed errors of the last three, each its value minus the limit.
    """
    three = degrees[-3:]
    *before, first, second = (a - b for a, b in pairwise(values))
    if first * second < 0:
        fastest = min(fastest, FASTEST_UNSHOWN)
    least = abs(first) / ratio_of_changes(three, fastest)
    if before and before[-1]:
        unshown = abs(first) / ratio_of_changes(three, FASTEST_UNSHOWN)
        least = max(least, min(unshown, first**2 / abs(before[-1])))
    if abs(second) < least:
        second = copysign(least, second)
        r = exponent(three, abs(first / second), fastest)
    elif first * second <= 0:  # no trend: the last change is all that is known
        r = fastest if abs(second) <= abs(first) else SLOWEST
    else:
        r = exponent(three, first / second, fastest)
    last = second / ((three[2] / three[1]) ** r - 1)
    return first + second + last, second + last, last
