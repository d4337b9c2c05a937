"""A run into a results directory, or in memory."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.model.fields import FieldProbe
from wovenfab.model.model import preserved
from wovenfab.parallel import on_root
from wovenfab.record.bias_extension import bias_extension_of
from wovenfab.record.field_file import MODE
from wovenfab.record.fields import FieldSeries, Lattice
from wovenfab.record.history import History, HistoryRows, read_history
from wovenfab.record.results import write_whole
from wovenfab.record.summary import summarise, write_cycles, write_summary
from wovenfab.simulation.progress import Progress, Stopwatch
from wovenfab.simulation.simulation import Observer, Outcome, Simulation
from wovenfab.stepping.stability import StabilityLoss, StabilityLostError
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


class FieldWriter:
    """Writes the chosen fields every so many planned steps, at reversals and at the end."""

    def __init__(self, simulation: Simulation, directory: Path) -> None:
        """Create the files; collective.

        Args:
            simulation: The simulation.
            directory: The results directory.
        """
        case, program = simulation.case, simulation.program
        self._every = case.output.every
        self._always = {*program.reversals, program.milestones[-1].time}
        lattice = Lattice(case.discretisation.degree)
        self._probe = FieldProbe(simulation.model, case.output.fields, lattice.points)
        units = {f.name: f.unit or "1" for f in self._probe.fields}
        self._series = FieldSeries(
            directory,
            simulation.comm,
            lattice,
            self._probe.positions().reshape(-1, 2),
            simulation.model.sheet.original_cells[self._probe.cells],
            units,
        )
        self._planned = -1

    def __call__(self, step: Step) -> None:
        """Write the fields if the step's turn has come; collective."""
        if step.milestone is None:
            return
        self._planned += 1
        if self._planned % self._every and step.milestone.time not in self._always:
            return
        data = {
            name: np.ascontiguousarray(v.reshape(-1, v.shape[2]).squeeze(axis=1))
            if v.shape[2] == 1
            else v.reshape(-1, v.shape[2])
            for name, v in self._probe.values().items()
        }
        self._series.write(step.number, step.time, data)


class ModeWriter:
    """Writes ``mode.h5`` and ``mode.xdmf``: at each loss the displacement and the mode.

    Attributes:
        figures: Of each loss: its time (s), displacement (m), how far from there the first
            saddle is (m), force on the driven edge along the program (N), and the number
            of negative eigenvalues there.
    """

    def __init__(self, simulation: Simulation, directory: Path | None) -> None:
        """Write nothing yet.

        Args:
            simulation: The simulation.
            directory: The results directory; None to keep only the figures.
        """
        self._simulation, self._directory = simulation, directory
        self._files: tuple[FieldProbe, FieldSeries] | None = None
        self.figures: list[dict[str, float]] = []

    def __call__(self, step: Step) -> None:
        """Write the loss before a step, if there is one; collective."""
        if step.loss is not None:
            self.add(step.loss)

    def add(self, loss: StabilityLoss) -> None:
        """Write a loss; collective. The model's field is left as it is."""
        if self._directory is not None:
            probe, series = self._files = self._files or self._start(self._directory)
            data = {}
            for part, values in (("displacement", loss.saddle), ("mode", loss.mode)):
                for name, at_points in self._evaluated(probe, values).items():
                    data[name.replace("displacement", part)] = at_points
            series.write(len(self.figures), loss.time, data)
        self.figures.append(
            {
                "time_s": loss.time,
                "displacement_m": loss.displacement,
                "known_to_m": abs(loss.increment),
                "force_N": self._simulation.driven_force(loss.reactions)[0],
                "negative_eigenvalues": loss.negatives,
            }
        )

    def _start(self, directory: Path) -> tuple[FieldProbe, FieldSeries]:
        model = self._simulation.model
        lattice = Lattice(model.balance.degree)
        probe = FieldProbe(model, ["displacement"], lattice.points)
        units = {f.name: f.unit for f in probe.fields}
        units |= {name.replace("displacement", "mode"): "1" for name in units}
        places, cells = probe.positions().reshape(-1, 2), model.sheet.original_cells[probe.cells]
        series = FieldSeries(directory, model.comm, lattice, places, cells, units, MODE)
        return probe, series

    def _evaluated(
        self, probe: FieldProbe, values: NDArray[np.float64]
    ) -> dict[str, NDArray[np.float64]]:
        """Return the displacements of given unknowns at the points, shape (n, 2)."""
        field = self._simulation.model.field
        with preserved(field):
            field.x.array[:] = values
            return {name: v.reshape(-1, v.shape[2]) for name, v in probe.values().items()}
