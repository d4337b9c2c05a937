"""How long a method will take to be accurate enough, from the runs of all so far.

The order of the runs of an accuracy study: how far each ladder is climbed in a given time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from math import exp, inf, log, sqrt
from pathlib import Path

from wovenfab.case import CaseError, read_case
from wovenfab.study.accuracy.ladder import Best, Ladder, best_of, own_error
from wovenfab.study.accuracy.measure import Measured
from wovenfab.study.accuracy.settings import Setting
from wovenfab.study.accuracy.study import Run, Study, ladders_of

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


#: How much longer a run takes with half the mesh size or half the step: as much as the last
#: did, but within these; a ladder's second run half of the most.
_LEAST_GROWTH, _MOST_GROWTH = 2.0, 6.0
#: A ladder rests when it would need so many times the time that is left.
_MARGIN = 3.0
#: A ladder has so many runs at most.
_LONGEST = 8

Runner = Callable[[Setting], Measured]
#: Told before a run with the setting, how long it will take (s) and None; after it with the run.
Teller = Callable[[Study, Setting, float, Run | None], None]


class Climb:
    """Climbs several ladders: the shortest run next, each in its share of the time.

    After three runs a ladder shows its order, and rests if far more time than is left would
    be needed to make its error small enough, or if two others are more accurate already than it
    will be after its next run. What is left goes to the ladder that should get there first, for
    the best answer, and then to the most accurate other, for its check.
    """

    def __init__(
        self,
        path: Path,
        overrides: tuple[str, ...],
        runner: Runner,
        now: Study,
        tell: Teller,
        enough: float,
    ) -> None:
        """Run nothing yet.

        Args:
            path: The case file.
            overrides: Values that replace those of the file.
            runner: Runs a setting.
            now: The study to which the runs belong; its time is counted here.
            tell: Told before and after each run.
            enough: Relative error with which a ladder ends.
        """
        self._path, self._overrides = path, overrides
        self._runner, self._now, self._tell = runner, now, tell
        self._enough = enough
        self._known: dict[tuple[str, ...], Measured] = {}

    @staticmethod
    def start(ladders: Sequence[Iterator[Setting]]) -> list[Rung]:
        """Return where ladders begin."""
        return [Rung(islice(ladder, _LONGEST)) for ladder in ladders]

    def __call__(self, climbing: Sequence[Rung], into: list[Run], until: float) -> None:
        """Climb until the time (s) since the study's start would not be enough; or on."""
        share = (until - self._now.spent) / len(climbing)
        while rung := self._next(climbing, share, until - self._now.spent):
            self._step(rung, into)
            self._foresee([r for r in climbing if r.runs])

    @staticmethod
    def _next(climbing: Sequence[Rung], share: float, left: float) -> Rung | None:
        """Return the ladder whose run is next, or None where the time that is left is too short.

        Args:
            climbing: All ladders.
            share: Time of each, s.
            left: Time of all, s.
        """
        within = [r for r in climbing if r.spent + r.expected <= share and not r.is_hopeless(left)]
        if helpful := [r for r in within if r.helps(climbing)]:
            return min(helpful, key=lambda r: r.expected)
        first = min(climbing, key=lambda r: (r.time, r.error))
        check = min((r for r in climbing if r is not first), key=lambda r: r.error, default=first)
        return next((r for r in (first, check) if r.expected <= left), None)

    def _foresee(self, climbing: Sequence[Rung]) -> None:
        """Say of each ladder that has runs how long it will take; end those accurate enough."""
        names = climbing[0].runs[0].measured.values if climbing else {}
        ladders = [[ladders_of(r.runs, name)[0] for name in names] for r in climbing]
        best = [best_of(of_quantity) for of_quantity in zip(*ladders, strict=True)]
        for rung, mine in zip(climbing, ladders, strict=True):
            if len(rung.runs) > 1:
                found = forecast(mine, best)
                if len(rung.runs) > 2 and found.error <= self._enough:
                    rung.expected = inf
                rung.error, rung.foreseen = found.error, found.next
                rung.time = found.time(self._enough, rung.expected, rung.growth)

    def _step(self, rung: Rung, into: list[Run]) -> None:
        """Make a ladder's next run."""
        setting = next(rung.settings, None)
        run = None if setting is None else self.one(setting, rung.expected)
        if run is None:
            rung.expected = inf
            return
        rung.spent += run.measured.wall
        if run.measured.failure:
            # a mesh may have been too coarse, or steps too long: once more
            rung.expected = inf if rung.failures else rung.expected
            rung.failures += 1
            return
        into.append(run)
        rung.runs.append(run)
        rung.expected = rung.time = rung.growth * run.measured.wall

    def one(self, setting: Setting, expected: float) -> Run | None:
        """Run one setting; None where the case cannot be read with it."""
        try:
            read_case(self._path, (*self._overrides, *setting.overrides))
        except CaseError:
            return None
        found = self._known.get(setting.overrides)
        if found is None:
            self._tell(self._now, setting, expected, None)
            found = self._known[setting.overrides] = self._runner(setting)
            self._now.spent += found.wall
        count = found.unknowns if setting.stage == "space" else found.steps**2
        run = Run(setting, found, setting.size or 1 / sqrt(max(count, 1)))
        if found.failure:
            self._now.failed.append(run)
        self._tell(self._now, setting, expected, run)
        return run


@dataclass
class Rung:
    """Where a ladder has been climbed to; times in s.

    Attributes:
        settings: What is left of it.
        runs: Its runs.
        expected: Time of the next run; infinite where there should be none.
        time: Time until the error is small enough.
        error: Relative error of the last run.
        foreseen: That of the next run.
        spent: Time of its runs.
        failures: How many runs failed.
    """

    settings: Iterator[Setting]
    runs: list[Run] = field(default_factory=list)
    expected: float = 0.0
    time: float = 0.0
    error: float = inf
    foreseen: float = inf
    spent: float = 0.0
    failures: int = 0

    @property
    def growth(self) -> float:
        """How many times as long as the last run the next one will take."""
        walls = [r.measured.wall for r in self.runs[-2:]]
        grown = walls[-1] / walls[0] if len(walls) == 2 else _MOST_GROWTH / 2
        return min(max(grown, _LEAST_GROWTH), _MOST_GROWTH)

    def helps(self, climbing: Sequence[Rung]) -> bool:
        """Whether its next run is to show its order, or may be the best answer or its check."""
        others = sorted(r.error for r in climbing if r is not self)
        return len(self.runs) < 3 or len(others) < 2 or self.foreseen < others[1]

    def is_hopeless(self, left: float) -> bool:
        """Whether the time that is left (s) is far too short, by the order that shows."""
        return len(self.runs) > 2 and _MARGIN * left < self.time < inf
