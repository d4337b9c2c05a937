"""Runs with a target accuracy: elements and steps before the run, the errors after it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wovenfab.case import Case, Cycles
from wovenfab.cli.console import Console
from wovenfab.cli.sheet import sheet_for
from wovenfab.simulation.progress import Progress

if TYPE_CHECKING:
    from wovenfab.sheet.sheet import Sheet
    from wovenfab.study.target_accuracy.plan import Plan

#: Name and unit of the figures, as people read them.
WORDS = {"peak_force_N": ("peak force", "N"), "dissipated_J": ("dissipated", "J")}


def plan_run(
    case: Case, sheet: Sheet, path: Path, overrides: Sequence[str], console: Console
) -> Plan:
    """Return elements and steps for the accuracy of a case with its sheet; collective."""
    from wovenfab.study.target_accuracy.plan import plan

    sheets = {case.discretisation.mesh_size: sheet}

    def mesher(trial: Case) -> Sheet:
        size = trial.discretisation.mesh_size
        if size not in sheets:
            sheets[size] = sheet_for(trial, path, overrides)
        return sheets[size]

    chosen = plan(case, mesher, lambda text: console.progress(Progress(text)))
    d = chosen.case.discretisation
    size = "" if d.mesh_size is None else f" of {1e3 * d.mesh_size:.4g} mm"
    console.say(f"chosen: degree {d.degree}, cells{size}{_steps(chosen.case)}")
    if chosen.shortfall:
        assert case.accuracy is not None
        estimate = chosen.estimate
        best = "" if estimate is None else f", estimated error {_percent(estimate.worst)}"
        console.say(f"{_missed(chosen, case.accuracy)}; this is the best that was tried{best}")
    return chosen


def _missed(plan: Plan, accuracy: float) -> str:
    return f"warning: the accuracy of {_percent(accuracy)} is not reached: {plan.shortfall}"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def _steps(case: Case) -> str:
    """Return the steps in words."""
    from wovenfab.simulation.response import planned_steps

    if not case.needs.history:
        return ""
    steps, tolerance = f"{planned_steps(case)} steps", case.time.tolerance
    if all(isinstance(segment, Cycles) for segment in case.program):
        steps = f"{case.time.steps_per_cycle} steps a cycle"
    cut = (
        "" if tolerance is None else f", shortened where their error is over {_percent(tolerance)}"
    )
    return f", {steps}{cut}"


def report_errors(
    plan: Plan, accuracy: float, summary: Mapping[str, Any], directory: Path, console: Console
) -> None:
    """Write and print the estimated errors of a run; collective."""
    from wovenfab.record.summary import write_summary
    from wovenfab.study.target_accuracy.estimate import write_errors

    entry: dict[str, Any] = {"wanted": accuracy, "shortfall": plan.shortfall}
    if plan.estimate is not None:
        entry["figures"] = plan.estimate.as_dict(summary)
        write_errors(plan.estimate, directory)
    write_summary(directory, {**summary, "accuracy": entry})
    for name, error in entry.get("figures", {}).items():
        words, unit = WORDS[name]
        console.say(
            f"{words}: estimated error {_percent(error['relative_error'])} "
            f"({error['error']:.3g} {unit})"
        )
    if plan.shortfall:
        console.say(_missed(plan, accuracy))
