"""The picture-frame test: shear angle and normalised shear force of fabric between hinged bars.

Source: as of :mod:`wovenfab.record.shear_curve`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from wovenfab.record.figures import Columns, Figure
from wovenfab.record.loop import Loop, work_per_area
from wovenfab.record.shear_curve import measured_angle, shear_curve, shear_figures

Values = NDArray[np.float64]


@dataclass(frozen=True)
class PictureFrame:
    """A square frame of four hinged bars whose crosshead is the program.

    Attributes:
        length: Of the bars from hinge to hinge, m.
        area: Of the fabric at rest, m^2.
        zone: The probe that measures the shear angle, if there is one.
        sign: 1 where the angle of the families grows with the travel of the crosshead, else -1.
    """

    length: float
    area: float
    zone: str | None = None
    sign: float = 1.0
    name: ClassVar[str] = "picture-frame"

    def _cosine(self, travel: Values) -> Values:
        """Return the cosine of half the angle between the bars; NaN where there is no such one."""
        cosine = 1 / np.sqrt(2) + np.asarray(travel) / (2 * self.length)
        return np.where(np.abs(cosine) <= 1, cosine, np.nan)

    def angle_at(self, travel: Values) -> Values:
        """Return gamma = 90 deg - 2 acos(1/sqrt(2) + d/(2 L)) (rad) at travels d (m)."""
        return np.asarray(np.pi / 2 - 2 * np.arccos(self._cosine(travel)))

    def displacement_at(self, angle: Values) -> Values:
        """Return the travel of the crosshead (m) at shear angles (rad)."""
        cosine = np.cos(np.pi / 4 - np.asarray(angle) / 2)
        return np.asarray(2 * self.length * (cosine - 1 / np.sqrt(2)))

    def force_at(self, angle: Values, shear_force: Values) -> Values:
        """Return the force of the crosshead (N) of a normalised shear force (N/m)."""
        opened = 2 * np.cos(np.pi / 4 - angle / 2)
        return np.asarray(shear_force * opened * self.area / self.length)

    def shear_force(self, travel: Values, force: Values) -> Values:
        """Return the normalised shear force F L / (2 cos(phi) A), N/m.

        phi is half the angle between the bars. The work of the crosshead is that of this force
        per length: F dd = A F_sh cos(gamma) dgamma.

        Args:
            travel: Of the crosshead, m.
            force: Of the crosshead F, N, same shape.
        """
        return np.asarray(force * self.length / (2 * self._cosine(travel) * self.area))

    def loop(self, history: Columns) -> Loop:
        """Return normalised shear force against shear angle."""
        travel = history["displacement_m"]
        force = self.shear_force(travel, history["force_N"])
        return Loop(self.angle_at(travel), force, work_per_area(history, self.area))

    def figures(self, history: Columns) -> dict[str, Figure]:
        """Return the figures of its curve; see ``StandardTest``."""
        measured = measured_angle(self.zone, self.sign, history)
        return shear_figures(self.loop(history), measured)

    def curve(self, history: Columns) -> dict[str, Values]:
        """Return the curve by columns; see ``StandardTest``."""
        return shear_curve(self.loop(history), measured_angle(self.zone, self.sign, history))
