"""A target accuracy in words: what was chosen for it before a run, and its errors after it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from wovenfab.case import Case, Cycles
from wovenfab.record.summary import write_summary
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.from_case import sheet_of
from wovenfab.simulation.response import planned_steps
from wovenfab.study.target_accuracy.estimate import write_errors
from wovenfab.study.target_accuracy.plan import Plan, plan

logger = logging.getLogger(__name__)
#: Name and unit of the figures, as people read them.
WORDS = {"peak_force_N": ("peak force", "N"), "dissipated_J": ("dissipated", "J")}


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
    sheets = {case.discretisation.mesh_size: sheet}

    def mesher(trial: Case) -> Sheet:
        size = trial.discretisation.mesh_size
        if size not in sheets:
            sheets[size] = sheet_of(trial, sheet.mesh.comm)
        return sheets[size]

    chosen = plan(case, mesher, progress)
    d = chosen.case.discretisation
    size = "" if d.mesh_size is None else f" of {1e3 * d.mesh_size:.4g} mm"
    words = f"chosen: degree {d.degree}, cells{size}{_steps(chosen.case)}"
    say(words)
    logger.info("for an accuracy of %g: %s", case.accuracy, words)
    if chosen.shortfall:
        best = ""
        if chosen.estimate is not None:
            best = f", estimated error {_percent(chosen.estimate.worst)}"
        say(f"{_missed(chosen, case.accuracy)}; this is the best that was tried{best}")
    return chosen


def report_errors(
    chosen: Plan,
    accuracy: float,
    summary: Mapping[str, Any],
    directory: Path | None,
    say: Callable[[str], None],
) -> dict[str, Any]:
    """Print and write the estimated errors; return the summary with them. Collective.

    Args:
        chosen: What :func:`choose` returned.
        accuracy: The target.
        summary: Summary of the run.
        directory: Its results directory, or None.
        say: Gets messages.
    """
    entry: dict[str, Any] = {"wanted": accuracy, "shortfall": chosen.shortfall}
    if chosen.estimate is not None:
        entry["figures"] = chosen.estimate.as_dict(summary)
        if directory is not None:
            write_errors(chosen.estimate, directory)
    more = {**summary, "accuracy": entry}
    if directory is not None:
        write_summary(directory, more)
    for name, error in entry.get("figures", {}).items():
        words, unit = WORDS[name]
        say(
            f"{words}: estimated error {_percent(error['relative_error'])} "
            f"({error['error']:.3g} {unit})"
        )
    if chosen.shortfall:
        say(_missed(chosen, accuracy))
    return more


def _missed(chosen: Plan, accuracy: float) -> str:
    return f"warning: the accuracy of {_percent(accuracy)} is not reached: {chosen.shortfall}"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def _steps(case: Case) -> str:
    """Return the steps in words."""
    if not case.needs.history:
        return ""
    steps, tolerance = f"{planned_steps(case)} steps", case.time.tolerance
    if all(isinstance(segment, Cycles) for segment in case.program):
        steps = f"{case.time.steps_per_cycle} steps a cycle"
    if tolerance is None:
        return f", {steps}"
    return f", {steps}, shortened where their error is over {_percent(tolerance)}"
