"""From one equilibrium to the next, with cut-backs where a step does not converge."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from wovenfab.model.constraints import Constraints
from wovenfab.model.model import Model
from wovenfab.solver.diagnosis import diagnose, unsound_penalty
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.options import SolveResult
from wovenfab.stepping.energy_balance import EnergyBalance
from wovenfab.stepping.program import Milestone, Program
from wovenfab.stepping.schemes import Scheme
from wovenfab.stepping.stability import Stability, StabilityLoss, Treatment
from wovenfab.stepping.state import Array, State, equilibrate
from wovenfab.stepping.step import Step, StepFailedError, UnsoundSheetError
from wovenfab.stepping.step_size import StepSizeControl
from wovenfab.stepping.time_error import StepError, TimeErrorEstimator, rate_error


class TimeStepper:
    """Marches a model through a load program."""

    def __init__(
        self,
        model: Model,
        constraints: Constraints,
        equilibrium: EquilibriumSolver,
        program: Program,
        scheme: Scheme,
        smallest_step: float,
        treatment: Treatment = "stop",
        predict: bool = True,
        pace: Callable[[float], StepSizeControl] = StepSizeControl,
        tolerance: float | None = None,
    ) -> None:
        """Start from the reference state.

        Args:
            model: The compiled model.
            constraints: Its prescribed placements.
            equilibrium: Its solver.
            program: The load program.
            scheme: The time scheme.
            smallest_step: Share of a planned step below which cutting back ends.
            treatment: What is done where stability is lost.
            predict: Start a step from the extrapolated motion, not from the last state.
            pace: Returns how steps are cut and grown, from the smallest share.
            tolerance: Error of a step in power and force, each over its largest size so far,
                by which steps are shortened and grown; None for planned steps. It is
                measured for the rates of BDF2, and so without effect where there are none.
        """
        self._model, self._constraints, self._equilibrium = model, constraints, equilibrium
        self._program, self._scheme = program, scheme
        self._smallest = smallest_step
        self._pace = pace(smallest_step)
        self._embedded: TimeErrorEstimator | None = None
        if tolerance and scheme.name == "bdf2" and model.history:
            self._embedded = TimeErrorEstimator(model, constraints, equilibrium, tolerance)
        self._stability = Stability(model, constraints, equilibrium, treatment)
        self._motion = State(model, constraints, equilibrium, program, scheme, predict)
        self._account = EnergyBalance(model, constraints, equilibrium, scheme)
        self._cutbacks = 0

    @property
    def started(self) -> bool:
        """Whether a step has been accepted."""
        return self._motion.number > 0

    @property
    def measures_errors(self) -> bool:
        """Whether the error of steps in time is measured."""
        return self._embedded is not None

    def begin_near(self, guess: Callable[[float], Array | None]) -> None:
        """Begin steps from a guess instead of the extrapolated motion.

        Args:
            guess: Returns the state at the end of a step (unknowns with ghosts, m) from its
                time (s), or None where it knows none.
        """
        self._motion.begin_near(guess)

    def steps(self) -> Iterator[Step]:
        """Yield the initial state and then each accepted step.

        Raises:
            StepFailedError: If a step cannot be made; the field is the last accepted.
            StabilityLostError: If no minimum lies beyond it.
        """
        first = self._program.milestones[0]
        self._motion.restore()
        outcome, self._cutbacks = equilibrate(
            self._model, self._constraints, self._equilibrium, first.displacement, self._smallest,
            self._stability.refuses,
        )  # fmt: skip
        self._motion.begin()
        if outcome is not None:
            self._account.begin()
        yield self._record(outcome, first)
        self._cutbacks = 0
        for start, end in zip(self._program.milestones, self._program.milestones[1:], strict=False):
            yield from self._reach(start, end)

    def _reach(self, start: Milestone, end: Milestone) -> Iterator[Step]:
        """Step from one planned time to the next, in shorter steps where needed."""
        jump = start.jump
        planned = end.time - start.time
        if self._embedded is not None and (jump or not self._motion.number):
            self._pace.aim(self._embedded.first(jump) * planned)
        while self._motion.time < end.time:
            until = self._pace.next(self._motion.time, end.time)
            length = until - self._motion.time
            outcome = self._motion.attempt(until, jump)
            if not self._motion.number:
                self._check_rest(until, outcome)
            outcome = self._settled(until, planned, outcome)
            refused = self._stability.refuses(outcome)
            if outcome.converged and not refused:
                error = self._measure(until, jump)
                if self._is_too_long(error, length, planned):
                    self._cutbacks += 1
                    self._motion.restore()
                    continue
                self._account.add(self._motion, until, jump, error)
                self._motion.accept(until, jump)
                if self._embedded is None:
                    self._pace.made(length, outcome.tangents)
                loss = self._stability.passed()
                if loss is not None:
                    self._pace.found(length)
                jump = loss is not None
                yield self._record(outcome, end if until == end.time else None, loss)
                self._cutbacks = 0
                continue
            self._cutbacks += 1
            if self._stability.loss is not None:  # try farther beyond it, if that is wanted
                self._motion.restore()
                if until == end.time or not self._stability.follows:
                    raise self._stability.give_up(self._cutbacks)
                self._pace.lengthen(length)
                continue
            if refused:
                self._pace.bisect(until, length)
            elif not self._pace.cut(length, planned):
                found = diagnose(self._model, self._equilibrium, outcome, self._motion.states[0])
                displacement = self._program.displacement(until)
                raise StepFailedError(until, displacement, length, outcome, self._cutbacks, found)
            self._motion.restore()

    def _measure(self, until: float, jump: bool) -> StepError | None:
        """Return the error of the step that was just solved, where enough is known."""
        if self._embedded is None or jump or len(self._motion.steps) < 2:
            return None
        step = until - self._motion.time
        wrong = rate_error(self._model.field.x.array, self._motion.states, self._motion.steps, step)
        return self._embedded.measure(wrong, self._scheme.weights(step, self._motion.steps[0]))

    def _is_too_long(self, error: StepError | None, length: float, planned: float) -> bool:
        """Set the length of the next step, and return whether it is this one made again."""
        if self._embedded is None or error is None:
            return False
        best = length * self._embedded.growth(error)
        self._pace.aim(best)
        return self._embedded.refuses(error) and best >= self._smallest * planned

    def _check_rest(self, until: float, outcome: SolveResult) -> None:
        """Refuse a penalty that makes the sheet at rest unstable, whatever was found."""
        reached = self._model.field.x.array.copy()
        self._model.field.x.array[:] = self._motion.states[0]
        if fault := unsound_penalty(self._model, self._equilibrium):
            displacement = self._program.displacement(until)
            step = until - self._motion.time
            raise UnsoundSheetError(until, displacement, step, outcome, 0, fault)
        self._model.field.x.array[:] = reached

    def _settled(self, until: float, planned: float, outcome: SolveResult) -> SolveResult:
        """Return the outcome, or how a saddle was left that is next to the last minimum."""
        share, force = (until - self._motion.time) / planned, self._account.forces.force
        if not self._stability.refuses(outcome) or not self._stability.is_close(
            force, share, self._smallest
        ):
            return outcome
        now, then = ((t, self._program.displacement(t)) for t in (self._motion.time, until))
        return self._stability.leave(now, then, force, outcome)

    def _record(
        self,
        outcome: SolveResult | None,
        milestone: Milestone | None,
        loss: StabilityLoss | None = None,
    ) -> Step:
        return Step(
            number=self._motion.number,
            time=self._motion.time,
            displacement=self._program.displacement(self._motion.time),
            reactions=self._constraints.reactions(self._account.forces.force),
            stored=self._model.stored_energy(),
            dissipated=dict(self._account.dissipated),
            work=self._account.work,
            iterations=outcome.iterations if outcome else 0,
            cutbacks=self._cutbacks,
            milestone=milestone,
            negatives=outcome.negatives if outcome else 0,
            tangents=outcome.tangents if outcome else 0,
            loss=loss,
            error=self._account.error,
            dissipated_error=self._account.dissipated_error,
        )
