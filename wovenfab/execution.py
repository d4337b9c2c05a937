"""A case from its file to its results, as the command line and the Python interface run it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

from wovenfab.case import Case
from wovenfab.record.results import open_results, require_free
from wovenfab.simulation.from_case import sheet_of
from wovenfab.simulation.progress import Progress, Stopwatch
from wovenfab.simulation.run import Columns, run
from wovenfab.simulation.simulation import Outcome, Simulation


@dataclass(frozen=True)
class Listener:
    """Who is told what happens; called on every rank.

    Attributes:
        say: Gets messages.
        progress: Gets the progress.
    """

    say: Callable[[str], None] = lambda text: None
    progress: Callable[[Progress], None] = lambda now: None


@dataclass(frozen=True)
class Execution:
    """What an execution gave.

    Attributes:
        case: What was run: with the elements and steps that were chosen for an accuracy.
        outcome: How it ended.
        columns: The history.
        summary: What ``summary.json`` has.
    """

    case: Case
    outcome: Outcome
    columns: Columns
    summary: Mapping[str, Any]


def execute(
    case: Case,
    directory: Path | None,
    overwrite: bool = False,
    comm: MPI.Comm = MPI.COMM_WORLD,
    listener: Listener | None = None,
    watch: Stopwatch | None = None,
) -> Execution:
    """Run a case; collective.

    Args:
        case: The case.
        directory: Where results are written; None for a run in memory.
        overwrite: Replace the results of an earlier run there.
        comm: The ranks.
        listener: Who is told what happens.
        watch: Gets the wall times of the phases.

    Raises:
        CaseError: If the geometry or an effect of the case cannot be used.
        ResultsExistError: If the directory has results that must not be replaced.
        OSError: If the directory cannot be written.
    """
    listener, watch = listener or Listener(), watch or Stopwatch()
    if directory is not None:
        require_free(directory, overwrite, comm)
    with watch.phase("mesh"):
        sheet = sheet_of(case, comm)
    progress, planned, accuracy = listener.progress, None, case.accuracy
    if accuracy is not None:
        from wovenfab.study.target_accuracy.choice import choose

        with watch.phase("pilot"):
            planned = choose(case, sheet, listener.say, lambda text: progress(Progress(text)))
        case, sheet = planned.case, planned.sheet
    progress(Progress("compiling the effects"))
    with watch.phase("compile"):
        simulation = Simulation(case, sheet)
    with simulation:
        if directory is not None:
            open_results(directory, overwrite, comm)
        outcome, columns, summary = run(simulation, directory, progress, watch)
    if planned is not None and accuracy is not None:
        from wovenfab.study.target_accuracy.choice import report_errors

        summary = report_errors(planned, accuracy, summary, directory, listener.say)
    if directory is not None and case.output.pictures:
        from wovenfab.report import draw_in_subprocess

        warning = draw_in_subprocess(directory, comm).warning
        if warning is not None:
            listener.say(f"warning: {warning}")
    return Execution(case, outcome, columns, summary)
