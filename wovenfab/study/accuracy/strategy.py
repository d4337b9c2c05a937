"""The order of the runs of an accuracy study.

One factor at a time: methods in space with coarse steps, then schemes in time on the
coarsest adequate mesh, then settings of both together, chosen for each accuracy.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, product
from math import inf, sqrt

from wovenfab.case import Case, CaseError
from wovenfab.study.accuracy.errors import Combined, Pair, best_of, forecast, worst
from wovenfab.study.accuracy.measure import Measured
from wovenfab.study.accuracy.settings import Setting, in_space, in_time
from wovenfab.study.accuracy.study import TARGETS, Run, Study, refinements
from wovenfab.study.response import has_fixed_steps

#: A method ends when its own error is this share of the least target.
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
#: How much longer a run takes with half the mesh size or half the step: as much as the last
#: did, but within these; the second run of a method half of the most.
_LEAST_GROWTH, _MOST_GROWTH = 2.0, 6.0
#: A method rests when it would need so many times the time that is left.
_MARGIN = 3.0
#: A method has so many runs at most.
_LONGEST = 8
#: Pairs that are tried for one accuracy before it counts as missed.
_TRIES = 3

Runner = Callable[[Setting], Measured]
#: Called before a run with the setting, its expected time (s) and None; after it with the run.
Report = Callable[[Study, Setting, float, Run | None], None]


def run_study(case: Case, runner: Runner, budget: float, report: Report) -> Study:
    """Make the study of a case.

    Args:
        case: The case.
        runner: Runs a setting.
        budget: Time for all runs together, s; stored results count, too, so that a
            study that was interrupted ends as if it had not been.
        report: Called before and after each run.
    """
    study = Study()
    scheduler = Scheduler(case, runner, study, report, _ENOUGH * TARGETS[-1])
    time_counts = case.needs.history and not has_fixed_steps(case)
    space = scheduler.start(in_space(case))
    scheduler.run(space, study.space, budget * (_IN_SPACE if time_counts else 1.0))
    _judge(study, "space", study.space)
    mesh = _adequate(study, budget) if time_counts and study.space else None
    if mesh is not None:
        schemes = scheduler.start(in_time(case, mesh.setting.mesh))
        scheduler.run(schemes, study.time, study.spent + _IN_TIME * (budget - study.spent))
        _judge(study, "time", study.time)
    if mesh is not None and study.time:
        pairs = PairScheduler(study, scheduler, mesh)
        pairs.run(TARGETS, budget)
        while not all(map(study.within, TARGETS)) and _continue(
            study, scheduler, (space, schemes), budget
        ):
            pairs.run(TARGETS, budget)
    for target in TARGETS:
        good = study.within(target)
        study.chosen[target] = min(good, key=_wall) if good else None
    return study


def _continue(
    study: Study,
    scheduler: Scheduler,
    methods: tuple[Sequence[MethodState], Sequence[MethodState]],
    budget: float,
) -> bool:
    """Go on with meshes or steps, where less is known if possible; return whether it was."""
    stages = zip(("space", "time"), (study.space, study.time), methods, strict=True)

    def known(stage: str) -> float:
        return worst({name: best.relative for name, best in study.best[stage].items()})

    for stage, runs, states in sorted(stages, key=lambda s: known(s[0]), reverse=True):
        before = len(runs)
        scheduler.run(states, runs, study.spent + _AGAIN * (budget - study.spent))
        if len(runs) > before:
            _judge(study, stage, runs)
            return True
    return False


def _judge(study: Study, stage: str, runs: Sequence[Run]) -> None:
    """Set the best answer of a stage to each quantity."""
    if runs:
        names = runs[0].measured.values
        study.best[stage] = {name: best_of(refinements(runs, name)) for name in names}


def _adequate(study: Study, budget: float) -> Run:
    """Return the run whose mesh the study in time uses.

    The cheapest that is good enough; where the time for several times as many steps with
    each scheme does not allow it, the best that it allows.
    """
    good = sorted((r for r in study.space if worst(study.bounds(r)) <= _ADEQUATE), key=_wall)
    cheap = [r for r in study.space if r.measured.wall <= _AFFORDABLE * budget]
    if good and (good[0] in cheap or not cheap):
        return good[0]
    return min(cheap or study.space, key=lambda r: worst(study.errors(r)) if cheap else _wall(r))


def _wall(run: Run) -> float:
    return run.measured.wall


@dataclass
class MethodState:
    """How far a method has been refined; times in s.

    Attributes:
        settings: The settings that are left.
        runs: Its runs.
        expected: Time of the next run; infinite where there should be none.
        time: Time until the error is small enough.
        error: Relative error of the last run.
        next_error: Expected relative error of the next run.
        spent: Time of its runs.
        failures: How many runs failed.
    """

    settings: Iterator[Setting]
    runs: list[Run] = field(default_factory=list)
    expected: float = 0.0
    time: float = 0.0
    error: float = inf
    next_error: float = inf
    spent: float = 0.0
    failures: int = 0

    @property
    def growth(self) -> float:
        """How many times as long as the last run the next one will take."""
        walls = [r.measured.wall for r in self.runs[-2:]]
        grown = walls[-1] / walls[0] if len(walls) == 2 else _MOST_GROWTH / 2
        return min(max(grown, _LEAST_GROWTH), _MOST_GROWTH)

    def is_useful(self, states: Sequence[MethodState]) -> bool:
        """Whether its next run is to show its order, or may be the best answer or its check."""
        others = sorted(s.error for s in states if s is not self)
        return len(self.runs) < 3 or len(others) < 2 or self.next_error < others[1]

    def is_hopeless(self, left: float) -> bool:
        """Whether the time that is left (s) is far too short, by the observed order."""
        return len(self.runs) > 2 and _MARGIN * left < self.time < inf


@dataclass
class Scheduler:
    """Refines several methods: the shortest run next, each method in its share of the time.

    After three runs a method shows its order, and rests if far more time than is left would
    be needed to make its error small enough, or if two others are more accurate already than it
    will be after its next run. What is left goes to the method that should get there first, for
    the best answer, and then to the most accurate other, for its check.

    Attributes:
        case: The case.
        runner: Runs a setting.
        study: The study to which the runs belong; its time is counted here.
        report: Called before and after each run.
        enough: Relative error with which a method ends.
    """

    case: Case
    runner: Runner
    study: Study
    report: Report
    enough: float
    _results: dict[tuple[str, ...], Measured] = field(default_factory=dict)

    @staticmethod
    def start(settings: Sequence[Iterator[Setting]]) -> list[MethodState]:
        """Return the states of methods before their first runs."""
        return [MethodState(islice(of_method, _LONGEST)) for of_method in settings]

    def run(self, states: Sequence[MethodState], runs: list[Run], until: float) -> None:
        """Refine the methods until the time (s) since the study's start would not be enough."""
        share = (until - self.study.spent) / len(states)
        while state := self._next(states, share, until - self.study.spent):
            self._refine(state, runs)
            self._foresee([s for s in states if s.runs])

    @staticmethod
    def _next(states: Sequence[MethodState], share: float, left: float) -> MethodState | None:
        """Return the method whose run is next, or None where the time (s) is too short.

        Each method has its share of the time that is left to all.
        """
        within = [s for s in states if s.spent + s.expected <= share and not s.is_hopeless(left)]
        if useful := [s for s in within if s.is_useful(states)]:
            return min(useful, key=lambda s: s.expected)
        first = min(states, key=lambda s: (s.time, s.error))
        check = min((s for s in states if s is not first), key=lambda s: s.error, default=first)
        return next((s for s in (first, check) if s.expected <= left), None)

    def _foresee(self, states: Sequence[MethodState]) -> None:
        """Forecast error and time of each method that has runs; end those accurate enough."""
        names = states[0].runs[0].measured.values if states else {}
        of_methods = [[refinements(s.runs, name)[0] for name in names] for s in states]
        best = [best_of(of_quantity) for of_quantity in zip(*of_methods, strict=True)]
        for state, of_method in zip(states, of_methods, strict=True):
            if len(state.runs) > 1:
                expected = forecast(of_method, best)
                if len(state.runs) > 2 and expected.error <= self.enough:
                    state.expected = inf
                state.error, state.next_error = expected.error, expected.next
                state.time = expected.time(self.enough, state.expected, state.growth)

    def _refine(self, state: MethodState, runs: list[Run]) -> None:
        """Make a method's next run."""
        setting = next(state.settings, None)
        run = None if setting is None else self.run_one(setting, state.expected)
        if run is None:
            state.expected = inf
            return
        state.spent += run.measured.wall
        if run.measured.failure:
            # a mesh may have been too coarse, or steps too long: once more
            state.expected = inf if state.failures else state.expected
            state.failures += 1
            return
        runs.append(run)
        state.runs.append(run)
        state.expected = state.time = state.growth * run.measured.wall

    def run_one(self, setting: Setting, expected: float) -> Run | None:
        """Run one setting; None where the case cannot be read with it."""
        try:
            self.case.changed(*setting.overrides)
        except CaseError:
            return None
        measured = self._results.get(setting.overrides)
        if measured is None:
            self.report(self.study, setting, expected, None)
            measured = self._results[setting.overrides] = self.runner(setting)
            self.study.spent += measured.wall
        count = measured.unknowns if setting.stage == "space" else measured.steps**2
        run = Run(setting, measured, setting.size or 1 / sqrt(max(count, 1)))
        if measured.failure:
            self.study.failed.append(run)
        self.report(self.study, setting, expected, run)
        return run


