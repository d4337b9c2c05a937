"""A run: march through the program and put everything on disk as it becomes known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wovenfab.case import Case, dump_case
from wovenfab.model.fields import FieldProbe
from wovenfab.model.model import Model
from wovenfab.parallel import on_root
from wovenfab.record.fields import FieldSeries
from wovenfab.record.history import History, StepRecord, read_history
from wovenfab.record.lattice import Lattice
from wovenfab.record.results import write_whole
from wovenfab.record.summary import summarise, write_summary
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.assemble import (
    constraints_of,
    driven_edge,
    equilibrium_of,
    model_of,
    program_of_case,
    scheme_of,
)
from wovenfab.simulation.modes import Modes
from wovenfab.simulation.progress import Progress, Stopwatch
from wovenfab.stepping.march import March, Step, StepFailedError
from wovenfab.stepping.program import Program
from wovenfab.stepping.stability import StabilityLostError


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
    case: Case, sheet: Sheet, directory: Path, tell: Callable[[Progress], None], watch: Stopwatch
) -> Result:
    """Run a case on its sheet into a directory made by ``open_results``; collective.

    A step that cannot be made, or stability that is lost, ends the run early with all
    results so far intact.

    Args:
        case: The validated case.
        sheet: Its meshed sheet.
        directory: The results directory.
        tell: Called on every rank with the progress.
        watch: Has the wall times of the phases before this one, and gets the others.
    """
    comm = sheet.mesh.comm
    on_root(comm, lambda: write_whole(directory / "case.yaml", dump_case(case)))
    tell(Progress("compiling the effects"))
    with watch.phase("compile"):
        model = model_of(case, sheet)
        constraints = constraints_of(case, model)
        equilibrium = equilibrium_of(case, model, constraints)
        fields = _Fields(case, model, directory)
    tell(Progress("stepping", unknowns=model.unknowns))
    program = program_of_case(case)
    march = March(
        model,
        constraints,
        equilibrium,
        program,
        scheme_of(case),
        case.time.smallest_step,
        case.solver.stability,
    )
    edge, direction = driven_edge(case)
    modes = Modes(model, directory, edge, direction)
    stored = [e.name for e in model.effects if not e.dissipative]
    lost = [e.name for e in model.effects if e.dissipative]
    failure: StepFailedError | StabilityLostError | None = None
    cutbacks = 0
    with History(directory, stored, lost, constraints.edges, comm) as history:
        steps = march.steps()
        while True:
            try:
                with watch.phase("steps" if march.started else "first step"):
                    step = next(steps, None)
            except StepFailedError as error:
                failure = error
                break
            except StabilityLostError as error:
                failure = error
                modes.add(error.loss)
                break
            if step is None:
                break
            cutbacks += step.cutbacks
            if step.loss is not None:
                modes.add(step.loss)
            history.append(_row(step, edge, direction))
            with watch.phase("fields"):
                fields.write(step, program)
            tell(
                Progress("stepping", step.time / program.milestones[-1].time, step, model.unknowns)
            )
    equilibrium.destroy()
    rows = comm.bcast(read_history(directory) if comm.rank == 0 else None)
    summary = summarise(
        rows,
        cycle_times(program),
        outcome="finished" if failure is None else str(failure),
        unknowns=model.unknowns,
        cut_backs=cutbacks,
        seconds=watch.seconds,
        ranks=comm.size,
        losses=modes.figures,
    )
    write_summary(directory, summary, comm)
    return Result(failure, summary)


def cycle_times(program: Program) -> list[float]:
    """Return the times (s) at which cycles begin and end."""
    ends = [m.time for m in program.milestones if m.ends_cycle]
    return [0.0, *ends] if ends else []


def _row(step: Step, edge: str, direction: tuple[float, float]) -> StepRecord:
    fx, fy = step.reactions[edge]
    along, across = (direction[0] * fx + direction[1] * fy, direction[0] * fy - direction[1] * fx)
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
    )


class _Fields:
    """Writes the chosen fields at every so many planned steps, and at the last one."""

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
        last = step.milestone is program.milestones[-1]
        if self._planned % self._every and not last:
            return
        data = {
            name: np.ascontiguousarray(v.reshape(-1, v.shape[2]).squeeze(axis=1))
            if v.shape[2] == 1
            else v.reshape(-1, v.shape[2])
            for name, v in self._probe.values().items()
        }
        self._series.write(step.number, step.time, data)
