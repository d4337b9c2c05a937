"""Steps in time that reach a wanted accuracy: equal ones or adaptive ones, whichever cost less."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf

from wovenfab.case import Case
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.from_case import scheme_of
from wovenfab.simulation.response import Response, keeps_its_steps, paced, response_of
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.step import StepFailedError
from wovenfab.study.target_accuracy.estimate import Pair, worst

Tell = Callable[[str], None]
#: Share of the usual number of equal steps with which is begun.
BEGIN = 0.25
#: Error of a step beyond which equal ones are cut, too.
ROUGH = 0.5
#: Share of the usual number of steps that adaptive ones are planned with, their first tolerance.
PLANNED, FIRST = 0.075, 0.02
#: Growth of the number of steps beyond which is tried again, and largest from trial to trial.
FAR, FARTHEST = 2.0, 8.0
#: Growth of the number of steps up to which no other kind is tried.
EASY = 4.0
#: Growth of tangents with twice the steps, at least.
DEARER = 1.4
#: Round-off of an error that is just what is wanted.
ALMOST = 1 + 1e-9
#: Largest number of steps over that of the first trial, and trials of one kind.
MOST, TRIALS = 128.0, 8


@dataclass(frozen=True)
class Paced:
    """Steps for an accuracy.

    Attributes:
        case: The case with them.
        errors: Their signed errors over the figures.
        effort: Tangents in the pilot's trial.
    """

    case: Case
    errors: dict[str, float]
    effort: float


def equal_steps(case: Case, number: float) -> Case:
    """Return a case with ``number`` times the first trial's equal steps, cut where rough."""
    return paced(case, BEGIN * number, ROUGH if _measured(case) else None)


def adaptive_steps(case: Case, number: float) -> Case:
    """Return a case with about ``number`` times the first trial's adaptive steps."""
    return paced(case, PLANNED, FIRST / number**2)


Kind = Callable[[Case, float], Case]


def steps_for(case: Case, trial: Case, sheet: Sheet, wanted: float, tell: Tell) -> Paced | None:
    """Return the steps with which a case costs least, or None where none can be chosen.

    Args:
        case: The case.
        trial: What is tried for it: shorter, on coarse elements.
        sheet: The sheet of the trial.
        wanted: Error of the steps over the figures.
        tell: Called with what is being done.
    """
    if not case.needs.history:
        return None
    kinds: list[Kind] = [] if keeps_its_steps(case) else [equal_steps]
    if _measured(case):
        kinds.append(adaptive_steps)
    found: list[Paced] = []
    for kind in kinds:
        least = min((f.effort for f in found if worst(f.errors) <= ALMOST * wanted), default=inf)
        if (best := _enough(kind, trial, sheet, wanted, least, tell)) is not None:
            number, errors, effort = best
            found.append(Paced(kind(case, number), errors, effort))
            if number <= EASY and worst(errors) <= ALMOST * wanted:
                break
    return (
        min(found, key=lambda f: (worst(f.errors) > ALMOST * wanted, f.effort)) if found else None
    )


def _measured(case: Case) -> bool:
    """Return whether the error of a step is measured, so that steps can adapt."""
    return case.needs.rate and case.time.scheme == "bdf2"


def _enough(
    kind: Kind, trial: Case, sheet: Sheet, wanted: float, least: float, tell: Tell
) -> tuple[float, dict[str, float], float] | None:
    """Return how many times the first steps are enough, their errors and tangents.

    None where none can be made, or where they would take more tangents than ``least``.
    """
    fewer: Response | None = None
    best, number = None, 1.0
    order = scheme_of(trial).order
    for _ in range(TRIALS):
        try:
            more = response_of(kind(trial, number), sheet)
        except (StepFailedError, StabilityLostError):
            fewer, number = None, 2 * number
            continue
        tell(f"{kind.__name__.replace('_', ' ')}: {more.steps}, {more.tangents} tangents")
        growth = 2.0
        if fewer is not None and more.steps > fewer.steps:  # as many tell nothing
            errors = Pair(fewer, more, order).errors()
            need = min((worst(errors) / wanted) ** (1 / order), MOST / number)
            taken = min(max(need, 0.5), FAR)
            scaled = {name: e / taken**order for name, e in errors.items()}
            best = taken * number, scaled, taken * more.tangents
            if need <= FAR:
                break
            growth = min(need, FARTHEST)
        if DEARER * more.tangents > least:
            break
        fewer, number = more, growth * number
    return best
