"""The picture-frame test: shear angle and normalised shear force of the fabric.

Source: J. Cao and others, Characterization of mechanical behavior of woven fabrics: experimental
methods and benchmark results, Composites Part A 39 (2008).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


@dataclass(frozen=True)
class PictureFrame:
    """Four hinged bars, square at rest, that shear a rectangle of fabric homogeneously.

    Attributes:
        length: Of the bars from hinge to hinge, L (m).
        area: Of the fabric, A (m^2).
    """

    length: float
    area: float

    def angle_at(self, displacement: Values) -> Values:
        """Return the shear angle gamma = 90 deg - 2 acos(1/sqrt(2) + d/(2 L)) (rad).

        Args:
            displacement: Travel of the crosshead d (m), any shape.

        Returns:
            The same shape; NaN where the frame is folded flat.
        """
        cosine = 1 / sqrt(2) + np.asarray(displacement) / (2 * self.length)
        angle: Values = pi / 2 - 2 * np.arccos(np.where(np.abs(cosine) <= 1, cosine, np.nan))
        return angle

    def displacement_at(self, angle: Values) -> Values:
        """Return the travel of the crosshead (m) at shear angles (rad)."""
        cosine = np.cos(pi / 4 - np.asarray(angle) / 2)
        displacement: Values = 2 * self.length * (cosine - 1 / sqrt(2))
        return displacement

    def shear_force(self, angle: Values, force: Values) -> Values:
        """Return the normalised shear force F_sh = F L/(2 cos(45 deg - gamma/2) A) (N/m).

        Its work on the fabric, A F_sh cos(gamma) dgamma, is that of the crosshead.
        """
        return np.asarray(force * self.length / (2 * np.cos(pi / 4 - angle / 2) * self.area))

    def force_at(self, angle: Values, shear_force: Values) -> Values:
        """Return the force of the crosshead (N) of a normalised shear force (N/m)."""
        opened = 2 * np.cos(pi / 4 - angle / 2)
        return np.asarray(shear_force * opened * self.area / self.length)
