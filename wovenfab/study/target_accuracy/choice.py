"""A target accuracy in words: its time, what was chosen before a run, and its errors after it.

Runs of a sweep remember what they chose: the search of a neighbouring scene starts there.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import json
import logging
import os
import re
import timeit
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from math import exp, inf, log
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.case import Case, Cycles
from wovenfab.case.fingerprint import code, contents_of, digest
from wovenfab.case.objects import sheet_of
from wovenfab.parallel import compute_on_root, on_root
from wovenfab.record.results import CHOICES
from wovenfab.record.summary import write_summary
from wovenfab.sheet.sheet import Sheet
from wovenfab.study.response import missed_peak
from wovenfab.study.target_accuracy.estimate import PEAK, Estimate, stated_error
from wovenfab.study.target_accuracy.plan import USUAL_ACCURACY, Plan, Start, plan
from wovenfab.study.target_accuracy.time_steps import ALMOST

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)
#: Ratio of two numbers up to which cases that differ in nothing but numbers are neighbours.
NEAR = 1.5
#: Logarithms of seconds, for each of the traits of a case: of all trials with compiling, and of a
#: cycle or ramp with what was chosen, on two processors. ``make random`` fits and prints them.
TRIALS = (1.63, 0.12, 0.17, 1.12, 0.21, 0.03, 0.23)
RUN = (1.09, -0.06, -0.07, 1.05, 0.32, -0.02, 0.36)
#: Time (s) in which the machine of the fit parsed Python's module argparse a few times, how many,
#: and how often this is measured.
PARSING, PARSES, REPEATS = 0.023, 3, 5
#: Angle to the mean of the families beyond which fibres are askew, rad.
ASKEW = 0.01
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
#: Why an accuracy counts as not reached where nothing slides in the trials of steps.
UNKNOWN = (
    "yarns slide with these elements, but not on the coarse mesh on which steps are judged; "
    "compare with a run that has smaller cells and more steps"
)
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
    d, together = case.discretisation, sheet.mesh.comm
    sheets = {(d.mesh_size, d.graded, together.size): sheet}

    def mesher(trial: Case, comm: MPI.Comm) -> Sheet:
        cells = (trial.discretisation.mesh_size, trial.discretisation.graded, comm.size)
        if cells not in sheets:
            sheets[cells] = sheet_of(trial, comm)
        return sheets[cells]

    path = Path(text) if (text := os.environ.get(CHOICES)) else None
    start = compute_on_root(together, lambda: known_start(case, path) if path else Start())
    chosen = plan(case, together, progress, start=start, mesher=mesher)
    unknown = chosen.estimate is not None and not _is_known(chosen.estimate)
    if unknown and not chosen.shortfall:
        chosen = replace(chosen, shortfall=UNKNOWN)
    if path and not chosen.shortfall:
        on_root(together, lambda: remember(case, chosen.start, path))
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


def _is_known(estimate: Estimate) -> bool:
    """Return whether the steps were judged by all figures that the elements have."""
    return estimate.time is None or set(estimate.space) <= set(estimate.time)


def traits(case: Case) -> tuple[float, ...]:
    """Return what the time for an accuracy depends on, by experience.

    Args:
        case: A case with an accuracy.

    Returns:
        1; whether there are two placements, history, a set-valued law, cycles, fibres askew to
        the axis; by how many times the accuracy is below 1 %, its logarithm.
    """
    assert case.accuracy is not None
    segments = chain(*case.programs.values())
    return (
        1.0,
        float(case.needs.placements == 2),
        float(case.needs.history),
        float(any(entry.effect.set_valued for entry in case.scene)),
        float(any(isinstance(segment, Cycles) for segment in segments)),
        float(abs(sum(case.sheet.fibres)) > ASKEW),
        log(USUAL_ACCURACY / case.accuracy),
    )


def expected_seconds(case: Case, slowness: float) -> float:
    """Return about how long a case with an accuracy takes on two processors, s.

    Args:
        case: A case with an accuracy.
        slowness: Time that the machine takes over that of the machine of the fit.
    """
    known = traits(case)
    trials, run = (exp(float(np.dot(known, weights))) for weights in (TRIALS, RUN))
    segments = chain(*case.programs.values())
    cycles = sum(s.segment(2).count for s in segments if isinstance(s, Cycles))
    return slowness * (trials + run * max(1, cycles))


def slowness() -> float:
    """Return about how long this machine takes over the time of the machine of the fit.

    Compiling takes most of the time of small cases; to parse a program is work of that kind.
    """
    program = inspect.getsource(argparse)
    times = timeit.repeat(lambda: ast.parse(program), number=PARSES, repeat=REPEATS)
    return median(times) / PARSING


def known_start(case: Case, path: Path) -> Start:
    """Return where the search for a case may start: with what its nearest neighbour chose.

    Args:
        case: A case with an accuracy.
        path: File of choices, which need not exist.
    """
    words, numbers = _words_and_numbers(case)
    near: list[tuple[float, Start]] = []
    with suppress(OSError):
        for line in path.read_text(encoding="utf-8").splitlines():
            with suppress(ValueError, TypeError, KeyError):  # another version's, or half a line
                known = json.loads(line)
                if known["words"] != words or len(known["numbers"]) != len(numbers):
                    continue
                if (ratio := _ratio(known["numbers"], numbers)) <= NEAR:
                    steps = known["steps"] and (str(known["steps"][0]), float(known["steps"][1]))
                    cells, degree, graded = (int(known[k]) for k in ("cells", "degree", "graded"))
                    near.append((ratio, Start(cells, degree, steps, bool(graded))))
    if not near:
        return Start()
    _, start = min(near, key=lambda one: one[0])
    logger.info("the search starts with what a neighbouring scene chose: %s", start)
    return start


def remember(case: Case, start: Start, path: Path) -> None:
    """Add a choice to a file of choices, as one line: others may add theirs meanwhile."""
    words, numbers = _words_and_numbers(case)
    line = json.dumps({"words": words, "numbers": numbers, **vars(start)})
    with suppress(OSError), path.open("a", encoding="utf-8") as file:
        file.write(line + "\n")


def _words_and_numbers(case: Case) -> tuple[str, list[float]]:
    """Return a mark of what the results of a case depend on, and its numbers, which are apart.

    The mark is of its words, of the contents of all files behind it, and of the code.
    """
    text = case.model_dump_json(exclude={"title", "output"}, by_alias=True)
    contents = json.dumps(contents_of(case))
    words = digest(_NUMBER.sub("#", text), contents, code(Path(__file__).parent))
    return words, [float(number) for number in _NUMBER.findall(text)]


def _ratio(some: list[float], others: list[float]) -> float:
    """Return the largest ratio of two numbers; infinite if only one of them is zero."""
    ratios = [1.0]
    for a, b in zip(some, others, strict=True):
        if a != b:
            ratios.append(max(a / b, b / a) if a * b > 0 else inf)
    return max(ratios)


def errors_of(chosen: Plan, case: Case) -> dict[str, Any]:
    """Return what a run keeps of a choice, as plain values: also checkpoints have them.

    Args:
        chosen: What :func:`choose` returned.
        case: The case with the accuracy.
    """
    estimate = chosen.estimate
    return {
        "wanted": case.accuracy,
        "shortfall": chosen.shortfall,
        "elements": estimate.space if estimate else {},
        "steps": estimate.time if estimate else None,
    }


def report_errors(
    errors: Mapping[str, Any],
    summary: Mapping[str, Any],
    history: Mapping[str, Array],
    directory: Path | None,
    say: Callable[[str], None],
) -> dict[str, Any]:
    """Print the estimated errors; return the summary with them, and write it. Collective.

    How far the steps of the run missed the peak, which may be at another time than in trials, is
    told by its own forces. Steps are judged with coarse elements. Of a figure that these do not
    have, such as the loss where all of their points stick, the error is not known: also that of
    elements is often much larger than degrees show.

    Args:
        errors: What :func:`errors_of` returned.
        summary: Summary of the run.
        history: Its columns.
        directory: Its results directory, or None.
        say: Gets messages.
    """
    wanted, shortfall, steps = errors["wanted"], errors["shortfall"], errors["steps"]
    missed = {PEAK: missed_peak(history["time_s"], history["force_N"])} if steps else {}
    figures = {
        name: _error(summary[name], share, steps, name, missed.get(name, 0.0))
        for name, share in errors["elements"].items()
        if summary.get(name) is not None
    }
    if not shortfall and any(
        (f["relative_error"] or 0.0) > ALMOST * wanted for f in figures.values()
    ):
        shortfall = "the steps missed the peak of the force between them; shorter ones meet it"
    entry: dict[str, Any] = {"wanted": wanted, "shortfall": shortfall}
    if figures:
        entry["figures"] = figures
    more = {**summary, "accuracy": entry}
    if directory is not None:
        write_summary(directory, more)
    for name, error in entry.get("figures", {}).items():
        say(_told(error, *WORDS[name]))
    if shortfall:
        say(_missed(shortfall, wanted))
    return more


def _error(
    value: float, elements: float, steps: Mapping[str, float] | None, name: str, missed: float
) -> dict[str, Any]:
    """Return the errors of a figure; None of what is not known."""
    known = steps is None or name in steps
    of_steps = (steps or {}).get(name)
    relative = stated_error(elements, of_steps or 0.0, missed) if known else None
    return {
        "value": value,
        "error": None if relative is None else relative * abs(value),
        "error_of_elements": elements * value,
        "error_of_steps": None if of_steps is None else (of_steps - missed) * value,
        "relative_error": relative,
    }


def _told(error: Mapping[str, Any], words: str, unit: str) -> str:
    """Return the error of a figure in words."""
    if error["relative_error"] is None:
        return f"{words}: its error is not known"
    share, size = _percent(error["relative_error"]), error["error"]
    return f"{words}: estimated error {share} ({size:.3g} {unit})"


def _missed(shortfall: str, accuracy: float) -> str:
    return f"warning: the accuracy of {_percent(accuracy)} is not reached: {shortfall}"


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def _steps(case: Case) -> str:
    """Return the steps in words."""
    if not case.needs.history:
        return ""
    steps, tolerance = f"{case.planned_steps} steps", case.time.tolerance
    if all(isinstance(segment, Cycles) for segment in case.program):
        steps = f"{case.time.steps_per_cycle} steps a cycle"
        if extra := len(case.time.extra_times):
            steps += f" and {extra} more"
    if tolerance is None:
        return f", {steps}"
    return f", {steps}, shortened where their error is over {_percent(tolerance)}"
