"""A run: march through the program and put everything on disk as it becomes known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wovenfab.case import Case
from wovenfab.model.fields import FieldProbe
from wovenfab.model.model import Model
from wovenfab.parallel import on_root
from wovenfab.record.bias_extension import bias_extension_of
from wovenfab.record.cycle_table import write_cycles
from wovenfab.record.fields import FieldSeries
from wovenfab.record.history import History, StepRecord, read_history
from wovenfab.record.lattice import Lattice
from wovenfab.record.results import write_whole
from wovenfab.record.summary import summarise, write_summary
from wovenfab.simulation.modes import Modes
from wovenfab.simulation.progress import Progress, Stopwatch
from wovenfab.simulation.rig import Rig
from wovenfab.stepping.failure import StepFailedError
from wovenfab.stepping.program import Program
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.step import Step


@dataclass(frozen=True)
class Result:
    """How a run ended.

    Attributes:
        failure: Why it stopped early, or None.
        summary: What was written to summary.json.
    """

    failure: StepFailedError | StabilityLostError | None
    summary: dict[str, Any]


def run(
    case: Case, rig: Rig, directory: Path, tell: Callable[[Progress], None], watch: Stopwatch
) -> Result:
    """Run a mounted case into a directory made by ``open_results``; collective.

    A step that cannot be made, or stability that is lost, ends the run early with all
    results so far intact.

    Args:
        case: The validated case.
        rig: What was made of it.
        directory: The results directory.
        tell: Called on every rank with the progress.
        watch: Has the wall times of the phases before this one, and gets the others.
    """
    model, march, program = rig.model, rig.march, rig.program
    comm = model.comm
    on_root(comm, lambda: write_whole(directory / "case.yaml", case.to_yaml()))
    with watch.phase("compile"):
        fields = _Fields(case, model, directory)
    tell(Progress("stepping", unknowns=model.unknowns))
    stored = [e.name for e in model.effects if not e.dissipative]
    lost = [e.name for e in model.effects if e.dissipative]
    modes = Modes(model, directory, *rig.driven)
    failure: StepFailedError | StabilityLostError | None = None
    cutbacks = 0
    measured = march.measures_errors
    with History(directory, stored, lost, rig.constraints.edges, comm, measured) as history:
        steps = march.steps()
        while True:
            try:
                with watch.phase("steps" if march.started else "first step"):
                    step = next(steps, None)
            except StepFailedError as error:
                failure = error
                cutbacks += error.cutbacks
                break
            except StabilityLostError as error:
                failure = error
                cutbacks += error.cutbacks
                modes.add(error.loss)
                break
            if step is None:
                break
            cutbacks += step.cutbacks
            if step.loss is not None:
                modes.add(step.loss)
            history.append(_row(step, rig, measured))
            with watch.phase("fields"):
                fields.write(step, program)
            tell(
                Progress("stepping", step.time / program.milestones[-1].time, step, model.unknowns)
            )
    rows = comm.bcast(read_history(directory) if comm.rank == 0 else None)
    summary = summarise(
        rows,
        program.cycles,
        outcome="finished" if failure is None else str(failure),
        unknowns=model.unknowns,
        cut_backs=cutbacks,
        seconds=watch.seconds,
        ranks=comm.size,
        losses=modes.figures,
    )
    write_summary(directory, summary, comm)
    specimen = bias_extension_of(case)
    on_root(comm, lambda: write_cycles(directory, rows, program.cycles, specimen))
    return Result(failure, summary)


def _row(step: Step, rig: Rig, measured: bool) -> StepRecord:
    along, across = rig.force(step.reactions)
    error = rig.force(step.error.forces)[0] if step.error else 0.0
    return StepRecord(
        step=step.number,
        time=step.time,
        displacement=step.displacement,
        force=along,
        force_transverse=across,
        stored=step.stored,
        dissipated=step.dissipated,
        work=step.work,
        iterations=step.iterations,
        reactions=step.reactions,
        negatives=step.negatives,
        errors=(error, step.dissipated_error) if measured else None,
    )


class _Fields:
    """Writes the chosen fields every so many planned steps, at reversals and at the end."""

    def __init__(self, case: Case, model: Model, directory: Path) -> None:
        lattice = Lattice(case.discretisation.degree)
        self._every = case.output.every
        self._probe = FieldProbe(model, case.output.fields, lattice.points)
        cells = self._probe.cells
        self._series = FieldSeries(
            directory,
            model.comm,
            self._probe.positions().reshape(-1, 2),
            lattice.connectivity(len(cells)),
            model.sheet.original_cells[cells],
            {f.name: f.unit or "1" for f in self._probe.fields},
        )
        self._planned = -1

    def write(self, step: Step, program: Program) -> None:
        """Write the fields if the step's turn has come; collective."""
        if step.milestone is None:
            return
        self._planned += 1
        time, end = step.milestone.time, program.milestones[-1].time
        if self._planned % self._every and time not in {*program.reversals, end}:
            return
        data = {
            name: np.ascontiguousarray(v.reshape(-1, v.shape[2]).squeeze(axis=1))
            if v.shape[2] == 1
            else v.reshape(-1, v.shape[2])
            for name, v in self._probe.values().items()
        }
        self._series.write(step.number, step.time, data)
