"""A run into a results directory, or in memory."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.parallel import on_root
from wovenfab.record.bias_extension import bias_extension_of
from wovenfab.record.history import History, HistoryRows, read_history
from wovenfab.record.results import write_whole
from wovenfab.record.summary import summarise, write_cycles, write_summary
from wovenfab.simulation.observers import FieldWriter, ModeWriter
from wovenfab.simulation.progress import Progress, Stopwatch
from wovenfab.simulation.simulation import Observer, Outcome, Simulation
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.step import Step

Columns = dict[str, NDArray[np.float64]]


def run(
    simulation: Simulation,
    directory: Path | None,
    progress: Callable[[Progress], None],
    watch: Stopwatch,
) -> tuple[Outcome, Columns, dict[str, Any]]:
    """Run a simulation; collective.

    Everything is on disk as soon as it is known. A step that cannot be made, or stability that
    is lost, ends the run early with all results so far intact.

    Args:
        simulation: The simulation.
        directory: The results directory, made by ``open_results``; None to write nothing.
        progress: Called on every rank with the progress.
        watch: Has the wall times of the phases before this one, and gets the others.

    Returns:
        How it ended, the columns of the history, and the summary.
    """
    model, program, comm = simulation.model, simulation.program, simulation.comm
    rows = HistoryRows(
        [e.name for e in model.effects if not e.dissipative],
        [e.name for e in model.effects if e.dissipative],
        simulation.solver.problem.constraints.edges,
        simulation.stepper.measures_errors,
    )
    values: list[list[float]] = []
    observers: list[Observer] = []
    modes = ModeWriter(simulation, directory)
    with ExitStack() as stack:
        if directory is None:
            observers = [modes, lambda step: values.append(rows.row(step)[0])]
        else:
            text = simulation.case.to_yaml()
            on_root(comm, lambda: write_whole(directory / "case.yaml", text))
            with watch.phase("compile"):
                fields = FieldWriter(simulation, directory)
            history = stack.enter_context(History(directory, rows, comm))

            def write_fields(step: Step) -> None:
                with watch.phase("fields"):
                    fields(step)

            observers = [modes, history.append, write_fields]
        progress(Progress("stepping", unknowns=model.unknowns))
        end = program.milestones[-1].time
        outcome = simulation.run(
            *observers,
            lambda step: progress(Progress("stepping", step.time / end, step, model.unknowns)),
            watch=watch,
        )
    if isinstance(outcome.failure, StabilityLostError):
        modes.add(outcome.failure.loss)
    if directory is None:
        columns = dict(
            zip(rows.columns, np.array(values).reshape(-1, len(rows.columns)).T, strict=True)
        )
    else:
        columns = comm.bcast(read_history(directory) if comm.rank == 0 else None)
    summary = summarise(
        columns,
        program.cycles,
        outcome="finished" if outcome.failure is None else str(outcome.failure),
        unknowns=model.unknowns,
        cut_backs=outcome.cutbacks,
        seconds=watch.seconds,
        ranks=comm.size,
        losses=modes.figures,
    )
    if directory is not None:
        write_summary(directory, summary, comm)
        specimen = bias_extension_of(simulation.case)
        on_root(comm, lambda: write_cycles(directory, columns, program.cycles, specimen))
    return outcome, columns, summary
