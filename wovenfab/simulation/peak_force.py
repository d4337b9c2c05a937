"""The peak force between the recorded steps of a run.

``peak_force_N`` is the recorded force of largest size (``record.history.peak_force``). It changes
by chance from one step size to the next, in the same way with every scheme, and so hides errors
of the steps. A study of accuracy compares the interpolated peak, ``peak_force_interpolated_N``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wovenfab.record.history import index_of_peak

Array = NDArray[np.float64]
#: Steps through which a parabola goes, and points between two steps where two are compared.
THREE, BETWEEN = 3, 129


def peak_force_bound(times: Array, forces: Array) -> float:
    """Return the force of largest size that the curve may reach, even by a kink.

    Before and after it the curve goes on as parabolas through three steps each, which meet
    where it is largest, be that smooth or, where friction reverses, nearly a kink. Where
    steps are too long to resolve the curvature, that is too much.

    Args:
        times: Of the steps, s, shape (n,).
        forces: At the steps, N, shape (n,).
    """
    at, sign, sizes = _largest(forces)
    best = float(sizes[at])
    for j in (at - 1, at):
        if j < THREE - 1 or j + THREE >= len(times):
            continue
        t = np.linspace(times[j], times[j + 1], BETWEEN)
        before, after = slice(j - THREE + 1, j + 1), slice(j + 1, j + THREE + 1)
        sides = [_parabola(times[s], sizes[s], times[j])(t - times[j]) for s in (before, after)]
        best = max(best, float(np.minimum(*sides).max()))
    return sign * best


def interpolated_peak_force(times: Array, forces: Array, kinks: Sequence[bool]) -> float:
    """Return the force of largest size that the curve reaches between its steps.

    It is the maximum of the parabola through the largest step and its neighbours, but no more
    than :func:`peak_force_bound`: where friction reverses, that parabola overshoots.

    Args:
        times: Of the steps, s, shape (n,).
        forces: At the steps, N, shape (n,).
        kinks: Whether the velocity jumps there; then the step's own force is taken.
    """
    at, sign, sizes = _largest(forces)
    if at in (0, len(times) - 1) or kinks[at]:
        return float(forces[at])
    around = slice(at - 1, at + 2)
    a, b, c = _parabola(times[around], sizes[around], times[at]).coef
    top = float(c - b * b / (4 * a)) if a else float(sizes[at])
    if THREE <= at < len(times) - THREE:  # there are parabolas before and after
        top = min(top, abs(peak_force_bound(times, forces)))
    return sign * top


def _largest(forces: Array) -> tuple[int, float, Array]:
    """Return which step's force is largest in size, its sign, and forces with that as plus."""
    at = index_of_peak(forces)
    sign = 1.0 if forces[at] >= 0 else -1.0
    return at, sign, sign * np.asarray(forces)


def _parabola(times: Array, values: Array, origin: float) -> np.poly1d:
    return np.poly1d(np.polyfit(times - origin, values, THREE - 1))
