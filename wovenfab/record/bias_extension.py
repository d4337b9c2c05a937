"""Evaluation of a bias-extension test as laboratories do it.

The yarns are taken as inextensible and pinned where they cross. The sheet then has zones of
equal shear: none at the grips, gamma in the centre, where both families end at free edges, and
gamma/2 between them. Source: J. Cao and others, Characterization of mechanical behavior of
woven fabrics: experimental methods and benchmark results, Composites Part A 39 (2008).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wovenfab.case import Case, Component, Rectangle
from wovenfab.case.boundary import Boundary
from wovenfab.record.field_file import DATA
from wovenfab.record.fields import read_fields

Values = NDArray[np.float64]
#: Edges across x and across y, first the one at the lower coordinate.
_EDGES = (("left", "right"), ("bottom", "top"))


@dataclass(frozen=True)
class BiasExtension:
    """A rectangle with yarns at 45 degrees to its long side, held at its short edges.

    Attributes:
        length, width: Its sides (m); the length is twice the width at least.
        axis: 0 if the long side is along x, 1 if along y.
        factor: Elongation per displacement of the program.
        offset: Elongation (m) at zero displacement.
    """

    length: float
    width: float
    axis: int
    factor: float
    offset: float

    def elongation(self, displacement: Values) -> Values:
        """Return the increase of the distance of the grips (m) for displacements (m)."""
        return self.factor * displacement + self.offset

    def tension(self, force: Values) -> Values:
        """Return the tension between the grips (N) for forces along the program (N)."""
        return force if self.factor > 0 else -force

    def shear_angle(self, elongation: Values) -> Values:
        """Return gamma = 90 deg - 2 acos((L0 + d) / (sqrt(2) L0)) in the central zone (rad).

        Args:
            elongation: d (m), any shape; L0 is length - width.

        Returns:
            The same shape; NaN beyond the elongation at which the yarns lie side by side.
        """
        span = self.length - self.width
        cosine = (span + np.asarray(elongation)) / (sqrt(2) * span)
        angle: Values = pi / 2 - 2 * np.arccos(np.where(np.abs(cosine) <= 1, cosine, np.nan))
        return angle

    def shear_force(self, angle: Values, tension: Values) -> Values:
        """Return the normalised shear force F_sh (N/m) for loading from zero.

        The work of the grips is that of a shear force per length in both zones (Cao and
        others, 2008), with H the length, W the width and F the tension:
        ``(2H - 3W) cos(gamma) F_sh(gamma) + W cos(gamma/2) F_sh(gamma/2)
        = (H/W - 1) F (cos(gamma/2) - sin(gamma/2))``. F_sh(gamma/2) is interpolated between
        the angles given, which makes it a system of linear equations.

        Args:
            angle: gamma (rad), ascending from zero, shape (n,).
            tension: F (N), shape (n,).

        Returns:
            Shape (n,).
        """
        half = angle / 2
        interpolation = np.array([np.interp(half, angle, unit) for unit in np.eye(len(angle))]).T
        h, w = self.length, self.width
        right = (h / w - 1) * tension * (np.cos(half) - np.sin(half))
        matrix = np.diag((2 * h - 3 * w) * np.cos(angle))
        force: Values = np.linalg.solve(matrix + w * np.cos(half)[:, None] * interpolation, right)
        return force

    def in_centre(self, points: Values) -> NDArray[np.bool_]:
        """Return which reference points (m), shape (n, 2), are in the central zone, shape (n,)."""
        along, across = points[:, self.axis], points[:, 1 - self.axis]
        distance = np.minimum(along, self.length - along)
        free: NDArray[np.bool_] = distance > self.width / 2 + np.abs(across - self.width / 2)
        return free


def bias_extension_of(case: Case) -> BiasExtension | None:
    """Return the specimen if the case is a bias-extension test, else None.

    It is one if the sheet is a rectangle at least twice as long as wide with both families
    at 45 degrees to its sides, both short edges are held along and across for both families
    without a formula, the program parts them along the long side, and other edges are free.
    """
    sheet = case.sheet
    if not isinstance(sheet, Rectangle):
        return None
    axis = int(sheet.width > sheet.length)
    width, length = sorted((sheet.length, sheet.width))
    slanted = all(abs(cos(2 * angle)) < 1e-6 for angle in sheet.fibres)
    if length < 2 * width * (1 - 1e-9) or not slanted or set(case.boundary) != set(_EDGES[axis]):
        return None
    near, far = (_grip(case.boundary, edge) for edge in _EDGES[axis])
    if near is None or far is None:
        return None
    factors, offsets = (
        [getattr(far[i], of) - getattr(near[i], of) for i in (axis, 1 - axis)]
        for of in ("factor", "offset")
    )
    if not factors[0] or factors[1] or offsets[1]:
        return None
    return BiasExtension(length, width, axis, factors[0], offsets[0])


def mean_shear_angle(directory: str | Path, time: float, specimen: BiasExtension) -> float | None:
    """Return the mean of the field ``shear_angle`` (rad) over the central zone at a time (s).

    It is None if the run did not store that field at that time.
    """
    if not (Path(directory) / DATA).exists():
        return None
    fields = read_fields(directory)
    if not len(fields.times) or "shear_angle" not in fields.units:
        return None
    index = int(np.abs(fields.times - time).argmin())
    if abs(fields.times[index] - time) > 1e-9 * fields.times[-1]:
        return None
    corners = fields.points()[fields.triangles()]
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    area = np.abs(ax * by - ay * bx) * specimen.in_centre(corners.mean(axis=1))
    angle = fields.field("shear_angle", index)[fields.triangles()].mean(axis=1)
    return float(area @ angle / area.sum()) if area.any() else None


def _grip(boundary: Boundary, edge: str) -> tuple[Component, Component] | None:
    """Return the motion of an edge if both families are held alike without a formula."""
    conditions = boundary[edge]
    components = conditions[0].components
    families = sorted(family for c in conditions for family in c.families)
    alike = families == [1, 2] and all(c.components == components for c in conditions)
    plain = all(c.held and c.expression is None for c in components)
    return components if alike and plain else None
