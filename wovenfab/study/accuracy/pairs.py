"""The best answer where two factors were varied one at a time, and in some pairs together.

Meshes and steps together: which pairs are run, and the best answers that follow.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import inf, isfinite

from wovenfab.study.accuracy.climb import Climb
from wovenfab.study.accuracy.ladder import Best, worst
from wovenfab.study.accuracy.settings import Setting
from wovenfab.study.accuracy.study import Run, Study

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


#: Pairs that are tried for one accuracy before it counts as missed.
_TRIES = 3

_Parts = tuple[Run, Run]


class Pairing:
    """Runs the cheapest pair of a mesh and steps that promises each accuracy.

    The best answers know their mixed part better after each, so an accuracy may be proven
    by a pair that was run for another one.
    """

    def __init__(self, now: Study, climb: Climb, base: Run) -> None:
        """Run nothing yet.

        Args:
            now: The study, whose runs in space and in time are done.
            climb: Runs a setting.
            base: The run whose mesh the study in time used.
        """
        self._now, self._climb, self._base = now, climb, base
        self._tried: list[_Parts] = []
        self._pairs: dict[str, tuple[Pair, ...]] = {name: () for name in base.measured.values}

    def __call__(self, targets: Sequence[float], until: float) -> None:
        """Run pairs until each accuracy is proven or has had its tries, or time (s) is out.

        May be called again when there are more runs in space or in time.
        """
        self._judge()
        tries: Counter[float] = Counter()
        while chosen := self._next(targets, tries, until):
            target, parts = chosen
            tries[target] += 1
            self._tried.append(parts)
            run = self._climb.one(_setting(parts), self._cost(parts))
            if run is not None and not run.measured.failure:
                self._now.both.append(run)
                for name, value in run.measured.values.items():
                    pair = replace(_pair(parts, name), value=value)
                    self._pairs[name] = (*self._pairs[name], pair)
                self._judge()

    def _next(
        self, targets: Sequence[float], tries: Counter[float], until: float
    ) -> tuple[float, _Parts] | None:
        """Return the first accuracy that is not proven and the cheapest pair for it."""
        every = product(self._now.space, self._now.time)
        left = [p for p in every if p not in self._tried]
        fit = [p for p in left if self._now.spent + self._cost(p) <= until]
        for target in targets:
            if self._now.within(target) or tries[target] == _TRIES:
                continue
            if good := [p for p in fit if self._promised(p) <= target]:
                return target, min(good, key=self._cost)
        return None

    def _judge(self) -> None:
        space, time = self._now.best["space"], self._now.best["time"]
        self._answers = {
            name: Together(space[name], time[name], value, self._pairs[name])
            for name, value in self._base.measured.values.items()
        }
        self._now.best["both"] = {name: found.best for name, found in self._answers.items()}

    def _promised(self, parts: _Parts) -> float:
        """Return the worst error that a pair should have, that of the best answer included."""
        mesh, steps = map(self._now.errors, parts)
        return worst(
            {
                name: mesh[name] + steps[name] + found.bound(_pair(parts, name))
                for name, found in self._answers.items()
            }
        )

    def _cost(self, parts: _Parts) -> float:
        """Return the time (s) that a pair will take: its tangents on its mesh."""
        mesh, steps = (r.measured for r in parts)
        return mesh.setup + mesh.stepping * steps.tangents / max(mesh.tangents, 1)


def _pair(parts: _Parts, name: str) -> Pair:
    mesh, steps = (r.measured.values[name] for r in parts)
    return Pair(0.0, mesh, steps)


def _setting(parts: _Parts) -> Setting:
    mesh, steps = (r.setting for r in parts)
    what = f"{mesh.what}, {steps.method}, {steps.what}"
    return Setting("both", mesh.method, mesh.order, what, mesh.mesh, steps.steps)
