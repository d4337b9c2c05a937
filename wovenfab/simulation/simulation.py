"""A case ready to be stepped, and the loop over its steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Self

from mpi4py import MPI

from wovenfab.case import Case
from wovenfab.model.model import Model
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.from_case import (
    constraints_of,
    driven_edge,
    model_of,
    options_of,
    program_of_case,
    scheme_of,
)
from wovenfab.simulation.progress import Stopwatch
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.problem import Problem, SolverOptions
from wovenfab.stepping.stability import StabilityLostError, Treatment
from wovenfab.stepping.step import Step, StepFailedError
from wovenfab.stepping.step_size import StepSizeControl
from wovenfab.stepping.time_stepper import TimeStepper

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
    """

    def __init__(
        self,
        case: Case,
        sheet: Sheet,
        stability: Treatment | None = None,
        options: SolverOptions | None = None,
        solver: type[EquilibriumSolver] = EquilibriumSolver,
        step_size: Callable[[float], StepSizeControl] = StepSizeControl,
    ) -> None:
        """Compile a case; collective.

        Args:
            case: The validated case.
            sheet: Its meshed sheet.
            stability: What is done where stability is lost, if not what the case says.
            options: Of the solver, if not those of the case.
            solver: Another solver, for comparison.
            step_size: Another step size control, for comparison.
        """
        model = model_of(case, sheet)
        problem = Problem(model, constraints_of(case, model))
        self.case, self.program = case, program_of_case(case)
        self.solver = solver(problem, options or options_of(case))
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
        self._edge, self._direction = driven_edge(case)

    @property
    def model(self) -> Model:
        """The compiled model, whose field is the present state."""
        return self.solver.problem.model

    @property
    def comm(self) -> MPI.Comm:
        """The ranks."""
        return self.model.comm

    def driven_force(self, forces: dict[str, tuple[float, float]]) -> tuple[float, float]:
        """Return the force (N) of the driven edge along its motion and across it.

        Args:
            forces: Forces (N; x, y) of all held edges.
        """
        (x, y), (fx, fy) = self._direction, forces[self._edge]
        return x * fx + y * fy, x * fy - y * fx

    def steps(self) -> Iterator[Step]:
        """Yield the initial state and then each accepted step; collective.

        Raises:
            StepFailedError: If a step cannot be made; the field is the last accepted.
            StabilityLostError: If no minimum lies beyond it.
        """
        for step in self.stepper.steps():
            along, across = self.driven_force(step.reactions)
            error = self.driven_force(dict(step.error.forces))[0] if step.error else 0.0
            yield replace(step, force=along, force_transverse=across, force_error=error)

    def run(self, *observers: Observer, watch: Stopwatch | None = None) -> Outcome:
        """Go through the program; collective.

        A step that cannot be made, or stability that is lost, ends the run early.

        Args:
            observers: Called in this order after each accepted step.
            watch: Gets the wall time of the steps, the first one apart.
        """
        watch = watch or Stopwatch()
        steps, outcome = self.steps(), Outcome()
        while True:
            try:
                with watch.phase("steps" if self.stepper.started else "first step"):
                    step = next(steps, None)
            except (StepFailedError, StabilityLostError) as failure:
                cutbacks = outcome.cutbacks + failure.cutbacks
                return replace(outcome, failure=failure, cutbacks=cutbacks)
            if step is None:
                return outcome
            outcome = outcome.after(step)
            for observe in observers:
                observe(step)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.solver.destroy()

    def __enter__(self) -> Self:
        """Return the simulation itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Free the PETSc objects; collective."""
        self.destroy()


@dataclass(frozen=True)
class Outcome:
    """How a run ended, and its effort.

    Attributes:
        failure: Why it stopped early, or None.
        steps: Accepted steps.
        iterations: Their Newton iterations.
        tangents: Number of these that formed a tangent.
        cutbacks: Rejected attempts.
    """

    failure: StepFailedError | StabilityLostError | None = None
    steps: int = 0
    iterations: int = 0
    tangents: int = 0
    cutbacks: int = 0

    def after(self, step: Step) -> Outcome:
        """Return the outcome with one more step."""
        return Outcome(
            None,
            step.number,
            self.iterations + step.iterations,
            self.tangents + step.tangents,
            self.cutbacks + step.cutbacks,
        )
