"""What a laboratory reads off a bias-extension test, which knows of yarns only that they turn.

The yarns are taken as inextensible and pinned where they cross. The sheet then has zones of
equal shear: none at the grips, gamma in the middle, where both families end at free edges, and
gamma/2 between them. Source: J. Cao and others, Characterization of mechanical behavior of
woven fabrics: experimental methods and benchmark results, Composites Part A 39 (2008).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from wovenfab.case import Boundary, Case, Component, Rectangle

Values = NDArray[np.float64]
#: Edges across x and across y, first the one at the lower coordinate.
_EDGES = (("left", "right"), ("bottom", "top"))


@dataclass(frozen=True)
class BiasExtension:
    """A rectangle with yarns at 45 degrees to its long side, held at its short edges.

    Attributes:
        length, width: Its sides (m); the length is twice the width at least.
        axis: 0 if the long side is along x, 1 if along y.
        factor: Distance that the grips part per displacement of the program.
        offset: Distance (m) by which they are apart before.
    """

    length: float
    width: float
    axis: int
    factor: float
    offset: float

    def elongation(self, displacement: Values) -> Values:
        """Return how far the grips have parted (m) for displacements of the program (m)."""
        return self.factor * displacement + self.offset

    def tension(self, force: Values) -> Values:
        """Return the pull of the grips (N) for forces along the program (N)."""
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
        """Return the normalised shear force F_sh (N/m) along one way out.

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
        between = np.array([np.interp(half, angle, unit) for unit in np.eye(len(angle))]).T
        h, w = self.length, self.width
        known = (h / w - 1) * tension * (np.cos(half) - np.sin(half))
        system = np.diag((2 * h - 3 * w) * np.cos(angle)) + w * np.cos(half)[:, None] * between
        force: Values = np.linalg.solve(system, known)
        return force

    def in_centre(self, points: Values) -> NDArray[np.bool_]:
        """Return which reference points (m), shape (n, 2), no yarn ties to a grip, shape (n,)."""
        along, across = points[:, self.axis], points[:, 1 - self.axis]
        away = np.minimum(along, self.length - along)
        free: NDArray[np.bool_] = away > self.width / 2 + np.abs(across - self.width / 2)
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


def _grip(boundary: Boundary, edge: str) -> tuple[Component, Component] | None:
    """Return how an edge is moved if both families are held alike without a formula."""
    conditions = boundary[edge]
    components = conditions[0].components
    families = sorted(family for c in conditions for family in c.families)
    alike = families == [1, 2] and all(c.components == components for c in conditions)
    plain = all(c.held and c.expression is None for c in components)
    return components if alike and plain else None
