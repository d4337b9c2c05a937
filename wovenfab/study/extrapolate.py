"""How far from its limit a sequence of answers is."""

from __future__ import annotations

from collections.abc import Sequence

from scipy.optimize import brentq

#: Slowest and fastest convergence that is believed: exponents of degree. Beside a singularity
#: r^l an energy converges like p^-4l (Babuska and Suri 1987), and l is 1/4 at least: where a
#: clamped side of a cut meets its free one.
SLOWEST, FASTEST = 1.0, 40.0


def error_of_degrees(degrees: Sequence[int], values: Sequence[float]) -> tuple[float, float, float]:
    """Return the errors of three answers from elements of three degrees on one mesh.

    The answers are taken to follow ``limit + C p^-r``, as they do where corners are
    singular; where they converge faster, r comes out large and the error of each is
    nearly its distance from the next.

    Args:
        degrees: Three degrees, one after another.
        values: The answers.

    Returns:
        Signed errors of the three, each its answer minus the limit.
    """
    low, middle, high = degrees
    first, second = values[0] - values[1], values[1] - values[2]

    def ratio(r: float) -> float:
        return float((low**-r - middle**-r) / (middle**-r - high**-r))

    if first * second <= 0:  # no trend: the last change is all that is known
        r = FASTEST if abs(second) <= abs(first) else SLOWEST
    else:
        found = first / second
        if found <= ratio(SLOWEST):
            r = SLOWEST
        elif found >= ratio(FASTEST):
            r = FASTEST
        else:
            r = float(brentq(lambda s: ratio(s) - found, SLOWEST, FASTEST))
    last = second / ((high / middle) ** r - 1)
    return first + second + last, second + last, last


def error_of_steps(
    steps: tuple[int, int], values: tuple[float, float], order: int
) -> tuple[float, float]:
    """Return the errors of two answers from two numbers of steps (Richardson).

    Args:
        steps: The fewer, the more.
        values: The answers.
        order: Order of the scheme.
    """
    gain = (steps[1] / steps[0]) ** order
    second = (values[0] - values[1]) / (gain - 1)
    return gain * second, second
