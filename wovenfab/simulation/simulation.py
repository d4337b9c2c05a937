"""A problem with its load program, and the loop over its steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from signal import Signals
from typing import TYPE_CHECKING, Self

from dolfinx import fem
from mpi4py import MPI

from wovenfab.model.fields import interpolated
from wovenfab.model.model import Model
from wovenfab.record.field_file import Checkpoint
from wovenfab.record.output import Output
from wovenfab.record.results import FINISHED, INTERRUPTED
from wovenfab.simulation.checkpoint import SnapshotFormat
from wovenfab.simulation.progress import Interruption, Stopwatch, signal_behind
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.problem import Problem, SolverOptions
from wovenfab.stepping.program import Program
from wovenfab.stepping.schemes import SCHEMES
from wovenfab.stepping.stability import StabilityLostError, Treatment
from wovenfab.stepping.state import Array
from wovenfab.stepping.step import Step, StepFailedError, StepSizeControl
from wovenfab.stepping.time_stepper import TimeStepper

if TYPE_CHECKING:
    from wovenfab.forms.effect import Target

#: What is called after each accepted step, on every rank; the model's field is that of the step.
Observer = Callable[[Step], None]


class Simulation:
    """A problem and a load program, to be stepped through.

    A context manager, which frees the PETSc objects at the end.

    Attributes:
        solver: Solver of the problem.
        program: The load program.
        output: What a run writes.
        stepper: Goes through the program.
        outcome: Effort so far.
    """

    def __init__(
        self,
        problem: Problem,
        program: Program,
        scheme: str = "bdf2",
        *,
        stability: Treatment = "stop",
        options: SolverOptions | None = None,
        smallest_step: float = 1 / 1024,
        tolerance: float | None = None,
        extrapolate: bool = True,
        output: Output | None = None,
        solver: type[EquilibriumSolver] = EquilibriumSolver,
        step_size: Callable[[float], StepSizeControl] = StepSizeControl,
    ) -> None:
        """Create the solver; collective.

        Args:
            problem: Model and constraints; it is destroyed with this object.
            program: The load program.
            scheme: How rates are formed, ``"bdf2"``, ``"bdf3"``, ``"backward-euler"`` or
                ``"midpoint"``.
            stability: What is done where stability is lost: ``"stop"``, ``"follow"`` the branch
                of minima, or ``"ignore"``.
            options: Of the solver.
            smallest_step: Share of a planned step below which steps are not cut.
            tolerance: Error of a step in time by which steps adapt; None for planned steps.
            extrapolate: Whether a step starts from the state extrapolated, or from the last one.
            output: What a run into a directory writes.
            solver: Another solver, for comparison.
            step_size: Another step size control, for comparison.

        Raises:
            OptionError: PETSc cannot use an option.
            ValueError: The model keeps fewer earlier states than the scheme looks back at, or its
                internal variables yield and the scheme has no equilibrium at the end of a step.
        """
        if SCHEMES[scheme].stage < 1 and any(e.lost for e in problem.model.effects):
            raise ValueError(
                f"elastic friction needs equilibrium at the end of a step, not {scheme}"
            )
        kept, needed = len(problem.model.history), SCHEMES[scheme].memory
        if 0 < kept < needed:
            raise ValueError(f"{scheme} looks back at {needed} states: Numerics(history={needed})")
        self.program, self.output = program, output or Output()
        self.solver = solver(problem, options or SolverOptions())
        self.stepper = TimeStepper(
            self.solver,
            program,
            SCHEMES[scheme],
            smallest_step,
            stability,
            extrapolate,
            step_size,
            tolerance,
        )
        if program.changes:
            self.stepper.control_force()
        self.outcome = Outcome()

    @property
    def model(self) -> Model:
        """The compiled model, whose field is the present state."""
        return self.solver.model

    @property
    def comm(self) -> MPI.Comm:
        """The ranks."""
        return self.model.comm

    @property
    def displacements(self) -> tuple[fem.Function, fem.Function]:
        """The present displacement of each family as a dolfinx function (m).

        With one placement both are the same. The functions share the memory of the solver: copy
        what must outlive the step. Placements that jump have their own unknowns on both sides.
        """
        model = self.model
        first, second = (fem.Function(s, model.field.x) for s in model.placements.families)
        return first, second

    def field(self, name: str) -> fem.Function:
        """Return a field of the present state, discontinuous between cells; collective.

        Args:
            name: As in the results, such as ``shear_angle`` or ``beta``.

        Raises:
            KeyError: If the effects give it no meaning.
        """
        return interpolated(self.model, name)

    def differentiate(self, targets: Sequence[Target], dissipation: bool = True) -> None:
        """Give each step the derivatives of force and dissipation by parameters; collective.

        Raises:
            ValueError: The program prescribes a force.
            TargetError: There is no such parameter.
        """
        if self.program.changes:
            raise ValueError("derivatives by parameters need a program of displacements")
        self.stepper.differentiate(targets, dissipation=dissipation)

    def start_at(self, state: Array) -> None:
        """Let the program start from another state than that of reference.

        Displacements, work and dissipated energy count from there.

        Args:
            state: Unknowns with ghosts, m.
        """
        self.stepper.start_at(state)

    def steps(self) -> Iterator[Step]:
        """Yield the initial state and then each accepted step; collective.

        Raises:
            StepFailedError: If a step cannot be made; the field is the last accepted.
            StabilityLostError: If no minimum lies beyond it.
        """
        yield from self.stepper.steps()

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
        cutbacks: Rejected attempts.
    """

    failure: StepFailedError | StabilityLostError | None = None
    signal: int = 0
    paused: bool = False
    steps: int = 0
    iterations: int = 0
    cutbacks: int = 0

    def after(self, step: Step) -> Outcome:
        """Return the outcome with one more step."""
        return Outcome(
            steps=step.number,
            iterations=self.iterations + step.iterations,
            cutbacks=self.cutbacks + step.cutbacks,
        )

    @property
    def effort(self) -> dict[str, int]:
        """The counters, which go on with a run."""
        return {name: getattr(self, name) for name in ("steps", "iterations", "cutbacks")}

    def __str__(self) -> str:
        """Return how the run ended, as in the summary."""
        if self.signal:
            return f"{INTERRUPTED} by {Signals(self.signal).name}"
        return "paused" if self.paused else str(self.failure or FINISHED)
