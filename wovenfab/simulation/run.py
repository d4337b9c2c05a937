"""A run of a simulation into a results directory, or in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.model.constraints import Constraints
from wovenfab.model.fields import FieldProbe
from wovenfab.model.model import Model, preserved
from wovenfab.model.probes import Probes
from wovenfab.parallel import compute_on_root, on_root
from wovenfab.record.field_file import FIELDS, MODE, Checkpoint, kept_times
from wovenfab.record.fields import FieldSeries, write_lines
from wovenfab.record.figures import write_figures
from wovenfab.record.history import (
    HISTORY,
    HistoryRows,
    HistoryWriter,
    kept_rows,
    read_history,
)
from wovenfab.record.results import NothingToResumeError, this_process, write_whole
from wovenfab.record.summary import SUMMARY, summarise, write_cycles, write_summary
from wovenfab.sheet.output_nodes import OutputNodes
from wovenfab.simulation.checkpoint import Checkpoints, go_on
from wovenfab.simulation.progress import Interruption, Progress, Stopwatch
from wovenfab.simulation.simulation import Observer, Outcome, Simulation
from wovenfab.stepping.program import SAME
from wovenfab.stepping.stability import StabilityLoss, StabilityLostError
from wovenfab.stepping.step import Step

Columns = dict[str, NDArray[np.float64]]


def run(
    simulation: Simulation,
    directory: Path | None,
    progress: Callable[[Progress], None],
    watch: Stopwatch,
    checkpoint: Checkpoint | None = None,
    until: float = inf,
    interruption: Interruption | None = None,
    errors: Mapping[str, Any] | None = None,
    accepted: Callable[[], None] = lambda: None,
    observers: Sequence[Observer] = (),
) -> tuple[Outcome, Columns, dict[str, Any]]:
    """Run a simulation; collective.

    Everything is on disk as soon as it is known. A step that cannot be made, stability that is
    lost, or a signal ends the run early with all results so far intact.

    Args:
        simulation: The simulation.
        directory: The results directory, which this run has for itself; None to write nothing.
        progress: Called on every rank with the progress.
        watch: Has the wall times of the phases before this one, and gets the others.
        checkpoint: Of the run in the directory that goes on; None to begin.
        until: Time (s) at or after which the run pauses.
        interruption: Notes signals; None to leave them alone.
        errors: Estimated errors, plain values that checkpoints keep; None without.
        accepted: Called on rank 0 when the run is refused no more, before it changes any file.
        observers: Called after each accepted step, before it is written.

    Returns:
        How it ended, the columns of the history, and the summary.

    Raises:
        NothingToResumeError: The files there, or the checkpoint, are damaged or of another run;
            they are left as they are.
    """
    model, program, comm = simulation.model, simulation.program, simulation.comm
    before = checkpoint.values["run"] if checkpoint else {"parts": [], "outcome": {}, "losses": []}
    first = checkpoint.step if checkpoint else -1
    gauges = simulation.output.gauges
    with watch.phase("compile"):
        probes = Probes(model, gauges) if gauges else None
    rows = HistoryRows(
        model.storing,
        model.losing,
        simulation.solver.problem.constraints.edges,
        simulation.stepper.measures_errors,
        probes.columns if probes else (),
        program.beside is not None,
    )

    def probed() -> list[float]:
        if probes is None:
            return []
        with watch.phase("probes"):
            return probes.values()

    values: list[list[float]] = []
    modes = ModeWriter(simulation, directory, before["losses"])
    own: list[Observer] = [modes, lambda step: values.append(rows.row(step, probed())[0])]
    simulation.outcome = Outcome(**before["outcome"])

    def parts() -> list[dict[str, Any]]:
        """Return the parts of the run from its start or a checkpoint on, with their times (s)."""
        origin = this_process(comm.size)
        now = {"first_step": max(first, 0), "ranks": comm.size, "command": origin.command}
        return [*before["parts"], now | {"commit": origin.commit, "wall_time_s": {**watch.seconds}}]

    if checkpoint is not None and directory is not None:
        on_root(comm, lambda: _require_earlier(directory, rows, checkpoint))
        go_on(simulation, checkpoint, directory)
    on_root(comm, accepted)
    with ExitStack() as stack:
        checkpoints: Checkpoints | None = None
        if directory is not None:
            history = stack.enter_context(HistoryWriter(directory, rows, comm, first))
            on_root(comm, lambda: _write_texts(directory, simulation.output.texts))
            on_root(comm, lambda: (directory / SUMMARY).unlink(missing_ok=True))
            with watch.phase("compile"):
                fields = FieldWriter(simulation, directory, first, before.get("planned", -1))

            def write_fields(step: Step) -> None:
                with watch.phase("fields"):
                    fields(step)

            def state() -> dict[str, Any]:
                return {
                    "run": {
                        "parts": parts(),
                        "outcome": simulation.outcome.effort,
                        "losses": modes.figures,
                        "planned": fields.planned,
                        "errors": errors,
                    }
                }

            checkpoints = Checkpoints(simulation, directory, state, history.sync)

            def write_checkpoint(step: Step) -> None:
                with watch.phase("checkpoints"):
                    checkpoints(step)

            own = [
                *(modes, lambda step: history.append(step, probed())),
                *(write_fields, write_checkpoint),
            ]
        progress(Progress("stepping", unknowns=model.unknowns))
        end = program.milestones[-1].time
        outcome = simulation.run(
            *observers,
            *own,
            lambda step: progress(Progress("stepping", step.time / end, step, model.unknowns)),
            watch=watch,
            until=until,
            interruption=interruption,
        )
        if isinstance(outcome.failure, StabilityLostError):
            modes.add(outcome.failure.loss)
        if directory is not None:
            for writer in (fields, modes):
                writer.finish()
        if checkpoints is not None and simulation.stepper.begun:
            with watch.phase("checkpoints"):
                checkpoints.write()
    if directory is None:
        columns = dict(
            zip(rows.columns, np.array(values).reshape(-1, len(rows.columns)).T, strict=True)
        )
    else:
        columns = compute_on_root(comm, lambda: read_history(directory))
    travel = _travel(simulation.solver.problem.constraints, columns["displacement_m"])
    all_parts = parts()
    summary = summarise(
        columns,
        program.cycles,
        outcome=str(outcome),
        unknowns=model.unknowns,
        travel=travel,
        cut_backs=outcome.cutbacks,
        seconds=total(part["wall_time_s"] for part in all_parts),
        ranks=comm.size,
        losses=modes.figures,
        parts=all_parts,
        tests=simulation.output.tests,
    )
    if directory is not None:
        write_summary(directory, summary, comm)
        specimen = simulation.output.specimen
        on_root(comm, lambda: write_cycles(directory, columns, program.cycles, specimen, travel))
        on_root(comm, lambda: write_figures(directory, simulation.output.tests, columns))
        if lines := simulation.output.lines:
            on_root(comm, lambda: write_lines(directory, lines, model.sheet.fibres))
    return outcome, columns, summary


def _write_texts(directory: Path, texts: Mapping[str, str]) -> None:
    for name, text in texts.items():
        write_whole(directory / name, text)


def _travel(constraints: Constraints, displacements: NDArray[np.float64]) -> float:
    """Return how far the grips move against each other per displacement of the program.

    It is the mean up to the farthest displacement (m) of a history; 1 where nothing moves.
    """
    first = displacements[:1].sum()
    farthest = displacements[np.abs(displacements - first).argmax()] if len(displacements) else 0.0
    way = abs(farthest - first)
    return float(constraints.travel(farthest, first) / way) or 1.0 if way else 1.0


def _require_earlier(directory: Path, rows: HistoryRows, checkpoint: Checkpoint) -> None:
    """Require that the files of a run can be gone on with; on one rank.

    Raises:
        NothingToResumeError: One of them is damaged, or of another run.
    """
    kept_rows(directory, rows, checkpoint.step)
    reached = read_history(directory, rows=checkpoint.step + 1)["time_s"][-1]
    if abs(reached - checkpoint.time) > SAME * checkpoint.time:
        raise NothingToResumeError(
            f"{directory / HISTORY} is of another run than the checkpoint, which is of "
            f"{checkpoint.time:.6g} s; run the case from its beginning"
        )
    kept_times(directory / FIELDS, checkpoint.step)
    kept_times(directory / MODE, len(checkpoint.values["run"]["losses"]) - 1)


def total(parts: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Return the wall time (s) of each phase over all parts."""
    sums: dict[str, float] = {}
    for part in parts:
        for phase, seconds in part.items():
            sums[phase] = sums.get(phase, 0.0) + seconds
    return sums


