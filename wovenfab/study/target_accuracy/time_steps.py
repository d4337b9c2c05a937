"""Steps in time for a target accuracy: equal or adaptive ones, whichever cost less."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from time import perf_counter

from mpi4py import MPI

from wovenfab.case import Case
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.from_case import scheme_of
from wovenfab.simulation.response import (
    Response,
    TooLongError,
    has_fixed_steps,
    response_of,
    with_steps,
)
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.step import StepFailedError
from wovenfab.study.target_accuracy.estimate import SAFETY, StepRefinement, worst

log = logging.getLogger(__name__)

#: Called with a line on each trial.
Report = Callable[[str], None]
#: Returns a case with so many times the steps of the first trial.
Kind = Callable[[Case, float], Case]
#: Share of the usual number of equal steps in the first trial.
FIRST_SHARE = 0.25
#: Error of a step beyond which equal ones are cut, too.
COARSE = 0.5
#: Share of the usual number of steps that adaptive ones are planned with, their first tolerance.
PLANNED, FIRST_TOLERANCE = 0.075, 0.02
#: Growth of the number of steps up to which a trial is extrapolated, and the largest from trial
#: to trial.
FAR, FARTHEST = 2.0, 8.0
#: Growth of the number of steps up to which no other kind is tried.
EASY = 4.0
#: Growth of tangents with twice the steps, at least.
DEARER = 1.4
#: Round-off of an error that just reaches the target.
ALMOST = 1 + 1e-9
#: Highest order of convergence that is believed: where friction reverses, higher ones are lost.
BELIEVED = 2
#: Largest number of steps over that of the first trial, and trials of one kind.
MOST, TRIALS = 128.0, 8


@dataclass(frozen=True)
class TimeSteps:
    """Steps for an accuracy.

    Attributes:
        kind: Equal or adaptive ones.
        number: Of steps over that of the first trial.
        errors: Their signed errors over the figures.
        effort: Tangents in the trial.
        order: In which the errors fall with the number.
    """

    kind: Kind
    number: float
    errors: dict[str, float]
    effort: float
    order: int

    @property
    def estimated_error(self) -> float:
        """The largest error, on the safe side."""
        return SAFETY * worst(self.errors)

    @property
    def words(self) -> str:
        """The kind in words."""
        return _words(self.kind)

    def of(self, case: Case) -> Case:
        """Return a case with these steps."""
        return self.kind(case, self.number)

    def error_of_share(self, share: float) -> float:
        """Return about the largest error of a share of the usual number of equal steps."""
        if self.kind is not equal_steps:
            return inf
        return worst(self.errors) * (FIRST_SHARE * self.number / share) ** self.order


def equal_steps(case: Case, number: float) -> Case:
    """Return a case with ``number`` times the first trial's equal steps, cut where too coarse."""
    return with_steps(case, FIRST_SHARE * number, COARSE if _measured(case) else None)


def adaptive_steps(case: Case, number: float) -> Case:
    """Return a case with about ``number`` times the first trial's adaptive steps."""
    return with_steps(case, PLANNED, FIRST_TOLERANCE / number ** scheme_of(case).order)


class StepSearch:
    """The search for steps by trials on coarse elements; no trial is made twice."""

    def __init__(
        self,
        trial: Case,
        sheet: Sheet,
        report: Report,
        known: tuple[str, float] | None = None,
        patience: float = inf,
    ) -> None:
        """Start without any trial.

        Args:
            trial: What is tried: a case with history, shorter, on coarse elements.
            sheet: Its sheet.
            report: Called with a line on each trial.
            known: Kind and number of the steps that a neighbouring scene needed: they are tried
                first, and taken if they are enough.
            patience: Wall time of all trials after which one is given up, s.
        """
        self._left = patience
        self._trial, self._sheet, self._report = trial, sheet, report
        self._known = known or ("", 1.0)
        self._order = min(scheme_of(trial).order, BELIEVED)
        self._tried: dict[tuple[Kind, float], Response | None] = {}

    def steps_for(self, target: float) -> TimeSteps | None:
        """Return the steps that cost least, or None where none can be chosen; collective.

        Args:
            target: Error of the steps over the figures, on the safe side.
        """
        target, (likely, number) = target / SAFETY, self._known
        kinds: list[Kind] = [] if has_fixed_steps(self._trial) else [equal_steps]
        if _measured(self._trial):
            kinds.append(adaptive_steps)
        kinds.sort(key=lambda kind: _words(kind) != likely)
        options: list[TimeSteps] = []
        for kind in kinds:
            least = min((o.effort for o in options if _reaches(o.errors, target)), default=inf)
            is_known = _words(kind) == likely
            option = self._enough(kind, target, least, number / 2 if is_known else 1.0)
            if option is None:
                continue
            options.append(option)
            log.info(
                "%s: %.3g times the first, error %.2g of %.2g, %.0f tangents",
                option.words, option.number, worst(option.errors), target, option.effort,
            )  # fmt: skip
            if (option.number <= EASY or is_known) and _reaches(option.errors, target):
                break
        if not options:
            return None
        return min(options, key=lambda o: (not _reaches(o.errors, target), o.effort))

    def _enough(self, kind: Kind, target: float, least: float, number: float) -> TimeSteps | None:
        """Return how many steps of a kind are enough.

        None where none can be made, or where they would take more tangents than ``least``. The
        first trial has ``number`` times the first steps.
        """
        fewer: Response | None = None
        best = None
        for _ in range(TRIALS):
            if (more := self._response(kind, number)) is None:
                fewer, number = None, 2 * number
                continue
            tangents, growth = more.outcome.tangents, 2.0
            if fewer is not None and more.count > fewer.count:  # equal numbers show no error
                errors = StepRefinement(fewer, more, self._order).errors()
                need = min((worst(errors) / target) ** (1 / self._order), MOST / number)
                taken = min(max(need, 0.5), FAR)
                scaled = {name: e / taken**self._order for name, e in errors.items()}
                best = TimeSteps(kind, taken * number, scaled, taken * tangents, self._order)
                if need <= FAR:
                    break
                growth = min(need, FARTHEST)
            if DEARER * tangents > least:
                break
            fewer, number = more, growth * number
        return best

    def _response(self, kind: Kind, number: float) -> Response | None:
        """Return the response with so many times the first steps; None where it has no end."""
        if (kind, number) not in self._tried:
            response, start, comm = None, perf_counter(), self._sheet.mesh.comm
            with suppress(StepFailedError, StabilityLostError, TooLongError):
                case = kind(self._trial, number)
                response = response_of(case, self._sheet, seconds=self._left)
                tangents = response.outcome.tangents
                self._report(f"{_words(kind)}: {response.count}, {tangents} tangents")
            self._left -= float(comm.allreduce(perf_counter() - start, op=MPI.MAX))
            self._tried[kind, number] = response
        return self._tried[kind, number]


def _reaches(errors: dict[str, float], target: float) -> bool:
    return worst(errors) <= ALMOST * target


def _measured(case: Case) -> bool:
    """Return whether the error of a step is measured, so that steps can adapt."""
    return case.needs.rate and scheme_of(case).measures_error


def _words(kind: Kind) -> str:
    return kind.__name__.replace("_", " ")
