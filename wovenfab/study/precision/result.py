"""What an accuracy study knows: its runs, the best answers, and how far each run is off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf

from wovenfab.study.precision.error import Best, Ladder
from wovenfab.study.precision.run import Measured
from wovenfab.study.precision.settings import Setting


@dataclass(frozen=True)
class Run:
    """A setting, what it gave and what goes to zero along its ladder."""

    setting: Setting
    measured: Measured
    size: float


@dataclass
class Study:
    """All runs of a study and what follows.

    Attributes:
        space, time, both: Runs of each stage that did not fail.
        failed: The others.
        best: Best answers by stage and quantity; those of ``both`` are the study's answers.
        chosen: For each accuracy the cheapest setting's run that keeps it, or None.
        spent: Time that the runs took, without compilation, s.
    """

    space: list[Run] = field(default_factory=list)
    time: list[Run] = field(default_factory=list)
    both: list[Run] = field(default_factory=list)
    failed: list[Run] = field(default_factory=list)
    best: dict[str, dict[str, Best]] = field(default_factory=dict)
    chosen: dict[float, Run | None] = field(default_factory=dict)
    spent: float = 0.0

    @property
    def runs(self) -> list[Run]:
        """All runs that did not fail."""
        return [*self.space, *self.time, *self.both]

    def errors(self, run: Run) -> dict[str, float]:
        """Return the relative error of each quantity, towards the best of the run's stage."""
        found = {}
        for name, best in self.best.get(run.setting.stage, {}).items():
            scale = abs(best.value)
            found[name] = abs(run.measured.values[name] - best.value) / scale if scale else inf
        return found

    def bounds(self, run: Run) -> dict[str, float]:
        """Return each error with that of the best answer on top."""
        best = self.best[run.setting.stage]
        return {name: error + best[name].relative for name, error in self.errors(run).items()}

    def within(self, target: float) -> list[Run]:
        """Return the runs of the last stage whose quantities all keep a relative error."""
        runs = self.both if self.final == "both" else self.space
        return [r for r in runs if max(self.bounds(r).values(), default=inf) <= target]

    @property
    def final(self) -> str:
        """The stage whose best answers are those of the study."""
        return "both" if "both" in self.best else "space"


def ladders_of(runs: Sequence[Run], name: str) -> list[Ladder]:
    """Return the ladder of each method for a quantity."""
    methods = dict.fromkeys(r.setting.method for r in runs)
    found = []
    for method in methods:
        mine = [r for r in runs if r.setting.method == method]
        sizes = tuple(r.size for r in mine)
        values = tuple(r.measured.values[name] for r in mine)
        first = mine[0].setting
        found.append(Ladder(method, sizes, values, first.order, first.size is None))
    return found