def _opened(
    model: Model, directory: Path, groups: Sequence[str], until: int, name: str = FIELDS
) -> tuple[FieldProbe, FieldSeries]:
    """Return what evaluates groups of fields, and the files that get them; collective."""
    lattice = OutputNodes(model.balance.degree)
    probe = FieldProbe(model, groups, lattice.points)
    units = {f.name: f.unit or "1" for f in probe.fields}
    if name == MODE:
        units |= {field.replace("displacement", "mode"): "1" for field in units}
    places, cells = probe.positions().reshape(-1, 2), model.sheet.original_cells[probe.cells]
    series = FieldSeries(directory, model.comm, lattice, places, cells, units, name, until)
    return probe, series


class FieldWriter:
    """Writes the chosen fields, if any, every so many planned steps, at reversals and at the end.

    Attributes:
        planned: Number of planned steps made so far.
    """

    def __init__(
        self, simulation: Simulation, directory: Path, until: int = -1, planned: int = -1
    ) -> None:
        """Create the files, or go on with those of an earlier run; collective.

        ``until`` is the last step of an earlier run whose fields are kept, negative for none, and
        ``planned`` the number of planned steps that it had made, -1 before the initial state.
        """
        output, program = simulation.output, simulation.program
        self._every = output.every
        self._always = {*program.reversals, program.milestones[-1].time}
        groups = output.fields
        self._files = _opened(simulation.model, directory, groups, until) if groups else None
        self.planned = planned

    def __call__(self, step: Step) -> None:
        """Write the fields if the step's turn has come; collective."""
        if step.milestone is None:
            return
        self.planned += 1
        if self.planned % self._every and step.milestone.time not in self._always:
            return
        if self._files is None:
            return
        probe, series = self._files
        data = {
            name: v.ravel() if v.shape[2] == 1 else v.reshape(-1, v.shape[2])
            for name, v in probe.values().items()
        }
        series.write(step.number, step.time, data)

    def finish(self) -> None:
        """Bring the file that joins all times up to date; collective."""
        if self._files is not None:
            self._files[1].finish()


