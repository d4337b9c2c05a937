"""How far the yarns of a family have slid, along the line that crosses one through a corner."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from pathlib import Path

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from paper.field import index_at_largest
from wovenfab.case import Rectangle
from wovenfab.record.fields import read_fields
from wovenfab.report.yarns import Triangles

Values = NDArray[np.float64]
#: How far along the yarn through the corner it is crossed (m).
PLACE = 0.1
#: How far the line goes to both sides (m), and its first points beside the yarn.
REACH, BESIDE = 0.06, 1e-5


@dataclass(frozen=True)
class Profile:
    """What is found along the line.

    Attributes:
        distance: From the corner's yarn (m), ascending, shape (n,): below zero the grip
            holds the yarns, above zero they begin at the free edge.
        slid: Displacement of family 1 along its yarns (m), shape (n,).
    """

    distance: Values
    slid: Values

    @property
    def jump(self) -> float:
        """Difference (m) between both sides of the yarn."""
        after = int(np.searchsorted(self.distance, 0))
        return float(self.slid[after] - self.slid[after - 1])


def across(sheet: Rectangle, place: float = PLACE) -> tuple[Values, Values, Values]:
    """Return where family 1's yarn through the corner at the origin is crossed, and how.

    Args:
        sheet: A sheet held at its left edge, its family 1 between 0 and 90 degrees.
        place: How far from the corner (m).

    Returns:
        The place (m), the direction of the yarn, and that of the line towards yarns that
        begin at the free edge below.
    """
    angle = sheet.fibres[0]
    along = np.array([cos(angle), sin(angle)])
    return place * along, along, np.array([sin(angle), -cos(angle)])


def profile(directory: Path, sheet: Rectangle, place: float = PLACE) -> Profile:
    """Return the profile of a run at its largest displacement.

    Args:
        directory: Results directory of a run with two placements.
        sheet: Its sheet.
        place: How far from the corner its yarn is crossed (m).
    """
    stored = read_fields(directory)
    moved = stored.field("displacement_1", index_at_largest(directory, stored))
    side = np.linspace(BESIDE, REACH, 200)
    distance = np.concatenate([-side[::-1], side])
    middle, along, line = across(sheet, place)
    mesh = Triangles(stored.points(), stored.triangles())
    return Profile(distance, sample(mesh, moved @ along, middle + distance[:, None] * line))


def sample(mesh: Triangles, values: Values, points: Values) -> Values:
    """Return a field at points inside a mesh.

    Args:
        mesh: The mesh.
        values: At its points, shape (n,).
        points: Where (m), shape (m, 2); on the side of a triangle either triangle counts.

    Returns:
        Shape (m,).
    """
    surface = mesh.surface()
    surface["values"] = values
    found = pv.PolyData(np.column_stack([points, np.zeros(len(points))])).sample(surface)
    return np.asarray(found["values"], dtype=np.float64)
