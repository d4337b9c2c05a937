"""Steps in time for a target accuracy: equal or adaptive ones, whichever cost less."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from math import inf

from wovenfab.case import Case
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.from_case import scheme_of
from wovenfab.simulation.response import Response, has_fixed_steps, response_of, with_steps
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.step import StepFailedError
from wovenfab.study.target_accuracy.estimate import StepRefinement, worst

log = logging.getLogger(__name__)

#: Called with a line on each trial.
Report = Callable[[str], None]
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
        case: The case with them.
        errors: Their signed errors over the figures.
        effort: Tangents in the trial.
        kind: Equal or adaptive steps, in words.
        number: Of steps over that of the first trial.
    """

    case: Case
    errors: dict[str, float]
    effort: float
    kind: str
    number: float


def equal_steps(case: Case, number: float) -> Case:
    """Return a case with ``number`` times the first trial's equal steps, cut where too coarse."""
    return with_steps(case, FIRST_SHARE * number, COARSE if _measured(case) else None)


def adaptive_steps(case: Case, number: float) -> Case:
    """Return a case with about ``number`` times the first trial's adaptive steps."""
    return with_steps(case, PLANNED, FIRST_TOLERANCE / number ** scheme_of(case).order)


Kind = Callable[[Case, float], Case]


def steps_for(
    case: Case,
    trial: Case,
    sheet: Sheet,
    target: float,
    report: Report,
    known: tuple[str, float] | None = None,
) -> TimeSteps | None:
    """Return the steps with which a case costs least, or None where none can be chosen.

    Args:
        case: The case.
        trial: What is tried for it: shorter, on coarse elements.
        sheet: The sheet of the trial.
        target: Error of the steps over the figures.
        report: Called with a line on each trial.
        known: Kind and number of the steps that a neighbouring scene needed: they are tried first,
            and taken if they are enough.
    """
    if not case.needs.history:
        return None
    words, likely = known or ("", 1.0)
    kinds: list[Kind] = [] if has_fixed_steps(case) else [equal_steps]
    if _measured(case):
        kinds.append(adaptive_steps)
    kinds.sort(key=lambda kind: _words(kind) != words)
    options: list[TimeSteps] = []
    for kind in kinds:
        least = min((o.effort for o in options if _reaches(o.errors, target)), default=inf)
        first = likely / 2 if _words(kind) == words else 1.0
        if (enough := _enough(kind, trial, sheet, target, least, report, first)) is None:
            continue
        number, errors, effort = enough
        options.append(TimeSteps(kind(case, number), errors, effort, _words(kind), number))
        log.info(
            "%s: %.3g times the first, error %.2g of %.2g, %.0f tangents",
            _words(kind), number, worst(errors), target, effort,
        )  # fmt: skip
        if (number <= EASY or _words(kind) == words) and _reaches(errors, target):
            break
    if not options:
        return None
    chosen = min(options, key=lambda o: (not _reaches(o.errors, target), o.effort))
    log.info(
        "steps: %d a cycle, tolerance %s: fewest tangents of %d kinds",
        chosen.case.time.steps_per_cycle, chosen.case.time.tolerance, len(options),
    )  # fmt: skip
    return chosen


def _reaches(errors: dict[str, float], target: float) -> bool:
    return worst(errors) <= ALMOST * target


def _measured(case: Case) -> bool:
    """Return whether the error of a step is measured, so that steps can adapt."""
    return case.needs.rate and scheme_of(case).measures_error


def _words(kind: Kind) -> str:
    return kind.__name__.replace("_", " ")


def _enough(
    kind: Kind,
    trial: Case,
    sheet: Sheet,
    target: float,
    least: float,
    report: Report,
    number: float,
) -> tuple[float, dict[str, float], float] | None:
    """Return how many times the first steps are enough, their errors and tangents.

    None where none can be made, or where they would take more tangents than ``least``. The first
    trial has ``number`` times the first steps.
    """
    fewer: Response | None = None
    best = None
    order = min(scheme_of(trial).order, BELIEVED)
    for _ in range(TRIALS):
        try:
            more = response_of(kind(trial, number), sheet)
        except (StepFailedError, StabilityLostError):
            fewer, number = None, 2 * number
            continue
        tangents = more.outcome.tangents
        report(f"{_words(kind)}: {more.count}, {tangents} tangents")
        growth = 2.0
        if fewer is not None and more.count > fewer.count:  # equal numbers show no error
            errors = StepRefinement(fewer, more, order).errors()
            need = min((worst(errors) / target) ** (1 / order), MOST / number)
            taken = min(max(need, 0.5), FAR)
            scaled = {name: e / taken**order for name, e in errors.items()}
            best = taken * number, scaled, taken * tangents
            if need <= FAR:
                break
            growth = min(need, FARTHEST)
        if DEARER * tangents > least:
            break
        fewer, number = more, growth * number
    return best
