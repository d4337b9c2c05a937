"""Meshes and steps together: which pairs are run, and the best answers that follow."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import product

from wovenfab.study.precision.both import Pair, Together
from wovenfab.study.precision.climb import Climb
from wovenfab.study.precision.error import worst
from wovenfab.study.precision.result import Run, Study
from wovenfab.study.precision.settings import Setting

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
