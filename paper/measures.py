"""Measures of a run: loops of force, fields at the largest displacement, and jumps across yarns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import cos, sin
from pathlib import Path

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wovenfab.case import Rectangle
from wovenfab.record.fields import StoredFields, read_fields
from wovenfab.record.history import peak_force, read_history
from wovenfab.record.summary import window
from wovenfab.report.yarns import Triangles

Values = NDArray[np.float64]
#: Share of the amplitude at the points of a loop.
WAY = np.linspace(0.0, 1.0, 401)


@dataclass(frozen=True)
class Loop:
    """A loop.

    Attributes:
        amplitude: Largest displacement (m).
        out: Force (N) on the way out at the displacements ``WAY * amplitude``.
        back: Force (N) on the way back at the same displacements.
        peak: Recorded force (N) of largest size.
        dissipated: Energy lost (J).
    """

    amplitude: float
    out: Values
    back: Values
    peak: float
    dissipated: float

    @property
    def nonlinearity(self) -> float:
        """Rise of the loop's middle over the second half of the way, over that of the first.

        One for a straight line, more where the sheet stiffens. The middle of both ways is
        free of most of the friction.
        """
        start, half, end = (np.interp(s, WAY, (self.out + self.back) / 2) for s in (0, 0.5, 1))
        return float((end - half) / (half - start))

    def width(self, share: float) -> float:
        """Return the force (N) on the way out less that on the way back at a share of the way."""
        return float(np.interp(share, WAY, self.out - self.back))

    def distance(self, other: Loop) -> float:
        """Return the largest difference in force, in parts of the peak force."""
        difference = max(np.abs(self.out - other.out).max(), np.abs(self.back - other.back).max())
        return float(difference / abs(self.peak))


def loops_of(history: Mapping[str, Values], spans: Iterable[tuple[float, float]]) -> list[Loop]:
    """Return the loop of each cycle.

    Args:
        history: Columns of ``history.csv``.
        spans: Times (s) at which each cycle begins and ends; it begins and ends at rest.
    """
    return [_loop(window(history, start, end)) for start, end in spans]


def _loop(part: Mapping[str, Values]) -> Loop:
    u, force, lost = part["displacement_m"], part["force_N"], part["dissipated_J"]
    turn = int(u.argmax())
    where = WAY * u[turn]
    return Loop(
        amplitude=float(u[turn]),
        out=np.interp(where, u[: turn + 1], force[: turn + 1]),
        back=np.interp(where, u[turn:][::-1], force[turn:][::-1]),
        peak=peak_force(force),
        dissipated=float(lost[-1] - lost[0]),
    )


@dataclass(frozen=True)
class Field:
    """A scalar field at one time, one value a triangle.

    Attributes:
        centres: Centres of the triangles at rest (m), shape (n, 2).
        areas: Their areas at rest (m^2), shape (n,).
        values: Mean value in each (SI), shape (n,).
    """

    centres: Values
    areas: Values
    values: Values

    @property
    def shares(self) -> Values:
        """Each triangle's share of the sheet."""
        shares: Values = self.areas / self.areas.sum()
        return shares

    def share(self, where: NDArray[np.bool_]) -> float:
        """Return the share of the sheet that some triangles make."""
        return float(self.shares[where].sum())

    def mean(self) -> float:
        """Return the mean value."""
        return float(self.shares @ self.values)

    def size(self) -> float:
        """Return the value that 99.5 % of the sheet stay below, which no corner decides."""
        order = np.argsort(self.values)
        below = np.cumsum(self.shares[order])
        return float(self.values[order][np.searchsorted(below, 0.995)])

    def at(self, points: Values) -> Values:
        """Return the values at points (m), shape (m, 2)."""
        _, nearest = cKDTree(self.centres).query(points)
        return np.asarray(self.values[nearest])

    def share_near_centre(self, tolerance: float) -> float:
        """Return the share of the sheet where the value is close to that in its middle."""
        middle = self.at(self.centres.mean(axis=0, keepdims=True))[0]
        return self.share(np.abs(self.values - middle) <= tolerance * abs(middle))

    def share_near_mean(self, tolerance: float, where: NDArray[np.bool_]) -> float:
        """Return the share of a part of the sheet where the value is close to that part's mean."""
        part = Field(self.centres[where], self.areas[where], self.values[where])
        return part.share(np.abs(part.values - part.mean()) <= tolerance * abs(part.mean()))

    def share_with_most(self, part: float) -> float:
        """Return the smallest share of the sheet that has a part of the field's square."""
        weight = self.areas * self.values**2
        order = np.argsort(-self.values)
        held = np.cumsum(weight[order]) / weight.sum()
        return float(np.cumsum(self.shares[order])[np.searchsorted(held, part)])


def likeness(one: Field, other: Field, length: float, width: float) -> float:
    """Return the correlation of two fields over the part of both sheets next to the origin.

    Args:
        one: A field.
        other: Another.
        length: How far the part goes along x (m).
        width: How far it goes along y (m).
    """
    steps = (np.arange(60) + 0.5) / 60
    points = np.stack(np.meshgrid(steps * length, steps * width), axis=-1).reshape(-1, 2)
    return float(np.corrcoef(one.at(points), other.at(points))[0, 1])


def field_at_largest(directory: Path, name: str) -> Field:
    """Return a stored field of a run at its largest displacement.

    Args:
        directory: Results directory.
        name: Name of a scalar field.
    """
    stored = read_fields(directory)
    triangles = stored.triangles()
    corners = stored.points()[triangles]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return Field(
        centres=corners.mean(axis=1),
        areas=np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2,
        values=stored.field(name, index_at_largest(directory, stored))[triangles].mean(axis=1),
    )


def index_at_largest(directory: Path, stored: StoredFields) -> int:
    """Return which of the stored times of a run is that of its largest displacement."""
    history = read_history(directory)
    u = np.interp(stored.times, history["time_s"], history["displacement_m"])
    return int(u.argmax())


#: How far along the yarn through the corner it is crossed (m).
PLACE = 0.1
#: How far the line goes to both sides (m), and its first points beside the yarn.
REACH, BESIDE = 0.06, 1e-5


@dataclass(frozen=True)
class Profile:
    """The displacement along the line.

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
    space = np.column_stack([mesh.points, np.zeros(len(mesh.points))])
    surface = pv.PolyData.from_regular_faces(space, mesh.triangles)
    surface["values"] = values
    sampled = pv.PolyData(np.column_stack([points, np.zeros(len(points))])).sample(surface)
    return np.asarray(sampled["values"], dtype=np.float64)
