"""Probes: places on the sheet whose displacement, strain, shear angle or fields are recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from wovenfab.sheet.output_nodes import circle
from wovenfab.sheet.tolerance import SAME_PLACE

Position = tuple[float, float]


@dataclass(frozen=True)
class PointProbe:
    """Displacement of each family, and slip, at a point, on every step.

    Attributes:
        at: Reference position, m.
    """

    at: Position


@dataclass(frozen=True)
class Extensometer:
    """Gauge length between two points, and its strain, on every step.

    Attributes:
        ends: Reference positions, m.
        family: The family, 1 or 2, that it is fixed to; None for the mean of both.
    """

    ends: tuple[Position, Position]
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

    ends: tuple[Position, Position]
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
    through: Position
    points: int = 101

    def ends(
        self, fibres: NDArray[np.float64], corners: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return both ends (m) of the yarn at rest: the piece of it that has the point.

        Args:
            fibres: Direction of each family at rest, shape (2, 2).
            corners: Of all cells of the sheet, shape (cells, 3, 2), m.

        Raises:
            ValueError: The sheet is not where the yarn should be.
        """
        along, point = fibres[self.family - 1], np.array(self.through)
        size = float(np.ptp(corners.reshape(-1, 2), axis=0).sum())
        sheet = shapely.union_all(shapely.polygons(corners))
        for gap in (SAME_PLACE * size, -SAME_PLACE * size):  # cells that touch become one
            sheet = sheet.buffer(gap, join_style="mitre")
        whole = shapely.LineString([point - size * along, point + size * along])
        pieces = shapely.get_parts(shapely.intersection(sheet, whole))
        if not len(pieces):
            raise ValueError(f"the yarn through {self.through} m misses the sheet")
        near = pieces[np.argmin(shapely.distance(pieces, shapely.Point(point)))]
        start, end = shapely.get_coordinates(near)[[0, -1]]
        return start, end


Gauge = PointProbe | Extensometer | Zone
Probe = Gauge | Line | Yarn


def rectangle_zone(one: Position, other: Position) -> Zone:
    """Return the zone of a rectangle by opposite corners (m)."""
    return Zone(shapely.box(*np.min([one, other], axis=0), *np.max([one, other], axis=0)))


def circle_zone(centre: Position, radius: float) -> Zone:
    """Return the zone of a circle (m)."""
    return Zone(circle(centre, radius))