class ModeWriter:
    """Writes ``mode.h5`` and ``mode.xdmf``: at each loss the displacement and the mode.

    Attributes:
        figures: Of each loss: its time (s), displacement (m), how far from there the first
            saddle is (m), force that is conjugate to the program (N), and the number
            of negative eigenvalues there.
    """

    def __init__(
        self,
        simulation: Simulation,
        directory: Path | None,
        figures: Sequence[Mapping[str, float]] = (),
    ) -> None:
        """Write nothing yet, and go on with the figures of an earlier run.

        Without a directory there are only the figures.
        """
        self._simulation, self._directory = simulation, directory
        self._files: tuple[FieldProbe, FieldSeries] | None = None
        self.figures = [dict(one) for one in figures]

    def __call__(self, step: Step) -> None:
        """Write the loss before a step, if there is one; collective."""
        if step.loss is not None:
            self.add(step.loss)

    def add(self, loss: StabilityLoss) -> None:
        """Write a loss; collective. The model's field is left as it is."""
        if self._directory is not None:
            model, last = self._simulation.model, len(self.figures) - 1
            self._files = self._files or _opened(
                model, self._directory, ["displacement"], last, MODE
            )
            probe, series = self._files
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
                "force_N": loss.force,
                "negative_eigenvalues": loss.negatives,
            }
        )

    def finish(self) -> None:
        """Bring the file that joins all losses up to date; collective."""
        if self._files is not None:
            self._files[1].finish()

    def _evaluated(
        self, probe: FieldProbe, values: NDArray[np.float64]
    ) -> dict[str, NDArray[np.float64]]:
        """Return the displacements of given unknowns at the points, shape (n, 2)."""
        field = self._simulation.model.field
        with preserved(field):
            field.x.array[:] = values
            return {name: v.reshape(-1, v.shape[2]) for name, v in probe.values().items()}
