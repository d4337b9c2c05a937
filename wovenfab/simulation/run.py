"""A run into a results directory: everything is on disk as soon as it is known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from wovenfab.case import dump_case
from wovenfab.parallel import on_root
from wovenfab.record.bias_extension import bias_extension_of
from wovenfab.record.cycle_table import write_cycles
from wovenfab.record.history import History, StepRecord, read_history
from wovenfab.record.results import write_whole
from wovenfab.record.summary import summarise, write_summary
from wovenfab.simulation.observers import FieldWriter, ModeWriter
from wovenfab.simulation.progress import Progress, Stopwatch
from wovenfab.simulation.simulation import Outcome, Simulation
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.step import Step


def run(
    simulation: Simulation,
    directory: Path,
    progress: Callable[[Progress], None],
    watch: Stopwatch,
) -> tuple[Outcome, dict[str, Any]]:
    """Run a simulation into a directory made by ``open_results``; collective.

    A step that cannot be made, or stability that is lost, ends the run early with all
    results so far intact.

    Args:
        simulation: The simulation.
        directory: The results directory.
        progress: Called on every rank with the progress.
        watch: Has the wall times of the phases before this one, and gets the others.

    Returns:
        How it ended, and what was written to summary.json.
    """
    case, model, program = simulation.case, simulation.model, simulation.program
    comm, end = model.comm, program.milestones[-1].time
    on_root(comm, lambda: write_whole(directory / "case.yaml", dump_case(case)))
    with watch.phase("compile"):
        fields = FieldWriter(simulation, directory)
    modes = ModeWriter(simulation, directory)
    progress(Progress("stepping", unknowns=model.unknowns))
    stored = [e.name for e in model.effects if not e.dissipative]
    dissipated = [e.name for e in model.effects if e.dissipative]
    edges = simulation.solver.problem.constraints.edges
    measured = simulation.stepper.measures_errors

    def write_fields(step: Step) -> None:
        with watch.phase("fields"):
            fields(step)

    def show(step: Step) -> None:
        progress(Progress("stepping", step.time / end, step, model.unknowns))

    with History(directory, stored, dissipated, edges, comm, measured) as history:
        outcome = simulation.run(
            modes,
            lambda step: history.append(_row(step, measured)),
            write_fields,
            show,
            watch=watch,
        )
    if isinstance(outcome.failure, StabilityLostError):
        modes.write(outcome.failure.loss)
    rows = comm.bcast(read_history(directory) if comm.rank == 0 else None)
    summary = summarise(
        rows,
        program.cycles,
        outcome="finished" if outcome.failure is None else str(outcome.failure),
        unknowns=model.unknowns,
        cut_backs=outcome.cutbacks,
        seconds=watch.seconds,
        ranks=comm.size,
        losses=modes.figures,
    )
    write_summary(directory, summary, comm)
    specimen = bias_extension_of(case)
    on_root(comm, lambda: write_cycles(directory, rows, program.cycles, specimen))
    return outcome, summary


def _row(step: Step, measured: bool) -> StepRecord:
    return StepRecord(
        step=step.number,
        time=step.time,
        displacement=step.displacement,
        force=step.force,
        force_transverse=step.force_transverse,
        stored=step.stored,
        dissipated=step.dissipated,
        work=step.work,
        iterations=step.iterations,
        reactions=step.reactions,
        negatives=step.negatives,
        errors=(step.force_error, step.dissipated_error) if measured else None,
    )
