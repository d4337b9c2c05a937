"""Forces and powers at one time, of which work and losses are summed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Forces:
    """What acts at one time, on this rank's own unknowns.

    Attributes:
        force: Internal force less the dead loads, which is what edges must hold, N.
        load: Dead loads, N.
        power: Dissipated power by effect on all ranks, W.
    """

    force: Array
    load: Array
    power: Mapping[str, float]

    def mean(self, other: Forces) -> Forces:
        """Return the mean of two times: the trapezoidal rule, second order."""
        return Forces(
            (self.force + other.force) / 2,
            (self.load + other.load) / 2,
            {name: (self.power[name] + power) / 2 for name, power in other.power.items()},
        )
