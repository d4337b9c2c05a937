"""A target accuracy in words: its time, what was chosen before a run, and its errors after it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.case import Case, CyclesSection
from wovenfab.case.objects import sheet_of
from wovenfab.case.program import prescribe_forces
from wovenfab.record.history import ERRORS, index_of_peak, peak_force
from wovenfab.record.summary import write_summary
from wovenfab.sheet.sheet import Sheet
from wovenfab.study.errors.choice import USUAL_ACCURACY, Plan, plan
from wovenfab.study.errors.estimate import Estimate, stated_error
from wovenfab.study.errors.step_search import ALMOST
from wovenfab.study.errors.steps import PEAKS
from wovenfab.study.force_curve import ForceCurve
from wovenfab.study.response import breaks_of, depends_on_steps, is_set_valued, name_of

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)
#: Seconds of all trials for an accuracy of 1 % with compiling, and of a cycle or ramp with what was
#: chosen, on two processors of the machine of docs/random-fabrics.md; how often as many they are
#: with a set-valued law; and the power by which they grow with the accuracy. ``make random`` fits
#: and prints them. With other traits of a case they are not more certain.
TRIALS, RUN, SET_VALUED, POWER = 12.0, 5.0, 2.4, 0.25
#: Why an accuracy counts as not reached where nothing slides in the trials of steps, or where these
#: lack another figure.
NO_LOSS = "yarns slide with these elements, but not on the coarse mesh on which steps are judged"
NO_FIGURE = "the coarse mesh on which steps are judged does not tell"
#: Why an accuracy is not reached after all.
TOO_LONG = (
    "the steps missed the peak of the force between them, or their errors are larger than with "
    "coarse elements; shorter ones are more accurate"
)
#: Name and unit of the figures, as people read them.
WORDS = {
    "peak_force_N": ("peak force", "N"),
    "peak_displacement_m": ("peak displacement", "m"),
    "dissipated_J": ("dissipated", "J"),
}


def choose(
    case: Case, sheet: Sheet, say: Callable[[str], None], progress: Callable[[str], None]
) -> Plan:
    """Return elements and steps for the accuracy of a case; collective.

    Args:
        case: A case with an accuracy.
        sheet: Its sheet.
        say: Gets messages.
        progress: Gets what is being done.
    """
    assert case.accuracy is not None
    d, together = case.discretisation, sheet.mesh.comm
    sheets = {(d.mesh_size, d.graded, together.size): sheet}

    def mesher(trial: Case, comm: MPI.Comm) -> Sheet:
        cells = (trial.discretisation.mesh_size, trial.discretisation.graded, comm.size)
        if cells not in sheets:
            sheets[cells] = sheet_of(trial, comm)
        return sheets[cells]

    chosen = plan(case, together, progress, mesher=mesher)
    unjudged = _unjudged(chosen.estimate)
    unknown = bool(unjudged) or (chosen.estimate is not None and not chosen.estimate.resolved)
    if unjudged and not chosen.shortfall:
        why = NO_LOSS if "dissipated_J" in unjudged else f"{NO_FIGURE} {', '.join(unjudged)}"
        more = "compare with a run that has smaller cells and more steps"
        chosen = replace(chosen, shortfall=f"{why}; {more}")
    d = chosen.case.discretisation
    size = "" if d.mesh_size is None else f" of {1e3 * d.mesh_size:.4g} mm"
    graded = " on a graded mesh" if d.graded else ""
    words = f"chosen: degree {d.degree}, cells{size}{graded}{_steps(chosen.case)}"
    say(words)
    logger.info("for an accuracy of %g: %s", case.accuracy, words)
    if chosen.shortfall:
        best = ""
        if chosen.estimate is not None and not unknown:
            best = f", estimated error {_percent(chosen.estimate.worst)}"
        say(f"{_missed(chosen.shortfall, case.accuracy)}; this is the best that was tried{best}")
    return chosen


def settled(case: Case, comm: MPI.Comm, say: Callable[[str], None]) -> tuple[Case, Sheet]:
    """Return a case with the elements and steps for its accuracy, if it has one; collective.

    Args:
        case: The case.
        comm: The ranks.
        say: Gets messages.

    Returns:
        The case without an accuracy, and its sheet.
    """
    sheet = sheet_of(case, comm)
    if case.accuracy is None:
        return case, sheet
    chosen = choose(case, sheet, say, logger.debug)
    return chosen.case, chosen.sheet


def _unjudged(estimate: Estimate | None) -> list[str]:
    """Return the figures by which elements were judged, but not steps."""
    if estimate is None or estimate.time is None:
        return []
    return [name for name in estimate.space if name not in estimate.time]


def expected_seconds(case: Case) -> float:
    """Return about how long a case with an accuracy takes on two processors, s."""
    assert case.accuracy is not None
    segments = chain(*case.programs.values())
    cycles = sum(s.segment(2).count for s in segments if isinstance(s, CyclesSection))
    slower = SET_VALUED if is_set_valued(case) else 1.0
    more: float = (USUAL_ACCURACY / case.accuracy) ** POWER
    return (TRIALS + RUN * max(1, cycles)) * slower * more


def errors_of(chosen: Plan, case: Case) -> dict[str, Any]:
    """Return what a run keeps of a choice, as plain values: also checkpoints have them.

    Args:
        chosen: What :func:`choose` returned.
        case: The case with the accuracy.
    """
    estimate = chosen.estimate
    elements: dict[str, float | None] = {**estimate.space} if estimate else {}
    if estimate and not estimate.resolved:
        elements = dict.fromkeys(elements)  # not known
    return {
        "wanted": case.accuracy,
        "shortfall": chosen.shortfall,
        "elements": elements,
        "steps": estimate.time if estimate else None,
    }


def report_errors(
    errors: Mapping[str, Any],
    case: Case,
    summary: Mapping[str, Any],
    history: Mapping[str, Array],
    directory: Path | None,
    say: Callable[[str], None],
) -> dict[str, Any]:
    """Print the estimated errors; return the summary with them, and write it. Collective.

    How far the steps of the run missed the peak, which may be at another time than in trials, is
    told by its own forces. Steps are judged with coarse elements; where the run measures larger
    errors of them, these count. Of a figure that coarse elements do not have, such as the loss
    where all of their points stick, the error is not known: also that of elements is often much
    larger than degrees show.

    Args:
        errors: What :func:`errors_of` returned.
        case: What was run.
        summary: Summary of the run.
        history: Its columns.
        directory: Its results directory, or None.
        say: Gets messages.
    """
    wanted, shortfall, steps = errors["wanted"], errors["shortfall"], errors["steps"]
    loaded = any(prescribe_forces(case.program))
    answer = history["displacement_m" if loaded else "force_N"]
    curve = ForceCurve(history["time_s"], answer, breaks_of(case))
    missed = dict.fromkeys(PEAKS, curve.missed_peak()) if steps else {}
    tests = summary.get("figures", {})
    of_tests = {name_of(test, name): v for test, of in tests.items() for name, v in of.items()}
    values = {**summary, **of_tests}
    if loaded and len(answer):
        values["peak_displacement_m"] = peak_force(answer)
    if steps:
        measured = _measured_errors(history)
        steps = {n: max(e, measured.get(n, 0.0), key=abs) for n, e in steps.items()}
    figures = {
        name: _error(values[name], errors["elements"].get(name), steps, name, missed.get(name, 0.0))
        for name in {**errors["elements"], **(steps or {})}
        if values.get(name) is not None
    }
    if not shortfall and any(
        (f["relative_error"] or 0.0) > ALMOST * wanted for f in figures.values()
    ):
        shortfall = TOO_LONG
    entry: dict[str, Any] = {"wanted": wanted, "shortfall": shortfall}
    if figures:
        entry["figures"] = figures
    more = {**summary, "accuracy": entry}
    if directory is not None:
        write_summary(directory, more)
    for name, error in entry.get("figures", {}).items():
        say(_told(error, *WORDS.get(name, (name, ""))))
    if shortfall:
        say(_missed(shortfall, wanted))
    return more


def _measured_errors(history: Mapping[str, Array]) -> dict[str, float]:
    """Return the signed errors of steps that a run measured itself, over its figures."""
    if any(name not in history or not len(history[name]) for name in ERRORS):
        return {}
    peak = index_of_peak(history["force_N"])
    force, loss = (history[name] for name in ERRORS)
    found = {
        "peak_force_N": (force[peak], history["force_N"][peak]),
        "dissipated_J": (loss[-1], history["dissipated_J"][-1]),
    }
    return {name: float(error / value) for name, (error, value) in found.items() if value}


def _error(
    value: float,
    elements: float | None,
    steps: Mapping[str, float] | None,
    name: str,
    missed: float,
) -> dict[str, Any]:
    """Return the errors of a figure; None of what is not known."""
    of_steps = (steps or {}).get(name)
    relative = None
    if elements is not None and (steps is None or name in steps):
        relative = stated_error(elements, of_steps or 0.0, missed)
    return {
        "value": value,
        "error": None if relative is None else relative * abs(value),
        "error_of_elements": None if elements is None else elements * value,
        "error_of_steps": None if of_steps is None else (of_steps - missed) * value,
        "relative_error": relative,
    }


def _told(error: Mapping[str, Any], words: str, unit: str) -> str:
    """Return the error of a figure in words."""
    if error["relative_error"] is None:
        return f"{words}: its error is not known"
    share, size = _percent(error["relative_error"]), error["error"]
    return f"{words}: estimated error {share}" + (f" ({size:.3g} {unit})" if unit else "")


def _missed(shortfall: str, accuracy: float) -> str:
    return f"warning: the accuracy of {_percent(accuracy)} is not reached: {shortfall}"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def _steps(case: Case) -> str:
    """Return the steps in words."""
    if not depends_on_steps(case):
        return ""
    steps, tolerance = f"{case.planned_steps} steps", case.time.tolerance
    if all(isinstance(segment, CyclesSection) for segment in case.program):
        steps = f"{case.time.steps_per_cycle} steps a cycle"
        if extra := len(case.time.extra_times):
            steps += f" and {extra} more"
    if tolerance is None:
        return f", {steps}"
    return f", {steps}, shortened where their error is over {_percent(tolerance)}"
