"""Steps in time that reach a wanted accuracy: equal ones or adaptive ones, whichever cost less."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from wovenfab.case import Case
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.assemble import scheme_of
from wovenfab.simulation.trace import Trace, keeps_its_steps, paced, trace_of
from wovenfab.stepping.failure import StepFailedError
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.study.estimate import FEW, Pair, worst

Tell = Callable[[str], None]
#: Share of the usual number of equal steps with which is begun.
BEGIN = 0.25
#: Error of a step beyond which equal ones are cut, too.
ROUGH = 0.5
#: Tolerance with which adaptive steps begin.
FIRST = 0.02
#: Growth of the number of steps beyond which is tried again.
FAR = 2.0
#: Round-off of an error that is just what is wanted.
ALMOST = 1 + 1e-9
#: Trials of one kind, each with twice the steps.
TRIALS = 7


@dataclass(frozen=True)
class Paced:
    """Steps for an accuracy.

    Attributes:
        case: The case with them.
        errors: Their signed errors over the figures.
        effort: Newton iterations in the pilot's trial.
    """

    case: Case
    errors: dict[str, float]
    effort: float


def equal_steps(case: Case, number: float) -> Case:
    """Return a case with ``number`` times the first trial's equal steps, cut where rough."""
    return paced(case, BEGIN * number, ROUGH if _measured(case) else None)


def adaptive_steps(case: Case, number: float) -> Case:
    """Return a case with about ``number`` times the first trial's adaptive steps."""
    return paced(case, FEW, FIRST / number**2)


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
    found = []
    for kind in kinds:
        if (best := _enough(kind, trial, sheet, wanted, tell)) is not None:
            number, errors, effort = best
            found.append(Paced(kind(case, number), errors, effort))
    return (
        min(found, key=lambda f: (worst(f.errors) > ALMOST * wanted, f.effort)) if found else None
    )


def _measured(case: Case) -> bool:
    """Return whether the error of a step is measured, so that steps can adapt."""
    return case.needs.rate and case.time.scheme == "bdf2"


def _enough(
    kind: Kind, trial: Case, sheet: Sheet, wanted: float, tell: Tell
) -> tuple[float, dict[str, float], float] | None:
    """Return how many times the first steps are enough, their errors and iterations."""
    fewer: Trace | None = None
    best = None
    order = scheme_of(trial).order
    for level in range(TRIALS):
        number = 2.0**level
        try:
            more = trace_of(kind(trial, number), sheet)
        except (StepFailedError, StabilityLostError):
            fewer = None
            continue
        tell(f"{kind.__name__.replace('_', ' ')}: {more.steps}, {more.iterations} iterations")
        if fewer is not None and more.steps > fewer.steps:  # as many tell nothing
            errors = Pair(fewer, more, order).errors()
            need = (worst(errors) / wanted) ** (1 / order)
            far = need > FAR and level + 1 < TRIALS
            need = min(max(need, 0.5), 1.0 if level + 1 == TRIALS else FAR)
            scaled = {name: e / need**order for name, e in errors.items()}
            best = need * number, scaled, need * more.iterations
            if not far:
                break
        fewer = more
    return best
