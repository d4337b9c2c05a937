"""An accuracy study: what accuracy costs in time, memory and unknowns.

One factor at a time: methods in space with coarse steps, then schemes in time on the
coarsest adequate mesh, then settings of both together, chosen for each accuracy.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from wovenfab.case import read_case
from wovenfab.study.precision.climb import Climb, Rung, Runner, Teller
from wovenfab.study.precision.error import best_of, worst
from wovenfab.study.precision.pairs import Pairing
from wovenfab.study.precision.result import Run, Study, ladders_of
from wovenfab.study.precision.settings import (
    COARSEST,
    Steps,
    space_ladder,
    space_methods,
    time_ladder,
    time_methods,
)

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
