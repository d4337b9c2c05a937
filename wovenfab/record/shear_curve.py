"""Figures of a normalised shear force against a shear angle, of any test that gives such a curve.

Source: J. Cao and others, Characterization of mechanical behavior of woven fabrics: experimental
methods and benchmark results, Composites Part A 39 (2008), doi:10.1016/j.compositesa.2008.02.016.
"""

from __future__ import annotations

from math import nan

import numpy as np
from numpy.typing import NDArray

from wovenfab.record.figures import Columns, Figure, figure
from wovenfab.record.loop import LOOP_ENERGY, Branch, Loop

Values = NDArray[np.float64]
#: Parts of the largest angle between which the chords of the locking angle lie.
FIRST, LAST = (0.1, 0.2), (0.9, 1.0)
#: Times the slope at the end is at least that at the beginning where yarns lock.
STEEPER = 2.0
LOCKING = (
    "where the line through the curve at 0.9 and 1 of the largest angle on the first way out meets "
    "that through it at 0.1 and 0.2"
)


def locking_angle(out: Branch | None) -> float:
    """Return the shear angle (rad) at which yarns begin to lock.

    It is where two chords of the curve meet, one of its beginning and one of its end: the usual
    construction by two lines, with a choice of points. It depends on the largest angle.

    Args:
        out: Normalised shear force against angle on the first way out.

    Returns:
        NaN where the end is less than twice as steep as the beginning, or a force is not known.
    """
    if out is None:
        return nan
    end = float(out.strain[-1])
    lines = []
    for angles in ([part * end for part in chord] for chord in (FIRST, LAST)):
        forces = [out.at(angle) for angle in angles]
        slope = (forces[1] - forces[0]) / (angles[1] - angles[0])
        lines.append((slope, forces[1] - slope * angles[1]))
    (first, at_first), (last, at_last) = lines
    return (at_first - at_last) / (last - first) if last > STEEPER * first else nan


def shear_figures(loop: Loop, measured: Values | None) -> dict[str, Figure]:
    """Return locking angle, largest angles, the force there and the loop energy by name.

    Args:
        loop: Normalised shear force against the kinematic shear angle.
        measured: The shear angle (rad) that a zone measures, of the same shape; None without.
    """
    known = np.flatnonzero(np.isfinite(loop.strain))
    end = int(known[loop.strain[known].argmax()])
    out = loop.way_out(float(loop.strain[end])) if loop.strain[end] > 0 else None
    found = {
        "locking angle": figure(locking_angle(out), "rad", LOCKING),
        "largest angle": figure(loop.strain[end], "rad", "largest kinematic shear angle"),
        "shear force": figure(loop.force[end], "N/m", "normalised shear force at that angle"),
        "loop energy": figure(loop.closed_work(), "J/m^2", LOOP_ENERGY),
    }
    if measured is not None:
        words = "shear angle that the zone measures at the largest kinematic one"
        found["measured angle"] = figure(measured[end], "rad", words)
    return found


def shear_curve(loop: Loop, measured: Values | None) -> dict[str, Values]:
    """Return the curve by columns; arguments as of :func:`shear_figures`."""
    seen = {} if measured is None else {"shear_angle_measured_rad": measured}
    return {
        "shear_angle_kinematic_rad": loop.strain,
        **seen,
        "normalised_shear_force_N_per_m": loop.force,
    }


def measured_angle(zone: str | None, sign: float, history: Columns) -> Values | None:
    """Return the shear angle of a zone (rad), positive as the kinematic one; None without a zone.

    Args:
        zone: Name of a probe of the history.
        sign: Of the kinematic angle where the angle of the families is positive.
        history: Columns of ``history.csv``.
    """
    return None if zone is None else sign * history[f"{zone}_shear_angle_rad"]
