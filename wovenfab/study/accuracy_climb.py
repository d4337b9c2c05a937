"""The order of the runs of an accuracy study: how far each ladder is climbed in a given time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from math import inf, sqrt
from pathlib import Path

from wovenfab.case import CaseError, read_case
from wovenfab.study.accuracy_error import own_error
from wovenfab.study.accuracy_result import Run, Study, ladders_of
from wovenfab.study.accuracy_run import Measured
from wovenfab.study.accuracy_settings import Setting

#: How much longer a run takes with half the mesh size or half the step: as much as the last
#: did, but within these; a ladder's second run half of the most.
_LEAST_GROWTH, _MOST_GROWTH = 2.0, 6.0
#: A ladder has so many runs at most.
_LONGEST = 8

Runner = Callable[[Setting], Measured]
#: Told before a run with the setting, how long it will take (s) and None; after it with the run.
Teller = Callable[[Study, Setting, float, Run | None], None]


class Climb:
    """Climbs several ladders: the shortest run next, each in its share of the time.

    What is left goes to the two methods that converge best, for the best answer and its check.
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

    def __call__(self, ladders: Sequence[Iterator[Setting]], into: list[Run], until: float) -> None:
        """Climb until the time (s) since the study's start would not be enough."""
        climbing = [_Rung(islice(ladder, _LONGEST)) for ladder in ladders]
        share = (until - self._now.spent) / len(climbing)
        for rung in climbing:
            rung.allowed = share
        while waiting := [r for r in climbing if r.spent + r.expected <= r.allowed]:
            self._step(min(waiting, key=lambda r: r.expected), into)
        for rung in sorted(climbing, key=lambda r: r.error)[:2]:
            while not rung.ended and self._now.spent + rung.expected <= until:
                self._step(rung, into)

    def _step(self, rung: _Rung, into: list[Run]) -> None:
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
        done = len(rung.runs) > 2 and rung.error <= self._enough
        rung.expected = inf if done else rung.growth * run.measured.wall

    def one(self, setting: Setting, expected: float) -> Run | None:
        """Run one setting; None where the case cannot be read with it."""
        try:
            read_case(self._path, (*self._overrides, *setting.overrides))
        except CaseError:
            return None
        self._tell(self._now, setting, expected, None)
        found = self._runner(setting)
        count = found.unknowns if setting.stage == "space" else found.steps**2
        run = Run(setting, found, 1 / sqrt(max(count, 1)))
        self._now.spent += found.wall
        if found.failure:
            self._now.failed.append(run)
        self._tell(self._now, setting, expected, run)
        return run


@dataclass
class _Rung:
    """Where a ladder has been climbed to; times in s."""

    settings: Iterator[Setting]
    runs: list[Run] = field(default_factory=list)
    expected: float = 0.0
    spent: float = 0.0
    allowed: float = 0.0
    failures: int = 0

    @property
    def ended(self) -> bool:
        """Whether no further run is worth it."""
        return self.expected == inf

    @property
    def growth(self) -> float:
        """How many times as long as the last run the next one will take."""
        walls = [r.measured.wall for r in self.runs[-2:]]
        grown = walls[-1] / walls[0] if len(walls) == 2 else _MOST_GROWTH / 2
        return min(max(grown, _LEAST_GROWTH), _MOST_GROWTH)

    @property
    def error(self) -> float:
        """Relative error of the last run's worst quantity, as the ladder itself suggests."""
        names = self.runs[-1].measured.values if self.runs else {}
        ladders = [ladder for name in names for ladder in ladders_of(self.runs, name)]
        return max((own_error(v) / abs(v.values[-1] or inf) for v in ladders), default=inf)
