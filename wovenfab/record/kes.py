"""The shear and the tension test of KES-FB1, the Kawabata evaluation system.

Source: S. Kawabata, The standardization and analysis of hand evaluation (1980). What its text
leaves open is said at each figure.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from wovenfab.record.figures import Columns, Figure, figure
from wovenfab.record.jaws import Jaws
from wovenfab.record.loop import LOOP_ENERGY, Loop, work_per_area

Values = NDArray[np.float64]
#: Angles (rad) between which G is the slope.
SLOPE = float(np.radians(0.5)), float(np.radians(2.5))
#: Angles (rad) of the widths 2HG and 2HG5.
WIDTHS = {"2HG": float(np.radians(0.5)), "2HG5": float(np.radians(5.0))}

#: Tension over the largest that is none: a force that is prescribed is met to about that.
SLACK = 1e-4


@dataclass(frozen=True)
class KesShear:
    """A sample between jaws that move along themselves, to both sides.

    Attributes:
        jaws: How it is held.
    """

    jaws: Jaws
    name: ClassVar[str] = "kes-shear"

    def shear_angle(self, travel: Values) -> Values:
        """Return the shear angle (rad) for travels of the jaws (m), of the same shape.

        The yarns from jaw to jaw turn by it. Where the distance is free they keep their length:
        sin(gamma) is the travel over the distance at rest; where it is kept, tan(gamma) is.
        """
        share = np.asarray(travel) / self.jaws.distance
        if not self.jaws.free:
            return np.asarray(np.arctan(share))
        return np.asarray(np.arcsin(np.where(np.abs(share) <= 1, share, np.nan)))

    def loop(self, history: Columns) -> Loop:
        """Return force per width against shear angle."""
        return _loop(self.jaws, self.shear_angle(_travel(self.jaws, history)), history)

    def figures(self, history: Columns) -> dict[str, Figure]:
        """Return G, 2HG, 2HG5 and the loop energy; see ``StandardTest``."""
        loop = self.loop(history)
        slopes = [loop.slope(side * SLOPE[0], side * SLOPE[1]) for side in (1, -1)]
        slope = "mean slope of force per width between 0.5° and 2.5° on the way out, of both sides"
        found = {"G": figure(sum(slopes) / 2, "N/(m·rad)", slope)}
        for name, angle in WIDTHS.items():
            width = sum(loop.width(side * angle) for side in (1, -1)) / 2
            words = f"width of the loop at {np.degrees(angle):.2g}°, mean of both sides"
            found[name] = figure(width, "N/m", words)
        return found | {"loop energy": figure(loop.closed_work(), "J/m^2", LOOP_ENERGY)}

    def curve(self, history: Columns) -> dict[str, Values]:
        """Return the loop; see ``StandardTest``."""
        loop = self.loop(history)
        return {"shear_angle_rad": loop.strain, "force_per_width_N_per_m": loop.force}


@dataclass(frozen=True)
class KesTension:
    """A sample between jaws that move apart and back.

    Attributes:
        jaws: How it is held.
    """

    jaws: Jaws
    name: ClassVar[str] = "kes-tension"

    def loop(self, history: Columns) -> Loop:
        """Return force per width against strain."""
        strain = np.asarray(_travel(self.jaws, history) / self.jaws.distance)
        return _loop(self.jaws, strain, history)

    def figures(self, history: Columns) -> dict[str, Figure]:
        """Return EMT, WT, LT, RT, the force reached and the loop energy; see ``StandardTest``."""
        loop = self.loop(history)
        end = int(loop.strain.argmax())
        strain, force = (v[end] - v[0] for v in (loop.strain, loop.force))
        work = loop.work[end] - loop.work[0]
        linear, back = force * strain / 2, self._recovered(loop, end)
        return {
            "EMT": figure(strain, "m/m", "strain at the largest extension"),
            "force": figure(force, "N/m", "force per width there; the standard asks 500 gf/cm"),
            "WT": figure(work, "J/m^2", "work to there, per area at rest"),
            "LT": figure(work / linear if linear else nan, "1", "WT over force times EMT / 2"),
            "RT": figure(back / work if work else nan, "J/J", "work given back over WT"),
            "loop energy": figure(loop.closed_work(), "J/m^2", LOOP_ENERGY),
        }

    def curve(self, history: Columns) -> dict[str, Values]:
        """Return the loop; see ``StandardTest``."""
        loop = self.loop(history)
        return {"strain": loop.strain, "force_per_width_N_per_m": loop.force}

    @staticmethod
    def _recovered(loop: Loop, end: int) -> float:
        """Return the work given back on the way back, until no tension is left (J/m^2).

        It is NaN where the way back ends before, above the strain at the start.
        """
        back = next((b for b in loop.branches if b.steps.start >= end), None)
        if back is None:
            return nan
        change = loop.force[back.steps] - loop.force[0]
        slack = change.min() <= SLACK * change.max()
        if not (slack or back.spans(loop.strain[0])):
            return nan
        return float(loop.work[end] - loop.work[back.steps].min())


def _travel(jaws: Jaws, history: Columns) -> Values:
    return jaws.travel(history["displacement_m"])


def _loop(jaws: Jaws, strain: Values, history: Columns) -> Loop:
    """Return the loop with force and work of a history."""
    force = np.asarray(jaws.force(history["force_N"]) / jaws.width)
    return Loop(strain, force, work_per_area(history, jaws.area))
