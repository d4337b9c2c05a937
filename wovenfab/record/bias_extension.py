"""The bias-extension test: elongation, shear angle and normalised shear force of the specimen.

A laboratory evaluates that of a bias-extension test with yarns taken as inextensible and pinned
where they cross. The sheet then has zones of equal shear: none at the grips, gamma in the centre,
where both families end at free edges, and gamma/2 between them. Source: as of
:mod:`wovenfab.record.shear_curve`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from wovenfab.record.figures import Columns, Figure
from wovenfab.record.jaws import Jaws
from wovenfab.record.loop import Loop, work_per_area
from wovenfab.record.shear_curve import measured_angle, shear_curve, shear_figures

Values = NDArray[np.float64]
#: Least angle over the largest one from which a loading begins, at most; as much may it go back.
START = 0.1


@dataclass(frozen=True)
class BiasExtension:
    """A rectangle with yarns at 45 degrees to its long side, held at its short edges.

    Attributes:
        jaws: How it is held; their distance is twice the width at least.
        zone: The probe that measures the shear angle within the central zone, if there is one.
        sign: 1 where the angle of the families grows with the elongation, else -1.
    """

    jaws: Jaws
    zone: str | None = None
    sign: float = 1.0
    name: ClassVar[str] = "bias-extension"

    def angle_at(self, displacement: Values) -> Values:
        """Return the shear angle in the centre (rad) at displacements of the program (m)."""
        return self.shear_angle(self.jaws.travel(displacement))

    def displacement_at(self, angle: Values) -> Values:
        """Return the displacement of the program (m) at shear angles in the centre (rad).

        It is the inverse of :meth:`angle_at`.
        """
        span = self.jaws.distance - self.jaws.width
        elongation = span * (sqrt(2) * np.cos(pi / 4 - np.asarray(angle) / 2) - 1)
        return np.asarray((elongation - self.jaws.offset) / self.jaws.factor, dtype=np.float64)

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
        half, h, w = angle / 2, self.jaws.distance, self.jaws.width
        at_half = np.interp(half, angle[order], shear_force[order])
        work = (2 * h - 3 * w) * np.cos(angle) * shear_force + w * np.cos(half) * at_half
        tension = work / ((h / w - 1) * (np.cos(half) - np.sin(half)))
        return np.asarray(self.jaws.factor * tension)

    def shear_angle(self, elongation: Values) -> Values:
        """Return gamma = 90 deg - 2 acos((L0 + d) / (sqrt(2) L0)) in the central zone (rad).

        Args:
            elongation: d (m), any shape; L0 is length - width.

        Returns:
            The same shape; NaN beyond the elongation at which the yarns lie side by side.
        """
        span = self.jaws.distance - self.jaws.width
        cosine = (span + np.asarray(elongation)) / (sqrt(2) * span)
        angle: Values = pi / 2 - 2 * np.arccos(np.where(np.abs(cosine) <= 1, cosine, np.nan))
        return angle

    def shear_force(self, angle: Values, tension: Values) -> Values:
        """Return the normalised shear force F_sh (N/m) on a way from zero, or back to it.

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
        h, w = self.jaws.distance, self.jaws.width
        right = (h / w - 1) * tension * (np.cos(half) - np.sin(half))
        matrix = np.diag((2 * h - 3 * w) * np.cos(angle))
        force: Values = np.linalg.solve(matrix + w * np.cos(half)[:, None] * interpolation, right)
        return force

    def loop(self, history: Columns) -> Loop:
        """Return normalised shear force against shear angle.

        The force is NaN on a branch that neither begins nor ends at zero: the zones beside the
        centre have half the angle, and what the force was there is then not known.
        """
        angle = self.angle_at(history["displacement_m"])
        tension = self.jaws.force(history["force_N"])
        work = work_per_area(history, self.jaws.area)
        force, branches = np.full_like(angle, np.nan), Loop(angle, tension, work).branches
        for branch in branches:
            ends = np.abs(branch.strain[[0, -1]])
            if ends.min() > branch.slack or branch.strain.min() < -branch.slack:
                continue
            # friction turns within the first step of a branch, unless it begins at rest
            steps = np.arange(len(angle))[branch.steps][0 if branch is branches[0] else 1 :]
            order = steps[:: int(branch.direction)]
            force[order] = self.shear_force(angle[order], tension[order])
        return Loop(angle, force, work)

    def figures(self, history: Columns) -> dict[str, Figure]:
        """Return the figures of its curve; see ``StandardTest``."""
        measured = measured_angle(self.zone, self.sign, history)
        return shear_figures(self.loop(history), measured)

    def curve(self, history: Columns) -> dict[str, Values]:
        """Return the curve by columns; see ``StandardTest``."""
        return shear_curve(self.loop(history), measured_angle(self.zone, self.sign, history))

    def in_centre(self, points: Values) -> NDArray[np.bool_]:
        """Return which reference points (m), shape (n, 2), are in the central zone, shape (n,)."""
        along, across = map(np.abs, self.jaws.position(points))
        free: NDArray[np.bool_] = self.jaws.distance / 2 - along > self.jaws.width / 2 + across
        return free
