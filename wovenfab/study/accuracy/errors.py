"""Errors of values that ever finer settings approach, from these values alone.

One factor at a time by Richardson's extrapolation; two factors by studies of each with the other
coarse, and some pairs of both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, expm1, inf, isfinite, log

from scipy.optimize import brentq

#: Observed orders outside are not believed, and the last difference stands for the error.
LEAST_ORDER, MOST_ORDER = 0.3, 12.0
#: Below this share of the value differences are Newton's tolerance and round-off.
ROUND_OFF = 1e-8


@dataclass(frozen=True)
class Refinement:
    """Values of one quantity by one method, from coarse to fine.

    Attributes:
        method: Its name.
        sizes: What goes to zero: 1/sqrt(unknowns), 1/steps or sqrt(tolerance), descending.
        values: The quantity.
        order: Order in theory at best; a higher one is chance, and is not extrapolated with.
        regular: Whether each setting is finer than the last everywhere and alike; else the order
            that shows is chance, too.
    """

    method: str
    sizes: tuple[float, ...]
    values: tuple[float, ...]
    order: float
    regular: bool = True


@dataclass(frozen=True)
class Best:
    """The best answer that is known.

    Attributes:
        value: The quantity.
        error: Estimated error, in its unit.
        method: The method that gave it.
        check: The other method that it was compared with, or nothing.
    """

    value: float
    error: float
    method: str
    check: str = ""

    @property
    def relative(self) -> float:
        """Estimated error as a share of the value."""
        return self.error / abs(self.value) if self.value else inf


def best_of(refinements: Sequence[Refinement]) -> Best:
    """Return the finest value of the method that converges best, with its error.

    The error is what Richardson's extrapolation of the method's own three finest values
    says, and more if the next best method, by an independent discretisation, is farther
    away than that one's own error explains. A method that approaches from one side explains
    nothing on the side it comes from. There is one refinement a method, none of them empty.
    """
    ranked = sorted(refinements, key=own_error)
    first = ranked[0]
    value, error = first.values[-1], own_error(first)
    second = ranked[1] if len(ranked) > 1 else None
    if second is None or not isfinite(other := own_error(second)):
        return Best(value, error, first.method)
    distance = abs(value - second.values[-1])
    if not _lies_ahead(second, value):
        other = 0.0
    return Best(value, max(error, distance - other), first.method, second.method)


def _lies_ahead(refinement: Refinement, value: float) -> bool:
    """Return whether a value is where a refinement goes: everywhere if it shows no order."""
    if (
        len(refinement.values) < 3
        or order_of(refinement.sizes[-3:], refinement.values[-3:]) is None
    ):
        return True
    return (refinement.values[-1] - refinement.values[-2]) * (value - refinement.values[-1]) > 0


def own_error(refinement: Refinement) -> float:
    """Return the error of a refinement's finest value that its last three values suggest.

    Richardson: with order p and ratio r of sizes, |v_n - v_{n-1}| / (r^p - 1), and not less than
    what the difference before leads to expect. Where no order shows, the larger of the two
    differences; of two values order 1 is assumed; of one nothing is known.
    """
    sizes, values = refinement.sizes[-3:], refinement.values[-3:]
    if len(values) < 2:
        return inf
    floor = ROUND_OFF * abs(values[-1])
    last, ratio = abs(values[-1] - values[-2]), sizes[-2] / sizes[-1]
    if len(values) == 2:
        return max(last / (ratio - 1), floor)
    before, ratio_before = abs(values[-2] - values[-3]), sizes[-3] / sizes[-2]
    order = order_of(sizes, values) if refinement.regular else None
    if order is None:
        return max(last, before, floor)
    p = min(order, refinement.order)
    expected = before / (ratio_before**p - 1) / ratio**p
    error: float = max(last / (ratio**p - 1), expected, floor)
    return error


def order_of(sizes: Sequence[float], values: Sequence[float]) -> float | None:
    """Return the order p with which three values approach their limit, or None without one.

    Solves (v_1 - v_2) / (v_2 - v_3) = (h_1^p - h_2^p) / (h_2^p - h_3^p) for sizes of any ratio.
    """
    first, last = values[0] - values[1], values[1] - values[2]
    if abs(last) <= ROUND_OFF * abs(values[2]) or first / last <= 0:
        return None
    a, b = log(sizes[0] / sizes[1]), log(sizes[1] / sizes[2])

    def excess(p: float) -> float:
        # (h_1/h_2)^p - 1 over 1 - (h_3/h_2)^p
        return float(log(expm1(p * a) / -expm1(-p * b) * last / first))

    if excess(LEAST_ORDER) > 0 or excess(MOST_ORDER) < 0:
        return None
    order = brentq(excess, LEAST_ORDER, MOST_ORDER, xtol=1e-6)
    return float(order)


def worst(errors: Mapping[str, float]) -> float:
    """Return the largest of the errors of several quantities."""
    return max(errors.values(), default=inf)


#: A pair whose own share of the mixed part is larger says too little of that part.
_LEAST_SEEN = 0.5


@dataclass(frozen=True)
class Pair:
    """One quantity for a mesh and steps, and with each of them alone.

    Attributes:
        value: On the mesh with the steps.
        mesh: On the mesh, with the coarse steps of the study in space.
        steps: With the steps, on the mesh of the study in time.
    """

    value: float
    mesh: float
    steps: float


@dataclass(frozen=True)
class Combined:
    """The answers of studies of each factor, with the other coarse.

    Attributes:
        space: Best answer in space, with the coarse steps.
        time: Best answer in time, on the mesh of that study.
        base: The quantity on that mesh with the coarse steps.
        pairs: Finer meshes and steps together that were run.
    """

    space: Best
    time: Best
    base: float
    pairs: tuple[Pair, ...] = ()

    @property
    def best(self) -> Best:
        """The best answer with both errors gone.

        Relative corrections for mesh and steps multiply, V = V_base (S/V_base) (T/V_base);
        what this leaves out is the mixed part of the error. A finer pair needs smaller
        corrections, and leaves out less: the answer is that of the pair which leaves out least.
        """
        candidates = [
            (self.bound(pair), self._corrected(pair))
            for pair in (Pair(self.base, self.base, self.base), *self.pairs)
        ]
        relative, value = min(candidates)
        return Best(
            value,
            abs(value) * relative if isfinite(relative) else inf,
            f"{self.space.method}; {self.time.method}",
            "; ".join(c or "nothing" for c in (self.space.check, self.time.check)),
        )

    def bound(self, pair: Pair) -> float:
        """Return the relative error of the best answer that follows from a pair.

        A mixed part that is x and y times as large as at the base after refining one factor,
        and xy times after both, is x + y - xy of that of the base after correction.
        """
        alone = self.space.relative + self.time.relative
        if not isfinite(alone):
            return inf
        x, y = self._shares(pair)
        return alone + self.mixed * (x + y - min(x, 1) * min(y, 1))

    @property
    def mixed(self) -> float:
        """The mixed part at the base as a share of the answer.

        The product of both errors, or more where pairs show it: a pair and the base, both
        corrected, differ by (1 - x) (1 - y) of it, whatever the best answers are. That is so
        to first order; the next changes it by no more than the errors at the base. A pair that
        is coarser in one factor has a mixed part of its own, which does not show that of the base.
        """
        first, second = self._errors(Pair(0.0, self.base, self.base))
        seen = [first * second]
        at_base = self._corrected(Pair(self.base, self.base, self.base))
        for pair in self.pairs:
            x, y = self._shares(pair)
            if x < 1 and y < 1:
                part = max((1 - x) * (1 - y), _LEAST_SEEN)
                seen.append(abs(self._corrected(pair) / at_base - 1) / part)
        return max(seen) * (1 + first + second)

    def _corrected(self, pair: Pair) -> float:
        return pair.value * (self.space.value / pair.mesh) * (self.time.value / pair.steps)

    def _errors(self, pair: Pair) -> tuple[float, float]:
        """Return bounds of the relative errors of a pair's mesh and steps."""
        return (
            abs(pair.mesh / self.space.value - 1) + self.space.relative,
            abs(pair.steps / self.time.value - 1) + self.time.relative,
        )

    def _shares(self, pair: Pair) -> tuple[float, float]:
        """Return both errors of a pair as shares of those of the base."""
        mesh, steps = self._errors(pair)
        base = self._errors(Pair(0.0, self.base, self.base))
        return mesh / base[0], steps / base[1]


#: More runs than this are not foreseen.
_MOST_RUNS = 20.0


@dataclass(frozen=True)
class Forecast:
    """Error of a method so far and its expected reduction, for its worst quantity.

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
        return float(next_run * (growth**runs - 1) / (growth - 1))


def forecast(refinements: Sequence[Refinement], best: Sequence[Best]) -> Forecast:
    """Return the error of a method, and the gain by its last run.

    A method's own values may give no order yet, or one that is too low; the distances to the
    best answer of all methods show it as far as that answer is known.

    Args:
        refinements: Of each quantity, with two runs at least; else nothing is known.
        best: The best answer to each quantity from all methods so far.
    """
    forecasts = [Forecast()]
    for refinement, answer in zip(refinements, best, strict=True):
        if len(refinement.values) > 1 and answer.value:
            least = min(own_error(refinement), answer.error)
            before, last = (abs(v - answer.value) + least for v in refinement.values[-2:])
            most = refinement.order * log(refinement.sizes[-2] / refinement.sizes[-1])
            gain = min(log(before / last), most) if last else most
            forecasts.append(Forecast(last / abs(answer.value), gain))
    return max(forecasts[1:] or forecasts, key=lambda f: f.error)
