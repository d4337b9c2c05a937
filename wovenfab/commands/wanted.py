"""Runs that are asked for an accuracy: the pilot before, the errors after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wovenfab.case import Case, Cycles
from wovenfab.commands.sheet import sheet_for
from wovenfab.commands.voice import Voice
from wovenfab.simulation.progress import Progress

if TYPE_CHECKING:
    from wovenfab.sheet.sheet import Sheet
    from wovenfab.study.wanted.elements import Found

#: How the figures are called on the screen.
WORDS = {"peak_force_N": ("peak force", "N"), "dissipated_J": ("dissipated", "J")}


def find(case: Case, sheet: Sheet, path: Path, overrides: Sequence[str], voice: Voice) -> Found:
    """Return elements and steps for the accuracy of a case, whose sheet is known; collective."""
    from wovenfab.study.wanted.pilot import pilot

    def tell(text: str) -> None:
        voice.progress(Progress(text))

    made = {case.discretisation.mesh_size: sheet}

    def mesher(trial: Case) -> Sheet:
        size = trial.discretisation.mesh_size
        if size not in made:
            made[size] = sheet_for(trial)
        return made[size]

    found = pilot(case, mesher, tell)
    d = found.case.discretisation
    size = "" if d.mesh_size is None else f" of {1e3 * d.mesh_size:.4g} mm"
    voice.say(f"chosen: degree {d.degree}, cells{size}{_steps(found.case)}")
    if found.shortfall:
        assert case.accuracy is not None
        best = (
            "" if found.estimate is None else f", estimated error {_percent(found.estimate.worst)}"
        )
        voice.say(f"{_missed(found, case.accuracy)}; this is the best that was tried{best}")
    return found


def _missed(found: Found, wanted: float) -> str:
    return f"warning: the accuracy of {_percent(wanted)} is not reached: {found.shortfall}"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def _steps(case: Case) -> str:
    """Return the steps in words."""
    from wovenfab.simulation.trace import steps_in

    if not case.needs.history:
        return ""
    steps, rough = f"{steps_in(case)} steps", case.time.tolerance
    if all(isinstance(segment, Cycles) for segment in case.program):
        steps = f"{case.time.steps_per_cycle} steps a cycle"
    cut = "" if rough is None else f", shortened where their error is over {_percent(rough)}"
    return f", {steps}{cut}"


def report(
    found: Found, wanted: float, summary: Mapping[str, Any], directory: Path, voice: Voice
) -> None:
    """Write and say which errors were reached; collective."""
    from wovenfab.record.summary import write_summary
    from wovenfab.study.wanted.error_map import write_errors

    reached: dict[str, Any] = {"wanted": wanted, "shortfall": found.shortfall}
    if found.estimate is not None:
        reached["figures"] = found.estimate.as_dict(summary)
        write_errors(found.estimate, directory)
    write_summary(directory, {**summary, "accuracy": reached})
    for name, error in reached.get("figures", {}).items():
        words, unit = WORDS[name]
        voice.say(
            f"{words}: estimated error {_percent(error['relative_error'])} "
            f"({error['error']:.3g} {unit})"
        )
    if found.shortfall:
        voice.say(_missed(found, wanted))
