"""Probes: places on the sheet whose displacement, strain, shear angle or fields are recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from wovenfab.sheet.lattice import circle

Place = tuple[float, float]


@dataclass(frozen=True)
class Point:
    """Displacement of each family, and slip, at a point, on every step.

    Attributes:
        at: Reference position, m.
    """

    at: Place


@dataclass(frozen=True)
class Extensometer:
    """Gauge length between two points, and its strain, on every step.

    Attributes:
        ends: Reference positions, m.
        family: The family, 1 or 2, that it is fixed to; None for the mean of both.
    """

    ends: tuple[Place, Place]
    family: int | None = None


@dataclass(frozen=True)
class Zone:
    """Mean shear angle over the area of a region, on every step.

    Attributes:
        region: The region at rest, m.
    """

    region: shapely.Polygon


@dataclass(frozen=True)
class Line:
    """All stored fields along a straight line, whenever fields are stored.

    Attributes:
        ends: Reference positions, m.
        points: Number of equidistant points.
    """

    ends: tuple[Place, Place]
    points: int = 101


@dataclass(frozen=True)
class Yarn:
    """All stored fields along a yarn from edge to edge, whenever fields are stored.

    Attributes:
        family: 1 or 2.
        through: Reference position of a point of it, m.
        points: Number of equidistant points.
    """

    family: int
    through: Place
    points: int = 101


Gauge = Point | Extensometer | Zone
Probe = Gauge | Line | Yarn


def rectangle_zone(one: Place, other: Place) -> Zone:
    """Return the zone of a rectangle by opposite corners (m)."""
    return Zone(shapely.box(*np.min([one, other], axis=0), *np.max([one, other], axis=0)))


def circle_zone(centre: Place, radius: float) -> Zone:
    """Return the zone of a circle (m)."""
    return Zone(circle(centre, radius))
