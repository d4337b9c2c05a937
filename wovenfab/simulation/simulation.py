"""A case ready to be stepped, and the loop over its steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from signal import Signals
from typing import TYPE_CHECKING, Self

from mpi4py import MPI

from wovenfab.case import Case, CaseError
from wovenfab.model.model import Model
from wovenfab.record.field_file import Checkpoint
from wovenfab.record.results import FINISHED, INTERRUPTED
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.checkpoint import SnapshotFormat, state_of
from wovenfab.simulation.from_case import (
    constraints_of,
    in_case,
    model_of,
    options_of,
    require_values,
    scheme_of,
)
from wovenfab.simulation.progress import Interruption, Stopwatch, require_memory, signal_behind
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.problem import OptionError, Problem, SolverOptions
from wovenfab.stepping.program import program_of_case
from wovenfab.stepping.stability import StabilityLostError, Treatment
from wovenfab.stepping.step import Step, StepFailedError, StepSizeControl
from wovenfab.stepping.time_stepper import TimeStepper

if TYPE_CHECKING:
    from wovenfab.forms.effect import Target

#: What is called after each accepted step, on every rank; the model's field is that of the step.
Observer = Callable[[Step], None]


class Simulation:
    """A case on its sheet: problem, solver, load program and time stepper.

    A context manager, which frees the PETSc objects at the end.

    Attributes:
        case: The validated case.
        solver: Solver of its problem.
        program: The load program.
        stepper: Goes through the program.
        outcome: Effort so far.
    """

    def __init__(
        self,
        case: Case,
        sheet: Sheet,
        stability: Treatment | None = None,
        options: SolverOptions | None = None,
        solver: type[EquilibriumSolver] = EquilibriumSolver,
        step_size: Callable[[float], StepSizeControl] = StepSizeControl,
        model: Model | None = None,
    ) -> None:
        """Compile a case; collective.

        Args:
            case: The validated case.
            sheet: Its meshed sheet.
            stability: What is done where stability is lost, if not what the case says.
            options: Of the solver, if not those of the case.
            solver: Another solver, for comparison.
            step_size: Another step size control, for comparison.
            model: The compiled model of a case that differs in program and steps only; its state
                is lost, for stepping begins at that of reference.

        Raises:
            CaseError: If an effect cannot be compiled or has no value, or PETSc cannot use an
                option.
        """
        if model is None:
            model = model_of(case, sheet)
            require_memory(case, model.unknowns, model.comm)
            require_values(case, model)
        problem = Problem(model, constraints_of(case, model))
        self.case, self.program = case, program_of_case(case)
        try:
            self.solver = solver(problem, options or options_of(case))
        except OptionError as error:
            remedy = "They stand in solver.petsc, after -- on the command line or in PETSC_OPTIONS."
            raise CaseError([case.problem("solver.petsc", str(error), remedy)]) from error
        self.stepper = TimeStepper(
            self.solver,
            self.program,
            scheme_of(case),
            case.time.smallest_step,
            stability or case.solver.stability,
            case.solver.predictor == "quadratic",
            step_size,
            case.time.tolerance,
        )
        if self.program.changes:
            self.stepper.control_force()
        self._prepared = False
        self.outcome = Outcome()

    @property
    def model(self) -> Model:
        """The compiled model, whose field is the present state."""
        return self.solver.model

    @property
    def comm(self) -> MPI.Comm:
        """The ranks."""
        return self.model.comm

    def differentiate(self, targets: Sequence[Target], dissipation: bool = True) -> None:
        """Give each step the derivatives of force and dissipation by parameters; collective.

        Raises:
            CaseError: If the program prescribes a force.
            TargetError: If the scene has no such parameter.
        """
        if self.program.changes:
            message = "derivatives by parameters are not available where a force is prescribed"
            raise CaseError([self.case.problem("program", message, "Prescribe displacements.")])
        targets = [in_case(target, self.case) for target in targets]
        self.stepper.differentiate(targets, dissipation=dissipation)

    def steps(self) -> Iterator[Step]:
        """Yield the initial state and then each accepted step; collective.

        Raises:
            StepFailedError: If a step cannot be made; the field is the last accepted.
            StabilityLostError: If no minimum lies beyond it.
        """
        self.prepare()
        yield from self.stepper.steps()

    def prepare(self) -> str:
        """Take the state that the case starts from, and say what that is; collective.

        Raises:
            CaseError: There is none, or it is of another sheet.
        """
        if self.case.from_state is None or self.stepper.begun or self._prepared:
            return ""
        state, words = state_of(self.case, self.model)
        self.stepper.start_at(state)
        self._prepared = True
        return words

    def resume(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint of the same physics and mesh; collective."""
        values = checkpoint.values["stepper"]
        self.stepper.resume(SnapshotFormat(self.model).scatter(values, checkpoint.arrays))

    def run(
        self,
        *observers: Observer,
        watch: Stopwatch | None = None,
        until: float = inf,
        interruption: Interruption | None = None,
    ) -> Outcome:
        """Go through the program; collective.

        A step that cannot be made, stability that is lost, or a signal ends the run early.

        Args:
            observers: Called in this order after each accepted step.
            watch: Gets the wall time of the steps, the first one apart.
            until: Time (s) at or after which the run pauses.
            interruption: Notes signals; None to leave them alone.
        """
        watch = watch or Stopwatch()
        if interruption is not None:
            interruption.begin_steps()
            self.solver.newton.on_iteration = partial(interruption.check, self.comm)
        steps, phase = self.steps(), "first step"
        while True:
            try:
                with watch.phase(phase):
                    step = next(steps, None)
            except (StepFailedError, StabilityLostError) as failure:
                cutbacks = self.outcome.cutbacks + failure.cutbacks
                return replace(self.outcome, failure=failure, cutbacks=cutbacks)
            except BaseException as error:
                if not (number := signal_behind(error)):
                    raise
                self.stepper.restore()
                return replace(self.outcome, signal=number)
            if step is None:
                return self.outcome
            phase = "steps" if step.number else phase
            self.outcome = self.outcome.after(step)
            for observe in observers:
                observe(step)
            if interruption is not None and (number := interruption.asked(self.comm)):
                return replace(self.outcome, signal=number)
            if step.time >= until and step.time < self.program.milestones[-1].time:
                return replace(self.outcome, paused=True)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.stepper.destroy()
        self.solver.destroy()

    def __enter__(self) -> Self:
        """Return the simulation itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Free the PETSc objects; collective."""
        self.destroy()


