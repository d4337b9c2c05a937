"""From one equilibrium to the next, with shorter steps where one does not converge."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from wovenfab.model.model import preserved
from wovenfab.solver.diagnosis import diagnose, unsound_penalty
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.problem import SolveResult
from wovenfab.stepping.energy_balance import EnergyBalance
from wovenfab.stepping.force_control import ForceControl
from wovenfab.stepping.program import Milestone, Program
from wovenfab.stepping.schemes import Scheme, StepError, TimeErrorEstimator
from wovenfab.stepping.sensitivity import TangentLinear
from wovenfab.stepping.stability import Stability, StabilityLoss, StabilityLostError, Treatment
from wovenfab.stepping.state import Array, State, equilibrate
from wovenfab.stepping.step import Step, StepFailedError, StepSizeControl, UnsoundSheetError

if TYPE_CHECKING:
    from wovenfab.forms.effect import Target
logger = logging.getLogger(__name__)


class TimeStepper:
    """Steps a problem through a load program.

    Attributes:
        begun: Whether the initial state has been reached.
        measures_energy: Whether steps have the stored energies; they cost an integral each.
    """

    def __init__(
        self,
        solver: EquilibriumSolver,
        program: Program,
        scheme: Scheme,
        smallest_step: float,
        treatment: Treatment = "stop",
        predict: bool = True,
        step_size: Callable[[float], StepSizeControl] = StepSizeControl,
        tolerance: float | None = None,
    ) -> None:
        """Start from the reference state.

        Args:
            solver: Solver of the problem.
            program: The load program.
            scheme: The time scheme.
            smallest_step: Share of a planned step below which steps are not cut.
            treatment: What is done where stability is lost.
            predict: Start a step from the extrapolated state, not from the last one.
            step_size: Returns the step size control for a smallest share.
            tolerance: Error of a step in power and force, each over its largest size so far,
                by which steps are shortened and grown; None for planned steps. It is
                measured for the rates of BDF, and so without effect where there are none.
        """
        self._solver, self._problem = solver, solver.problem
        self._program, self._scheme = program, scheme
        self._smallest = smallest_step
        self._step_size = step_size(smallest_step)
        self._time_error: TimeErrorEstimator | None = None
        if tolerance and scheme.measures_error and solver.problem.model.history:
            self._time_error = TimeErrorEstimator(solver, scheme, tolerance)
        self._stability = Stability(solver, treatment)
        self._state = State(solver, program, scheme, predict)
        self._balance = EnergyBalance(solver, scheme)
        self._tangent_linear: TangentLinear | None = None
        self._cutbacks = 0
        self._jump = False  # whether the velocity jumps where the next step begins
        self.begun = False
        self.measures_energy = True

    @property
    def started(self) -> bool:
        """Whether a step has been accepted."""
        return self._state.number > 0

    @property
    def number(self) -> int:
        """Number of accepted steps."""
        return self._state.number

    @property
    def time(self) -> float:
        """Time of the last accepted state, s."""
        return self._state.time

    @property
    def measures_errors(self) -> bool:
        """Whether the error of steps in time is measured."""
        return self._time_error is not None

    @property
    def state_derivatives(self) -> Array:
        """Derivatives of the last accepted state, with ghosts, shape (parameters, unknowns).

        There are no rows unless steps are differentiated.
        """
        if self._tangent_linear is None:
            none: Array = self._problem.model.field.x.array[None][:0]
            return none
        return self._tangent_linear.state

    def start_from(self, guess: Callable[[float], Array | None]) -> None:
        """Start the solve of steps at a guess instead of the extrapolated state.

        Args:
            guess: Returns the state at the end of a step (unknowns with ghosts, m) from its
                time (s), or None where it has none.
        """
        self._state.initial_guess = guess

    def start_at(self, state: Array) -> None:
        """Let the program start from another state than that of reference.

        Prescribed displacements, work and dissipated energy count from there. Friction carries
        nothing there.

        Args:
            state: Unknowns with ghosts, m.
        """
        self._problem.constraints.origin[:] = state
        self._state.states = [state.copy() for _ in self._state.states]

    def differentiate(self, targets: Sequence[Target], **more: bool) -> None:
        """Give each step its derivatives by parameters, from the start on; collective.

        Args:
            targets: The parameters.
            more: Of :class:`~wovenfab.stepping.sensitivity.TangentLinear`.

        Raises:
            TargetError: If the scene has no such parameter.
        """
        self.destroy()
        self._tangent_linear = TangentLinear(self._solver, self._scheme, targets, **more)

    def destroy(self) -> None:
        """Free the vectors of the derivatives, which end with it; collective."""
        if self._tangent_linear is not None:
            self._tangent_linear.destroy()
            self._tangent_linear = None

    def control_force(self) -> None:
        """Find the displacement from the force where the program is a force; collective."""
        self._state.force_control = ForceControl(self._solver, self._stability.refuses)

    def steps(self) -> Iterator[Step]:
        """Yield the initial state and then each accepted step.

        Raises:
            StepFailedError: If a step cannot be made; the field is the last accepted.
            StabilityLostError: If no minimum lies beyond it.
        """
        if not self.begun:
            yield self._begin()
        for start, end in pairwise(self._program.milestones):
            yield from self._reach(start, end)

    def snapshot(self) -> dict[str, Any]:
        """Return what later steps depend on."""
        error = self._time_error
        return {
            "state": self._state.snapshot(),
            "balance": self._balance.snapshot(),
            "step_size": self._step_size.snapshot(),
            "time_error": error.snapshot() if error else None,
            "solver": self._solver.snapshot(),
            "jump": self._jump,
            "origin": self._problem.constraints.origin,
        }

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on from a snapshot: steps begin after it; collective.

        Step size and errors in time begin anew where another control of the error is used.
        """
        self._problem.constraints.origin[:] = snapshot["origin"]
        self._solver.resume(snapshot["solver"])
        self._state.resume(snapshot["state"])
        self._balance.resume(snapshot["balance"])
        if (snapshot["time_error"] is not None) == self.measures_errors:
            self._step_size.resume(snapshot["step_size"])
        if self._time_error and snapshot["time_error"]:
            self._time_error.resume(snapshot["time_error"])
        self.begun, self._jump = True, snapshot["jump"]

    def restore(self) -> None:
        """Go back to the last accepted state from within a step."""
        self._state.restore()

    def _begin(self) -> Step:
        """Bring the sheet to rest under the program's first value."""
        first = self._program.milestones[0]
        self._state.restore()
        result, self._cutbacks = equilibrate(
            self._solver, self._state.displacement, self._smallest, self._stability.refuses
        )
        self._state.begin()
        if result is not None:
            self._balance.begin()
        self._note_change()
        if self._tangent_linear:
            virtual = self._virtual_displacement(self._state.displacement)
            self._tangent_linear.begin(result is None, virtual)
        step, self.begun, self._cutbacks = self._record(result, first), True, 0
        return step

    def _reach(self, start: Milestone, end: Milestone) -> Iterator[Step]:
        """Step from one planned time to the next, in shorter steps where needed."""
        state, step_size = self._state, self._step_size
        planned = end.time - start.time
        if state.time == start.time:
            self._jump = start.jump
            if self._time_error is not None and (self._jump or not state.number):
                step_size.limit(self._time_error.first(self._jump) * planned)
        while state.time < end.time:
            until = step_size.next(state.time, end.time)
            length, jump = until - state.time, self._jump
            result = state.attempt(until, jump)
            if not state.number:
                self._check_rest(until, result)
            result = self._beyond_saddle(until, planned, result)
            saddle = self._stability.refuses(result)
            if result.converged and not saddle:
                error = self._estimate_error(until, jump)
                if self._is_too_long(error, length, planned):
                    assert error is not None
                    logger.info(
                        "t = %.6g s: step of %.3g s repeated with a shorter length: its error in "
                        "time is %.2g", state.time, length, error.relative,
                    )  # fmt: skip
                    self._cutbacks += 1
                    state.restore()
                    continue
                if self._tangent_linear:
                    virtual = self._virtual_displacement(state.reached)
                    self._tangent_linear.solve(length, jump, virtual)
                self._balance.add(state, until, jump, error)
                if self._tangent_linear:
                    self._tangent_linear.finish()
                state.accept(until, jump)
                self._note_change()
                if self._time_error is None:
                    step_size.accepted(length, result.iterations)
                loss = self._stability.passed()
                if loss is not None:
                    logger.info("%s; the branch is followed", loss)
                    state.forget_visited()
                    step_size.bracketed(length)
                self._jump = loss is not None
                step = self._record(result, end if until == end.time else None, loss)
                self._cutbacks = 0
                yield step
                continue
            self._cutbacks += 1
            logger.info(
                "t = %.6g s: step of %.3g s rejected: %s after %d iterations, residual %.3g N, "
                "%d negative eigenvalues", state.time, length, result.reason, result.iterations,
                result.residual, result.negatives,
            )  # fmt: skip
            if self._stability.loss is not None:  # try farther beyond it, if that is wanted
                state.restore()
                if until == end.time or not self._stability.follows:
                    raise self._stability.error(self._cutbacks)
                step_size.grow(length)
                continue
            if saddle:
                step_size.bisect(until, length)
            elif not step_size.reduce(length, planned):
                self._check_limit_point(until)
                diagnosis = diagnose(self._solver, result, state.states[0])
                second = self._program.second(until)
                raise StepFailedError(
                    until, state.reached, length, result, self._cutbacks, diagnosis, second
                )
            state.restore()

    def _estimate_error(self, until: float, jump: bool) -> StepError | None:
        """Return the error of the step that was just solved, where enough states are there."""
        state = self._state
        if self._time_error is None or jump:
            return None
        steps = [until - state.time, *state.steps]
        virtual = self._virtual_displacement(state.reached)
        return self._time_error.measure(state.states, steps, virtual)

    def _is_too_long(self, error: StepError | None, length: float, planned: float) -> bool:
        """Set the length of the next step, and return whether this one must be repeated."""
        if self._time_error is None or error is None:
            return False
        best = length * self._time_error.growth(error, [length, *self._state.steps])
        self._step_size.limit(best)
        return self._time_error.refuses(error) and best >= self._smallest * planned

    def _check_rest(self, until: float, result: SolveResult) -> None:
        """Refuse a penalty that makes the sheet at rest unstable, whatever the solve gave."""
        if self._problem.model.balance.penalty is None:
            return
        field = self._problem.model.field
        with preserved(field):
            field.x.array[:] = self._state.states[0]
            fault = unsound_penalty(self._solver)
        if fault:
            self._state.restore()
            step = until - self._state.time
            raise UnsoundSheetError(until, self._state.reached, step, result, 0, fault)

    def _note_change(self) -> None:
        """Note where the program changes from displacements to forces or back."""
        state, control = self._state, self._state.force_control
        if control is not None and state.time in self._program.changes:
            force = self._program.changes[state.time]
            conjugate, _ = self._conjugate_force()
            state.before = conjugate if force else state.displacement

    def _check_limit_point(self, until: float) -> None:
        """Refuse a force beyond a limit point."""
        state, control = self._state, self._state.force_control
        if control is None or control.beyond is None:
            return
        beyond, reactions = control.beyond, self._problem.constraints.reactions
        loss = StabilityLoss(
            state.time, state.displacement, until - state.time,
            beyond.displacement - state.displacement, reactions(self._balance.forces.force),
            self._conjugate_force()[0], negatives=1, saddle=beyond.field, mode=beyond.mode,
            second=self._program.second(state.time),
        )  # fmt: skip
        remedy = "it carries no larger force (limit point); prescribe the displacement beyond"
        state.restore()
        raise StabilityLostError(loss, remedy, self._cutbacks)

    def _beyond_saddle(self, until: float, planned: float, result: SolveResult) -> SolveResult:
        """Return the result, or that of the branch from a saddle next to the last minimum."""
        state, force = self._state, self._balance.forces.force
        share = (until - state.time) / planned
        if not self._stability.refuses(result) or not self._stability.is_close(
            force, share, self._smallest
        ):
            return result
        now, then = (state.time, state.displacement), (until, state.reached)
        conjugate, _ = self._conjugate_force()
        second = self._program.second(state.time)
        return self._stability.leave(now, then, force, conjugate, result, second)

    def _conjugate_force(self) -> tuple[float, float]:
        """Return the force (N) conjugate to the program, and that across it, of the last state."""
        virtual = self._virtual_displacement(self._state.displacement)
        return self._problem.constraints.conjugate(self._balance.forces.force, virtual)

    def _virtual_displacement(self, program: float) -> Array:
        """Return the displacements (1) on which the work of reactions is the recorded force."""
        load = self._problem.model.loading.force()
        return self._problem.constraints.virtual_displacement(program, load)

    def _record(
        self,
        result: SolveResult | None,
        milestone: Milestone | None,
        loss: StabilityLoss | None = None,
    ) -> Step:
        balance = self._balance
        along, across = self._conjugate_force()
        return Step(
            number=self._state.number,
            time=self._state.time,
            displacement=self._state.displacement,
            second=self._state.second,
            reactions=self._problem.constraints.reactions(balance.forces.force),
            force=along,
            force_transverse=across,
            force_error=balance.error.force if balance.error else 0.0,
            stored=self._problem.model.stored_energy() if self.measures_energy else {},
            dissipated=dict(balance.dissipated),
            work=balance.work,
            iterations=result.iterations if result else 0,
            cutbacks=self._cutbacks,
            milestone=milestone,
            negatives=result.negatives if result else 0,
            loss=loss,
            error=balance.error,
            derivatives=self._tangent_linear.derivatives if self._tangent_linear else None,
            dissipated_error=balance.dissipated_error,
        )
