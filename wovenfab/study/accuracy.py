"""An accuracy study: what accuracy costs in time, memory and unknowns.

One factor at a time: methods in space with coarse steps, then schemes in time on the
coarsest adequate mesh, then settings of both together, chosen for each accuracy.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path

from wovenfab.case import read_case
from wovenfab.study.accuracy_climb import Climb, Runner, Teller
from wovenfab.study.accuracy_error import best_of, combined, worst
from wovenfab.study.accuracy_result import Run, Study, ladders_of
from wovenfab.study.accuracy_settings import (
    COARSEST,
    Setting,
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
#: Shares of the time for space alone where rates count, and for both before combinations.
_IN_SPACE, _IN_BOTH = 0.4, 0.8
#: Combinations that are tried for one accuracy before it counts as missed.
_TRIES = 2


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
    ladders = [space_ladder(m, coarse) for m in methods]
    climb(ladders, now.space, budget * (_IN_SPACE if in_time else 1.0))
    _judge(now, "space", now.space)
    mesh = _adequate(now, budget) if in_time and now.space else None
    if mesh is not None:
        schemes = [time_ladder(m, mesh.setting.mesh, steps) for m in time_methods()]
        climb(schemes, now.time, budget * _IN_BOTH)
        _judge(now, "time", now.time)
    if mesh is not None and now.time:
        now.best["both"] = {
            name: combined(now.best["space"][name], now.best["time"][name], base)
            for name, base in mesh.measured.values.items()
        }
        _combine(now, climb, mesh, budget)
        return now
    for target in TARGETS:
        good = [r for r in now.space if worst(now.bounds(r)) <= target]
        now.chosen[target] = min(good, key=_wall) if good else None
    return now


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


def _combine(now: Study, climb: Climb, base: Run, budget: float) -> None:
    """Choose mesh and steps together for each accuracy, and run what was chosen."""

    def cost(pair: tuple[Run, Run]) -> float:
        space, steps = (r.measured for r in pair)
        return space.setup + space.each_step * steps.stepping / base.measured.each_step

    def bound(pair: tuple[Run, Run]) -> float:
        first, second = map(now.bounds, pair)
        return worst({name: first[name] + second[name] for name in first})

    done: dict[str, Run] = {}
    pairs = sorted(product(now.space, now.time), key=cost)
    for target in TARGETS:
        now.chosen[target] = None
        for pair in [p for p in pairs if bound(p) <= target][:_TRIES]:
            mesh, steps = (r.setting for r in pair)
            what = f"{mesh.what}, {steps.method}, {steps.what}"
            setting = Setting("both", mesh.method, mesh.order, what, mesh.mesh, steps.steps)
            if setting.label not in done:
                if now.spent + cost(pair) > budget:
                    continue
                run = climb.one(setting, cost(pair))
                if run is None or run.measured.failure:
                    continue
                now.both.append(run)
                done[setting.label] = run
            if worst(now.bounds(done[setting.label])) <= target:
                now.chosen[target] = done[setting.label]
                break
