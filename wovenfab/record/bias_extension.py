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
#: Least angle over the largest one from which a loading begins, at most; as much may it go back.
START = 0.1


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

    def angle_at(self, displacement: Values) -> Values:
        """Return the shear angle in the centre (rad) at displacements of the program (m)."""
        return self.shear_angle(self.elongation(displacement))

    def displacement_at(self, angle: Values) -> Values:
        """Return the displacement of the program (m) at shear angles in the centre (rad).

        It is the inverse of :meth:`angle_at`.
        """
        span = self.length - self.width
        elongation = span * (sqrt(2) * np.cos(pi / 4 - np.asarray(angle) / 2) - 1)
        return np.asarray((elongation - self.offset) / self.factor, dtype=np.float64)

    def force_at(self, angle: Values, shear_force: Values) -> Values:
        """Return the force conjugate to the program (N) of a normalised shear force (N/m).

        It is the inverse of :meth:`shear_force`: what both zones take, at gamma and at gamma/2.
        So the angles must be those of one loading from about zero; they may scatter.

        Args:
            angle: gamma (rad), shape (n,), in the order of time.
            shear_force: F_sh (N/m), shape (n,).

        Raises:
            ValueError: The angles begin too late or go back.
        """
        most = float(np.max(angle))
        if angle[0] > START * most or angle[-1] < (1 - START) * most:
            raise ValueError(
                "the normalised shear force of a bias extension gives the force for one loading "
                "from zero, as it needs that at half of each angle; for a cycle give the force"
            )
        order = np.argsort(angle, kind="stable")
        half, h, w = angle / 2, self.length, self.width
        at_half = np.interp(half, angle[order], shear_force[order])
        work = (2 * h - 3 * w) * np.cos(angle) * shear_force + w * np.cos(half) * at_half
        tension = work / ((h / w - 1) * (np.cos(half) - np.sin(half)))
        return np.asarray(self.factor * tension)

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
