"""The best answer where two factors were varied one at a time, and in some pairs together."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite

from wovenfab.study.precision.error import Best

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
class Together:
    """The answers of studies of each factor, with the other kept coarse.

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
        found = [
            (self.bound(pair), self._corrected(pair))
            for pair in (Pair(self.base, self.base, self.base), *self.pairs)
        ]
        relative, value = min(found)
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
        is coarser in one factor has a mixed part of its own, which tells nothing of the base's.
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
