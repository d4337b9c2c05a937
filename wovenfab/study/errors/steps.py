"""Errors of steps: from the responses of three numbers of steps on the same elements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import log

from wovenfab.study.errors.refinement import SLOWEST, error_of_degrees, exponent
from wovenfab.study.response import Response

#: The peak of what answers the program: the force, or the displacement under a prescribed force.
PEAKS = ("peak_force_N", "peak_displacement_m")
#: Least order that is believed of what is summed over steps, such as the loss. Steps longer than
#: friction takes to follow a jump of the velocity let it change as much from one number of steps
#: to the next.
SLOWEST_ORDER = 0.25


def error_and_order(
    counts: Sequence[int],
    values: Sequence[float],
    highest: float,
    slowest: float = SLOWEST_ORDER,
) -> tuple[float, float]:
    """Return the signed error of the last of three values, and the order in which it falls.

    The order is the one that the values show: where steps do not resolve how friction lets go,
    it is lower than the scheme's.

    Args:
        counts: Three numbers of steps, one after another.
        values: The values.
        highest: Order of the scheme.
        slowest: Least order that is believed.
    """
    first, second = (a - b for a, b in pairwise(values))
    growth = counts[2] / counts[1]
    if first * second > 0:
        order = exponent(counts, first / second, highest, slowest)
        if order < SLOWEST:
            return second / (growth**order - 1), order
    _, middle, last = error_of_degrees(counts, values, highest)
    if not last:
        return 0.0, highest
    return last, min(log(middle / last) / log(growth), highest)


@dataclass(frozen=True)
class StepRefinement:
    """Responses with three numbers of steps, or more, on the same elements.

    Attributes:
        responses: The responses, one after another; all have the figures of the last.
        highest: Order of the scheme.
    """

    responses: Sequence[Response]
    highest: float

    def errors_and_orders(self) -> dict[str, tuple[float, float]]:
        """Return each figure's signed error over it with most steps, and the order of that.

        That of the peak is the error of the curve; what steps miss of it is another matter.
        """
        counts, result = [r.count for r in self.responses[-3:]], {}
        for name, value in self.responses[-1].figures.items():
            if value:
                slowest = SLOWEST if name in PEAKS else SLOWEST_ORDER
                last = self._values(name)[-3:]
                error, order = error_and_order(counts, last, self.highest, slowest)
                result[name] = error / abs(value), order
        return result

    def errors_from(self, first: int) -> dict[str, float]:
        """Return each figure's largest error with the steps of a response or with more, over it.

        It is the distance from the limit of the last three, and as much more as these may be
        wrong. Fewer steps that agree with the limit by chance do not make it smaller.

        Args:
            first: Index of the response.
        """
        result = {}
        for name, (error, _) in self.errors_and_orders().items():
            *earlier, last = self._values(name)
            size = abs(self.responses[-1].figures[name])
            changes = [abs(value - last) / size for value in earlier[first:]]
            result[name] = max(changes, default=0.0) + 2 * abs(error)
        return result

    def _values(self, name: str) -> list[float]:
        if name in PEAKS:
            return [r.curve.peak_of_spline()[1] for r in self.responses]
        return [r.figures[name] for r in self.responses]
