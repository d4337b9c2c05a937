"""``wovenfab fit``: parameters from measured curves."""

from __future__ import annotations

import json
from dataclasses import asdict
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wovenfab.cli.console import (
    BAD_INPUT,
    FAILED_STEP,
    INTERRUPTED,
    Console,
    duration,
    is_launched,
)
from wovenfab.record.results import write_whole
from wovenfab.simulation.progress import Progress

if TYPE_CHECKING:
    from wovenfab.study.fit.fit_file import Fit
    from wovenfab.study.fit.knowledge import Knowledge
    from wovenfab.study.fit.search import Found, Trial

#: Folder of the curves that were computed.
RUNS = "runs"


def fit_parameters(path: Path, output: Path | None, jobs: int) -> int:
    """Find the parameters that a fit file asks for; return the exit code."""
    console = Console()
    if is_launched():
        console.problem("fit starts its own processes: start it without mpirun, with --jobs")
        return BAD_INPUT
    from wovenfab.study.fit.fit_file import read_fit
    from wovenfab.study.fit.knowledge import in_words, knowledge
    from wovenfab.study.fit.response import BranchError, TrialError
    from wovenfab.study.fit.search import Objective, discretisation_error, search

    fit = read_fit(path)
    directory = output or Path("results") / fit.name
    directory.mkdir(parents=True, exist_ok=True)
    console.say(f"{len(fit.tests)} measured curves, {len(fit.unknowns)} parameters")
    try:
        with console, Objective(fit, directory / RUNS, jobs, _reporter(console, fit)) as objective:
            found = search(objective, fit)
            console.progress(Progress("comparing with finer runs"))
            error = discretisation_error(fit, found)
    except (TrialError, BranchError) as failure:
        console.problem(str(failure))
        return FAILED_STEP if isinstance(failure, TrialError) else BAD_INPUT
    except KeyboardInterrupt:
        console.problem(f"interrupted; to go on, repeat the command ({directory} has what is done)")
        return INTERRUPTED
    e = found.evaluation
    known = knowledge(fit, found.values, e.residuals, e.jacobian, e.comparisons)
    notes = [*_headlines(found, error), *in_words(known, fit)]
    _write(fit, found, known, error, notes, directory)
    from wovenfab.report.fit import PAGE, PICTURE, draw_fit, write_fit_page

    draw_fit(fit, found, known, directory / PICTURE)
    write_fit_page(fit, found, known, notes, directory / PAGE)
    for i in known.intervals:
        console.say(f"  {i.name:28s} {i.value:.5g} {i.unit}  (95 %: {i.low:.4g} to {i.high:.4g})")
    console.say("\n".join(["", *notes, "", f"page, picture and fitted case: {directory}"]))
    return 0


def _headlines(found: Found, error: float) -> list[str]:
    trials = found.trials
    fine = [t for t in trials if not t.coarse]
    misfit = next(t.misfit for t in reversed(fine) if t.values == found.values)
    lines = [
        f"The curves are followed within {100 * misfit:.2f} % of their largest force (root mean "
        f"square), after {len(trials)} trials, {len(trials) - len(fine)} of them coarse, in "
        f"{duration(sum(t.seconds for t in trials))}.",
        f"Finer elements and steps change the fitted curves by {100 * error:.2f} %"
        + (" (a tenth of the misfit or less)." if error <= 0.1 * misfit else "."),
    ]
    if not found.converged:
        lines.append(f"The search has not converged: {found.reason}.")
    return lines


def _reporter(console: Console, fit: Fit) -> Any:
    def report(trial: Trial) -> None:
        values = ", ".join(f"{u.name} {trial.values[u.name]:.4g}" for u in fit.unknowns)
        how = f"failed: {trial.failure}" if trial.failure else f"misfit {100 * trial.misfit:.3f} %"
        runs = "coarse" if trial.coarse else "full"
        console.say(f"trial {trial.number} ({runs}, {trial.seconds:.1f} s): {how}; {values}")

    return report


def _write(
    fit: Fit, found: Found, known: Knowledge, error: float, notes: list[str], directory: Path
) -> None:
    """Write ``fit.json`` and the fitted case of each test."""
    from wovenfab.study.fit.fit_file import with_values

    result = {
        "title": fit.title,
        "parameters": {i.name: _plain(asdict(i)) for i in known.intervals},
        "correlations": known.correlations.tolist(),
        "singular_values": known.singular_values.tolist(),
        "directions": known.directions.tolist(),
        "scatter": known.scatter,
        "tests": [
            {"measured": test.measured.file.name, "case": test.case.name, **_plain(asdict(f))}
            for test, f in zip(fit.tests, known.fidelity, strict=True)
        ],
        "discretisation_error": error,
        "trials": [_plain(asdict(t)) for t in found.trials],
        "converged": found.converged,
        "notes": notes,
    }
    write_whole(directory / "fit.json", json.dumps(result, indent=1) + "\n")
    for number, test in enumerate(fit.tests):
        which = "" if len(fit.tests) == 1 else f"{number + 1}-"
        case = with_values(test.case, fit.unknowns, found.values)
        write_whole(directory / f"{which}{test.case.name}.yaml", case.to_yaml())


def _plain(data: dict[str, Any]) -> dict[str, Any]:
    """Return data without infinities, which JSON does not know."""
    return {k: None if isinstance(v, float) and not isfinite(v) else v for k, v in data.items()}
