"""The Python interface: run cases, step through them, read results.

The names of this module are those of the package: ``wovenfab.simulate`` and so on. In a notebook::

    case = wovenfab.read_case("configs/bias-1x3.yaml", {"program.amplitudes": "40 mm"})
    run = wovenfab.simulate(case)
    run.history["force"]

Under ``mpirun`` all ranks call the same functions and get the same history.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, fields
from functools import cached_property
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.case import Case, CaseError, case_error, read_case
from wovenfab.case.objects import sheet_of, simulation_of
from wovenfab.case.programs import effect_programs
from wovenfab.case.resume import require_same
from wovenfab.record.fields import StoredFields, read_fields
from wovenfab.record.history import read_history
from wovenfab.record.results import FINISHED, ResultsDirectory, draw_in_subprocess
from wovenfab.record.summary import read_summary
from wovenfab.simulation.checkpoint import load_checkpoint, require_same_mesh
from wovenfab.simulation.progress import Interruption, Progress, Stopwatch
from wovenfab.simulation.run import Columns, run
from wovenfab.simulation.simulation import Observer, Outcome, Simulation
from wovenfab.stepping.step import Step

if TYPE_CHECKING:
    from dolfinx import fem

logger = logging.getLogger(__name__)
Array = NDArray[np.float64]
#: Beginning of a message that is a warning.
WARNING = "warning: "
__all__ = [
    "Case",
    "CaseError",
    "History",
    "Run",
    "SolvedStep",
    "StepOverError",
    "read_case",
    "read_results",
    "simulate",
    "steps",
]


class History(Mapping[str, Array]):
    """The columns of ``history.csv`` by name, each of shape (steps + 1,).

    A unit at the end may be left out: ``history["force"]`` is ``history["force_N"]``. All values
    are in SI units.
    """

    def __init__(self, columns: Mapping[str, Array]) -> None:
        """Take the columns by their full names."""
        self._columns = dict(columns)
        self._short = {name.rpartition("_")[0]: name for name in columns if _has_unit(name)}

    def __getitem__(self, name: str) -> Array:
        """Return a column by its name, with or without its unit."""
        try:
            return self._columns[self._short.get(name, name)]
        except KeyError:
            known = ", ".join(self._columns)
            raise KeyError(f"the history has no column {name!r}; it has {known}") from None

    def __iter__(self) -> Iterator[str]:
        """Iterate over the full names."""
        return iter(self._columns)

    def __len__(self) -> int:
        """Return the number of columns."""
        return len(self._columns)

    def __repr__(self) -> str:
        """Say how many rows there are of which columns."""
        rows = len(next(iter(self._columns.values()), ()))
        return f"History({rows} rows of {', '.join(self)})"


@dataclass(frozen=True, repr=False)
class Run:
    """A run that has ended.

    Attributes:
        history: A row for the start and for each step.
        summary: What ``summary.json`` has; empty where the run was killed or is going on.
        directory: The results directory; None of a run in memory.
    """

    history: History
    summary: Mapping[str, Any]
    directory: Path | None = None
    _case: Case | None = None

    @cached_property
    def case(self) -> Case:
        """What was run; of results that were read it is read from their ``case.yaml`` now.

        Nothing is executed for that. A case that names the Python file of an effect is read by
        ``wovenfab.read_case(directory / "case.yaml")``, which runs that file.

        Raises:
            CaseError: If the case cannot be read, names such a file, or one that is not there.
        """
        if self._case is not None:
            return self._case
        assert self.directory is not None
        path = self.directory / "case.yaml"
        if programs := effect_programs(path):
            raise case_error(
                str(path),
                f"reading this case runs {' and '.join(programs)}",
                "Call wovenfab.read_case for it if that is wanted.",
            )
        return read_case(path)

    @property
    def figures(self) -> Mapping[str, Mapping[str, float | None]]:
        """Figures in SI units by the name of the standard test, then by their own name.

        None stands for what the run does not determine. Definitions and laboratory units are in
        ``figures.json``.
        """
        return dict(self.summary.get("figures", {}))

    @property
    def finished(self) -> bool:
        """Whether the program came to its end."""
        return bool(self.summary.get("outcome") == FINISHED)

    @cached_property
    def fields(self) -> StoredFields:
        """The stored fields; a run in memory has none.

        Raises:
            FileNotFoundError: If no fields were stored.
        """
        if self.directory is None:
            raise FileNotFoundError(
                "a run in memory stores no fields: give simulate() a directory, or loop over "
                "wovenfab.steps(case)"
            )
        return read_fields(self.directory)

    def __repr__(self) -> str:
        """Say what was run, how it ended and its main figures."""
        s = self.summary
        where = f", in {self.directory}" if self.directory else ""
        name = self._case.name if self._case is not None else "case"
        if not s:
            return f"Run({name}: killed or going on, {self.history}{where})"
        return (
            f"Run({name}: {s['outcome']}, {s['steps']} steps, peak force "
            f"{s['peak_force_N']:.6g} N, dissipated {s['dissipated_J']:.6g} J{where})"
        )


class StepOverError(RuntimeError):
    """A step is asked for fields after the simulation has gone on to another one."""


@dataclass(frozen=True)
class SolvedStep(Step):
    """An accepted step while its fields are at hand: until the loop goes on.

    Attributes:
        simulation: The simulation, whose model has the present state.
    """

    simulation: Simulation = field(kw_only=True, repr=False)

    @property
    def displacements(self) -> tuple[fem.Function, fem.Function]:
        """The displacement of each family as a dolfinx function (m).

        With one placement both are the same. The functions share the memory of the solver:
        copy what must outlive the step. Placements that jump have their own unknowns on both
        sides.

        Raises:
            StepOverError: If the simulation is at another step.
        """
        self._require_present()
        return self.simulation.displacements

    def field(self, name: str) -> fem.Function:
        """Return a field of the sheet as a dolfinx function, discontinuous between cells.

        Args:
            name: As in the results, such as ``shear_angle`` or ``beta``.

        Raises:
            KeyError: If the effects of the case give it no meaning.
            StepOverError: If the simulation is at another step.
        """
        self._require_present()
        return self.simulation.field(name)

    def _require_present(self) -> None:
        now = self.simulation.stepper.number
        if now != self.number:
            raise StepOverError(
                f"step {self.number} is over: the fields are those of step {now}. Ask for them "
                "within the loop over steps(), and copy what must outlive the step"
            )


@dataclass(frozen=True)
class Listener:
    """Who is told what happens; called on every rank.

    Attributes:
        say: Gets messages.
        progress: Gets the progress.
        accepted: Called on rank 0 alone when the run is refused no more: the results directory is
            its own, and no file of an earlier run has been changed unless that was asked for.
    """

    say: Callable[[str], None] = lambda text: None
    progress: Callable[[Progress], None] = lambda now: None
    accepted: Callable[[], None] = lambda: None


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
    resume: bool = False,
    until: float = inf,
    interruption: Interruption | None = None,
    observers: Sequence[Observer] = (),
) -> Execution:
    """Run a case; collective.

    Args:
        case: The case.
        directory: Where results are written; None for a run in memory.
        overwrite: Replace the results of an earlier run there.
        comm: The ranks.
        listener: Who is told what happens.
        watch: Gets the wall times of the phases.
        resume: Go on from the newest checkpoint in the directory.
        until: Time (s) at or after which the run pauses.
        interruption: Notes signals; None to leave them alone.
        observers: Called after each accepted step.

    Raises:
        CaseError: If the geometry or an effect of the case cannot be used.
        ResultsExistError: If the directory has results that must not be replaced.
        NothingToResumeError: If the case cannot go on from there.
        OSError: If the directory cannot be written.
    """
    listener, watch, checkpoint = listener or Listener(), watch or Stopwatch(), None
    for line in case.remarks():
        listener.say(line)
    with ExitStack() as stack:
        place = None
        if directory is not None:
            place = stack.enter_context(ResultsDirectory(directory, comm))
            if resume:
                checkpoint = load_checkpoint(directory, comm)
                place.reopen()
                case = require_same(case, checkpoint, directory)
                listener.say(f"going on after step {checkpoint.step} at {checkpoint.time:.6g} s")
            else:
                place.require_free(overwrite)
        with watch.phase("mesh"):
            sheet = sheet_of(case, comm)
        if checkpoint is not None and directory is not None:
            require_same_mesh(sheet, checkpoint, directory)
        progress, planned = listener.progress, None
        errors = checkpoint.values["run"]["errors"] if checkpoint else None
        if case.accuracy is not None:
            from wovenfab.study.errors.report import choose, errors_of

            with watch.phase("pilot"):
                planned = choose(case, sheet, listener.say, lambda text: progress(Progress(text)))
            errors = errors_of(planned, case)
            case, sheet = planned.case, planned.sheet
        progress(Progress("compiling the effects"))
        with watch.phase("compile"):
            simulation = stack.enter_context(
                simulation_of(case, sheet, resumes=checkpoint is not None)
            )
        if checkpoint is None and case.from_state is not None:
            listener.say(
                f"starting from the last state of {case.from_state}: displacements, work and "
                "dissipated energy count from there"
            )
        if place is not None and checkpoint is None:
            place.open(overwrite)
            if planned is not None and planned.estimate is not None:
                from wovenfab.study.errors.estimate import write_errors

                write_errors(planned.estimate, place.path)
        outcome, columns, summary = run(
            simulation,
            directory,
            progress,
            watch,
            checkpoint,
            until,
            interruption,
            errors,
            listener.accepted,
            observers,
        )
        if names := simulation.solver.unread_options():
            what = "a name is misspelt, or nothing here uses it"
            listener.say(f"warning: PETSc has not read {', '.join(names)}: {what}")
        if errors is not None:
            from wovenfab.study.errors.report import report_errors

            summary = report_errors(errors, case, summary, columns, directory, listener.say)
        if directory is not None and case.output.pictures and not outcome.signal:
            warning = draw_in_subprocess(directory, comm).warning
            if warning is not None:
                listener.say(f"warning: {warning}")
    return Execution(case, outcome, columns, summary)


def simulate(
    what: Case | str | Path | Simulation,
    directory: str | Path | None = None,
    *,
    overwrite: bool = False,
    resume: bool = False,
    until: float = inf,
    observers: Sequence[Observer] = (),
    comm: MPI.Comm | None = None,
) -> Run:
    """Run a case or a simulation; collective.

    Args:
        what: A case, its file, or a simulation that has not begun.
        directory: Where results are written, as ``wovenfab run`` does; None for a run in
            memory, which writes nothing.
        overwrite: Replace the results of an earlier run there.
        resume: Go on from the newest checkpoint there.
        until: Time (s) at or after which the run pauses.
        observers: Called in this order after each accepted step; the model's field is that of
            the step.
        comm: The ranks of a case; all unless given.

    Returns:
        The run. One that stopped early has a summary with the reason as its ``outcome``.

    Raises:
        CaseError: If the case, its geometry or an effect cannot be used.
        ResultsExistError: If the directory has results.
        NothingToResumeError: If it cannot go on from there.
        OSError: If the directory cannot be written.
    """
    place = None if directory is None else Path(directory)
    if isinstance(what, Simulation):
        columns, summary = _run(what, place, overwrite, resume, until, observers)
        return Run(History(columns), summary, place)
    case = read_case(what) if isinstance(what, str | Path) else what
    done = execute(
        case,
        place,
        overwrite,
        comm or MPI.COMM_WORLD,
        resume=resume,
        until=until,
        observers=observers,
    )
    return Run(History(done.columns), done.summary, place, done.case)


def _run(
    simulation: Simulation,
    directory: Path | None,
    overwrite: bool,
    resume: bool,
    until: float,
    observers: Sequence[Observer],
) -> tuple[Columns, dict[str, Any]]:
    """Run a simulation, into a directory or in memory."""
    checkpoint, comm = None, simulation.comm
    with ExitStack() as stack:
        if directory is not None:
            place = stack.enter_context(ResultsDirectory(directory, comm))
            if resume:
                checkpoint = load_checkpoint(directory, comm)
                place.reopen()
                require_same_mesh(simulation.model.sheet, checkpoint, directory)
            else:
                place.require_free(overwrite)
                place.open(overwrite)
        watch = Stopwatch()
        _, columns, summary = run(
            simulation, directory, lambda now: None, watch, checkpoint, until, observers=observers
        )
    return columns, summary


def steps(case: Case | str | Path, *, comm: MPI.Comm | None = None) -> Iterator[SolvedStep]:
    """Yield the initial state and each accepted step of a case; collective.

    Args:
        case: A case, or its file; for an accuracy its elements and steps are chosen as by
            :func:`simulate`, and what is chosen or not reached is logged.
        comm: The ranks; all unless given.

    Raises:
        CaseError: If the case, its geometry or an effect cannot be used.
        StepFailedError: If a step cannot be made.
        StabilityLostError: If the sheet buckles and the case says to stop there.
    """
    from wovenfab.study.errors.report import settled

    chosen = read_case(case) if isinstance(case, str | Path) else case
    chosen, sheet = settled(chosen, comm or MPI.COMM_WORLD, _log_warning)
    with simulation_of(chosen, sheet) as simulation:
        for step in simulation.steps():
            values = {f.name: getattr(step, f.name) for f in fields(step)}
            yield SolvedStep(**values, simulation=simulation)


def _log_warning(text: str) -> None:
    if text.startswith(WARNING):
        logger.warning(text.removeprefix(WARNING))


def read_results(directory: str | Path) -> Run:
    """Return the run that a results directory holds; it may still go on, or have stopped.

    Only data are read: nothing that the directory names is executed, or must still be there.

    Raises:
        FileNotFoundError: If it holds no results.
        ValueError: If a file of theirs is damaged, or not written by wovenfab.
    """
    place = Path(directory)
    return Run(History(read_history(place)), read_summary(place), place)


def _has_unit(name: str) -> bool:
    return name.rpartition("_")[2] in {"s", "m", "N", "J", "rad"}