_Parts = tuple[Run, Run]


@dataclass
class PairScheduler:
    """Runs the cheapest pair of a mesh and steps that promises each accuracy.

    After each pair the mixed part of the best answers is better known, so an accuracy may be
    proven by a pair that was run for another one.

    Attributes:
        study: The study, whose runs in space and in time are done.
        scheduler: Runs a setting.
        base: The run whose mesh the study in time used.
    """

    study: Study
    scheduler: Scheduler
    base: Run
    _tried: list[_Parts] = field(default_factory=list)
    _pairs: dict[str, tuple[Pair, ...]] = field(default_factory=dict)
    _answers: dict[str, Combined] = field(default_factory=dict)

    def run(self, targets: Sequence[float], until: float) -> None:
        """Run pairs until each accuracy is proven or has had its tries, or time (s) is out.

        May be called again when there are more runs in space or in time.
        """
        self._judge()
        tries: Counter[float] = Counter()
        while chosen := self._next(targets, tries, until):
            target, parts = chosen
            tries[target] += 1
            self._tried.append(parts)
            run = self.scheduler.run_one(_setting(parts), self._cost(parts))
            if run is not None and not run.measured.failure:
                self.study.both.append(run)
                for name, value in run.measured.values.items():
                    pair = replace(_pair(parts, name), value=value)
                    self._pairs[name] = (*self._pairs.get(name, ()), pair)
                self._judge()

    def _next(
        self, targets: Sequence[float], tries: Counter[float], until: float
    ) -> tuple[float, _Parts] | None:
        """Return the first accuracy that is not proven and the cheapest pair for it."""
        left = [p for p in product(self.study.space, self.study.time) if p not in self._tried]
        affordable = [p for p in left if self.study.spent + self._cost(p) <= until]
        for target in targets:
            if self.study.within(target) or tries[target] == _TRIES:
                continue
            if good := [p for p in affordable if self._promised(p) <= target]:
                return target, min(good, key=self._cost)
        return None

    def _judge(self) -> None:
        space, time = self.study.best["space"], self.study.best["time"]
        self._answers = {
            name: Combined(space[name], time[name], value, self._pairs.get(name, ()))
            for name, value in self.base.measured.values.items()
        }
        self.study.best["both"] = {name: answer.best for name, answer in self._answers.items()}

    def _promised(self, parts: _Parts) -> float:
        """Return the worst error that a pair should have, that of the best answer included."""
        mesh, steps = map(self.study.errors, parts)
        return worst(
            {
                name: mesh[name] + steps[name] + answer.bound(_pair(parts, name))
                for name, answer in self._answers.items()
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
