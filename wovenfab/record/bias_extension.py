"""The bias-extension test: elongation, shear angle and normalised shear force of the specimen.

A laboratory evaluates that of a bias-extension test with yarns taken as inextensible and pinned
where they cross. The sheet then has zones of equal shear: none at the grips, gamma in the centre,
where both families end at free edges, and gamma/2 between them. Source: J. Cao and others,
Characterization of mechanical behavior of woven fabrics: experimental methods and benchmark
results, Composites Part A 39 (2008).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


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
        """Return the tension between the grips (N) for forces conjugate to the program (N)."""
        return np.asarray(force / self.factor)

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
