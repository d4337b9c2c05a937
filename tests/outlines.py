"""Outlines of sheets that tests share, in m."""

from __future__ import annotations

import numpy as np

from wovenfab.sheet.outline import Outline, Ring, rectangle_outline

#: Edges that are held.
HOLDS = {"left": "clamp", "right": "clamp"}


def with_hole(segments: int = 24) -> Outline:
    """Return a rectangle with a circular hole."""
    angles = np.linspace(0, -2 * np.pi, segments, endpoint=False)
    hole = np.array([0.4, 0.14]) + 0.05 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return Outline((*rectangle_outline(0.9, 0.3).rings, Ring(hole, (None,) * segments)))


def tee() -> Outline:
    """Return a T with two re-entrant corners at (0.6, 0.3) and (0.3, 0.3)."""
    points = [
        (0, 0),
        (0.9, 0),
        (0.9, 0.3),
        (0.6, 0.3),
        (0.6, 0.5),
        (0.3, 0.5),
        (0.3, 0.3),
        (0, 0.3),
    ]
    names = (None, "right", None, None, None, None, None, "left")
    return Outline((Ring(np.array(points, dtype=float), names),))


SHAPES = {
    "rectangle": rectangle_outline(0.9, 0.3),
    "sides that do not fit": rectangle_outline(0.87, 0.31),
    "hole": with_hole(),
    "re-entrant corners": tee(),
}
