"""What an accuracy study knows: its runs, the best answers, and how far each run is off.

An accuracy study: what accuracy costs in time, memory and unknowns.

One factor at a time: methods in space with coarse steps, then schemes in time on the
coarsest adequate mesh, then settings of both together, chosen for each accuracy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from pathlib import Path

from wovenfab.case import read_case
from wovenfab.study.accuracy.climb import Climb, Rung, Runner, Teller
from wovenfab.study.accuracy.ladder import Best, Ladder, best_of, worst
from wovenfab.study.accuracy.measure import Measured
from wovenfab.study.accuracy.pairs import Pairing
from wovenfab.study.accuracy.settings import (
    COARSEST,
    Setting,
    Steps,
    space_ladder,
    space_methods,
    time_ladder,
    time_methods,
)


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


#: Accuracies for which the cheapest setting is sought.
TARGETS = (0.05, 0.01, 0.003, 0.001)
#: A ladder ends when its own error is this share of the least target.
_ENOUGH = 0.02
#: Error of a mesh that is good enough for the study in time.
_ADEQUATE = 0.01
#: Its run with coarse steps takes no more than this share of the time.
_AFFORDABLE = 0.03
#: Where rates count, share of the time for space, and of what then is left for steps; pairs of
#: both have the rest.
_IN_SPACE, _IN_TIME = 0.4, 0.4
#: Share of the time that is left for more of both, where pairs do not prove every accuracy.
_AGAIN = 0.6


def study(
    path: Path,
    overrides: Sequence[str],
    runner: Runner,
    budget: float,
    tell: Teller,
) -> Study:
    """Make the study of a case.

    Args:
        path: The case file.
        overrides: Values that replace those of the file.
        runner: Runs a setting.
        budget: Time for all runs together, s; those that were kept count, too, so that a
            study that was interrupted ends as if it had not been.
        tell: Told before and after each run.
    """
    case = read_case(path, overrides)
    steps = Steps(path, tuple(overrides), case)
    now = Study()
    climb = Climb(path, tuple(overrides), runner, now, tell, _ENOUGH * TARGETS[-1])
    in_time = case.needs.history and steps.can_vary
    coarse = steps.with_factor(COARSEST)
    methods = space_methods(case)
    space = climb.start([space_ladder(m, coarse) for m in methods])
    climb(space, now.space, budget * (_IN_SPACE if in_time else 1.0))
    _judge(now, "space", now.space)
    mesh = _adequate(now, budget) if in_time and now.space else None
    if mesh is not None:
        schemes = climb.start(
            [time_ladder(m, mesh.setting.mesh, steps) for m in time_methods(case)]
        )
        climb(schemes, now.time, now.spent + _IN_TIME * (budget - now.spent))
        _judge(now, "time", now.time)
    if mesh is not None and now.time:
        pairing = Pairing(now, climb, mesh)
        pairing(TARGETS, budget)
        while not all(map(now.within, TARGETS)) and _climb_on(now, climb, (space, schemes), budget):
            pairing(TARGETS, budget)
    for target in TARGETS:
        good = now.within(target)
        now.chosen[target] = min(good, key=_wall) if good else None
    return now


def _climb_on(
    now: Study, climb: Climb, ladders: tuple[Sequence[Rung], Sequence[Rung]], budget: float
) -> bool:
    """Go on with meshes or steps, where less is known if possible; return whether it was."""
    stages = zip(("space", "time"), (now.space, now.time), ladders, strict=True)

    def known(stage: str) -> float:
        return worst({name: best.relative for name, best in now.best[stage].items()})

    for stage, runs, climbing in sorted(stages, key=lambda s: known(s[0]), reverse=True):
        before = len(runs)
        climb(climbing, runs, now.spent + _AGAIN * (budget - now.spent))
        if len(runs) > before:
            _judge(now, stage, runs)
            return True
    return False


def _judge(now: Study, stage: str, runs: Sequence[Run]) -> None:
    """Find the best answer of a stage to each quantity."""
    if runs:
        names = runs[0].measured.values
        now.best[stage] = {name: best_of(ladders_of(runs, name)) for name in names}


def _adequate(now: Study, budget: float) -> Run:
    """Return the run whose mesh the study in time uses.

    The cheapest that is good enough; where the time for several times as many steps with
    each scheme does not allow it, the best that it allows.
    """
    good = sorted((r for r in now.space if worst(now.bounds(r)) <= _ADEQUATE), key=_wall)
    cheap = [r for r in now.space if r.measured.wall <= _AFFORDABLE * budget]
    if good and (good[0] in cheap or not cheap):
        return good[0]
    return min(cheap or now.space, key=lambda r: worst(now.errors(r)) if cheap else _wall(r))


def _wall(run: Run) -> float:
    return run.measured.wall