@dataclass(frozen=True)
class Outcome:
    """How a run ended, and its effort.

    Attributes:
        failure: Why it stopped early, or None.
        signal: Number of the signal that ended it, or 0.
        paused: Whether it stopped at a time that was asked for.
        steps: Accepted steps.
        iterations: Their Newton iterations.
        tangents: Number of these that formed a tangent.
        cutbacks: Rejected attempts.
    """

    failure: StepFailedError | StabilityLostError | None = None
    signal: int = 0
    paused: bool = False
    steps: int = 0
    iterations: int = 0
    tangents: int = 0
    cutbacks: int = 0

    def after(self, step: Step) -> Outcome:
        """Return the outcome with one more step."""
        return Outcome(
            steps=step.number,
            iterations=self.iterations + step.iterations,
            tangents=self.tangents + step.tangents,
            cutbacks=self.cutbacks + step.cutbacks,
        )

    @property
    def effort(self) -> dict[str, int]:
        """The counters, which go on with a run."""
        return {
            name: getattr(self, name) for name in ("steps", "iterations", "tangents", "cutbacks")
        }

    def __str__(self) -> str:
        """Return how the run ended, as in the summary."""
        if self.signal:
            return f"{INTERRUPTED} by {Signals(self.signal).name}"
        return "paused" if self.paused else str(self.failure or FINISHED)
