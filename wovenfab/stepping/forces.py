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
        plastic: Part of ``force`` that set-valued friction exerts, N; 0 without any.
    """

    force: Array
    load: Array
    power: Mapping[str, float]
    plastic: Array | float = 0.0

    def mean(self, other: Forces) -> Forces:
        """Return the mean of two times: the trapezoidal rule, second order.

        Set-valued friction acts in a step as it does at its end: it does no work before
        it has attained its bound.
        """
        return Forces(
            (self.force + other.force + other.plastic - self.plastic) / 2,
            (self.load + other.load) / 2,
            {name: (self.power[name] + power) / 2 for name, power in other.power.items()},
        )
