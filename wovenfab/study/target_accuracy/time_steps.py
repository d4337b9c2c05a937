"""Steps in time for a target accuracy: equal or adaptive ones, whichever cost less."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from math import inf
from time import perf_counter

import numpy as np
from mpi4py import MPI
from scipy.interpolate import CubicSpline

from wovenfab.case import Case
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.from_case import scheme_of
from wovenfab.simulation.response import (
    Response,
    TooLongError,
    has_fixed_steps,
    missed_peak,
    response_of,
    time_of_peak,
    with_steps,
)
from wovenfab.stepping.program import program_of_case
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.step import StepFailedError
from wovenfab.study.target_accuracy.estimate import PEAK, SAFETY, StepRefinement, worst

log = logging.getLogger(__name__)

#: Called with a line on each trial.
Report = Callable[[str], None]
#: Returns a case with so many times the steps of the first trial.
Kind = Callable[[Case, float], Case]
#: Share of the peak that is counted as missed over what is expected from trials.
UNSURE = 2.0
#: Share of the usual number of equal steps in the first trial.
FIRST_SHARE = 0.25
#: Error of a step beyond which equal ones are cut, too.
COARSE = 0.5
#: Share of the usual number of steps that adaptive ones are planned with, their first tolerance.
PLANNED, FIRST_TOLERANCE = 0.075, 0.02
#: Growth of the number of steps up to which a trial is extrapolated, and the largest from trial
#: to trial; growth in which numbers are tried until a step meets the peak.
FAR, FARTHEST, A_LITTLE = 2.0, 8.0, 1.03
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
        missed: Share of the peak of the force that is missed between steps, besides.
    """

    kind: Kind
    number: float
    errors: dict[str, float]
    effort: float
    order: int
    missed: float = 0.0

    @property
    def estimated_error(self) -> float:
        """The largest error, on the safe side."""
        peak = SAFETY * abs(self.errors.get(PEAK, 0.0)) + UNSURE * self.missed
        return max(peak, SAFETY * worst(self.errors))

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
        self._left, self._delay = patience, 0.0
        self._trial, self._sheet, self._report = trial, sheet, report
        self._known = known or ("", 1.0)
        self._order = min(scheme_of(trial).order, BELIEVED)
        self._tried: dict[tuple[Kind, float], Response | None] = {}

    def delay_of_peak(self, other: Response, share: float) -> float:
        """Return how much later the force is largest in a response with other elements, s.

        Args:
            other: The response, with a share of the usual steps.
            share: That share.
        """
        with suppress(StepFailedError, StabilityLostError):
            own = response_of(with_steps(self._trial, share), self._sheet)
            return time_of_peak(other.times, other.forces) - time_of_peak(own.times, own.forces)
        return 0.0

    def steps_for(self, target: float, delay: float = 0.0) -> TimeSteps | None:
        """Return the steps that cost least, or None where none can be chosen; collective.

        Args:
            target: Error of the steps over the figures, on the safe side.
            delay: Time by which the force is largest later than with the elements of trials, s.
        """
        self._delay, (likely, number) = delay, self._known
        kinds: list[Kind] = [] if has_fixed_steps(self._trial) else [equal_steps]
        if _measured(self._trial):
            kinds.append(adaptive_steps)
        kinds.sort(key=lambda kind: _words(kind) != likely)
        options: list[TimeSteps] = []
        for kind in kinds:
            least = min((o.effort for o in options if _reaches(o, target)), default=inf)
            is_known = _words(kind) == likely
            option = self._enough(kind, target, least, number / 2 if is_known else 1.0)
            if option is None:
                continue
            options.append(option)
            log.info(
                "%s: %.3g times the first, error %.2g of %.2g, %.0f tangents",
                option.words, option.number, option.estimated_error, target, option.effort,
            )  # fmt: skip
            if (option.number <= EASY or is_known) and _reaches(option, target):
                break
        if not options:
            return None
        return min(options, key=lambda o: (not _reaches(o, target), o.effort))

    def _enough(self, kind: Kind, target: float, least: float, number: float) -> TimeSteps | None:
        """Return how many steps of a kind are enough.

        None where none can be made, or where they would take more tangents than ``least``. The
        first trial has ``number`` times the first steps.
        """
        fewer: Response | None = None
        best = None
        if len(tried := [n for k, n in self._tried if k is kind and self._tried[k, n]]) > 1:
            number = sorted(tried)[-2]
        for _ in range(TRIALS):
            if (more := self._response(kind, number)) is None:
                fewer, number = None, 2 * number
                continue
            finer = [n / number for n in tried if n > number]
            tangents, growth = more.outcome.tangents, min(finer, default=2.0)
            if fewer is not None and more.count > fewer.count:  # equal numbers show no error
                errors = StepRefinement(fewer, more, self._order).errors()
                need = (SAFETY * worst(errors) / target) ** (1 / self._order)
                need = min(need, MOST / number)
                at_most = TimeSteps(kind, number, errors, tangents, self._order)
                best = self._that_meet_the_peak(at_most, more, min(max(need, 0.5), FAR), target)
                if need <= FAR:
                    break
                growth = min(need, FARTHEST)
            if DEARER * tangents > least:
                break
            fewer, number = more, growth * number
        return best

    def _that_meet_the_peak(
        self, tried: TimeSteps, response: Response, least: float, target: float
    ) -> TimeSteps:
        """Return steps, at least so many times those that were tried, that miss little of the peak.

        Equal steps meet it or not by chance, which hardly depends on the elements.
        """
        options, growth = [], least
        while growth <= max(least, FAR):
            number, errors = growth * tried.number, tried.errors
            times, forces = response.times, response.forces
            if tried.kind is equal_steps:
                planned = program_of_case(equal_steps(self._trial, number)).milestones
                curve = CubicSpline(times + self._delay, forces)
                times = np.array([milestone.time for milestone in planned])
                forces = curve(times)
            missed = missed_peak(times, forces)
            scaled = {name: e / growth**tried.order for name, e in errors.items()}
            option = replace(
                tried, number=number, errors=scaled, effort=growth * tried.effort, missed=missed
            )
            if _reaches(option, target):
                return option
            options.append(option)
            growth *= A_LITTLE
        return min(options, key=lambda o: o.estimated_error)

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


def _reaches(steps: TimeSteps, target: float) -> bool:
    return steps.estimated_error <= ALMOST * target


def _measured(case: Case) -> bool:
    """Return whether the error of a step is measured, so that steps can adapt."""
    return case.needs.rate and scheme_of(case).measures_error


def _words(kind: Kind) -> str:
    return kind.__name__.replace("_", " ")
