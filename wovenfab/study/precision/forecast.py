"""How long a method will take to be accurate enough, from the runs of all so far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, inf, log

from wovenfab.study.precision.error import Best, Ladder, own_error

#: More runs than this are not foreseen.
_MOST_RUNS = 20.0


@dataclass(frozen=True)
class Forecast:
    """Where a ladder stands, for its worst quantity.

    Attributes:
        error: Relative error of the last run, as far as it is known; infinite without a run.
        gain: Logarithm of the factor by which the last run made it smaller.
    """

    error: float = inf
    gain: float = 0.0

    @property
    def next(self) -> float:
        """Relative error of the next run, if its gain is the same."""
        return self.error * exp(-self.gain)

    def time(self, enough: float, next_run: float, growth: float) -> float:
        """Return the time (s) until the error is small enough; infinite if it does not fall.

        Args:
            enough: That error.
            next_run: Time of the next run, s.
            growth: How many times as long each further run takes.
        """
        if self.error <= enough:
            return 0.0
        if self.gain <= 0:
            return inf
        runs = min(log(self.error / enough) / self.gain, _MOST_RUNS)
        found: float = next_run * (growth**runs - 1) / (growth - 1)
        return found


def forecast(ladders: Sequence[Ladder], best: Sequence[Best]) -> Forecast:
    """Return where a method stands, and how it got there with its last run.

    A method's own values may give no order yet, or one that is too low; the distances to the
    best answer of all methods show it as far as that answer is known.

    Args:
        ladders: Of each quantity, with two runs at least; else nothing is known.
        best: The best answer to each quantity from all methods so far.
    """
    found = [Forecast()]
    for ladder, answer in zip(ladders, best, strict=True):
        if len(ladder.values) > 1 and answer.value:
            least = min(own_error(ladder), answer.error)
            before, last = (abs(v - answer.value) + least for v in ladder.values[-2:])
            most = ladder.order * log(ladder.sizes[-2] / ladder.sizes[-1])
            gain = min(log(before / last), most) if last else most
            found.append(Forecast(last / abs(answer.value), gain))
    return max(found[1:] or found, key=lambda f: f.error)
