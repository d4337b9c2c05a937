"""A field on the sheet at rest, as areas with values: shares, sizes and likeness."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from wovenfab.record.fields import StoredFields, read_fields
from wovenfab.record.history import read_history

Values = NDArray[np.float64]


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
        found: Values = self.values[nearest]
        return found

    def share_near_centre(self, tolerance: float) -> float:
        """Return the share of the sheet where the value is near that in its middle."""
        middle = self.at(self.centres.mean(axis=0, keepdims=True))[0]
        return self.share(np.abs(self.values - middle) <= tolerance * abs(middle))

    def share_near_mean(self, tolerance: float, where: NDArray[np.bool_]) -> float:
        """Return the share of a part of the sheet where the value is near that part's mean."""
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
