"""From one equilibrium to the next, with cut-backs where a step does not converge."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from wovenfab.model.constraints import Constraints
from wovenfab.model.model import Model
from wovenfab.solver.controls import Outcome
from wovenfab.solver.diagnosis import diagnose, unsound_penalty
from wovenfab.solver.equilibrium import Equilibrium
from wovenfab.stepping.embedded import Embedded, StepError, rate_error
from wovenfab.stepping.failure import StepFailedError, UnsoundSheetError
from wovenfab.stepping.forces import Forces
from wovenfab.stepping.pace import Pace
from wovenfab.stepping.program import Milestone, Program
from wovenfab.stepping.scheme import Scheme, end_weights, extrapolation
from wovenfab.stepping.stability import Loss, Stability, Treatment
from wovenfab.stepping.start import prescribe, settle

#: Steps of the last length over which the motion is extrapolated at all.
FARTHEST_AHEAD = 4.0


@dataclass(frozen=True)
class Step:
    """An accepted step.

    Attributes:
        number: 0 for the initial state.
        time, displacement: At its end, s and m.
        reactions: Force (N; x, y) that each held edge exerts on the sheet.
        stored: Stored energy (J) by effect.
        dissipated: Energy dissipated since the start (J) by effect.
        work: External work since the start, J.
        iterations: Newton iterations, those of rejected attempts not counted.
        cutbacks: Rejected attempts before it since the last accepted step.
        milestone: The planned time that it reaches, or None on the way to it.
        negatives: Negative eigenvalues of the tangent; none where the state is a minimum.
        loss: The loss of stability since the last step, beyond which it lies, or None.
        error: Its estimated error in time, where that is measured.
        dissipated_error: Of all dissipated energy since the start by the errors of steps, J.
    """

    number: int
    time: float
    displacement: float
    reactions: dict[str, tuple[float, float]]
    stored: dict[str, float]
    dissipated: dict[str, float]
    work: float
    iterations: int
    cutbacks: int
    milestone: Milestone | None
    negatives: int = 0
    loss: Loss | None = None
    error: StepError | None = None
    dissipated_error: float = 0.0


class March:
    """Marches a model through a load program."""

    def __init__(
        self,
        model: Model,
        constraints: Constraints,
        equilibrium: Equilibrium,
        program: Program,
        scheme: Scheme,
        smallest_step: float,
        treatment: Treatment = "stop",
        predict: bool = True,
        pace: Callable[[float], Pace] = Pace,
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
        self._model = model
        self._constraints = constraints
        self._equilibrium = equilibrium
        self._program = program
        self._scheme = scheme
        self._smallest = smallest_step
        self._pace = pace(smallest_step)
        self._predicts = predict
        self._embedded: Embedded | None = None
        if tolerance and scheme.name == "bdf2" and model.history:
            self._embedded = Embedded(model, constraints, equilibrium, tolerance)
        self._error: StepError | None = None
        self._dissipated_error = 0.0
        own = model.placements.owned
        self._stability = Stability(model, constraints, equilibrium, treatment)
        size = model.field.x.array.size
        self._own = own
        # Accepted states, latest first, and the steps between them (s).
        self._states = [np.zeros(size) for _ in range(4)]
        self._steps: list[float] = []
        self._time = 0.0
        self._number = 0
        self._cutbacks = 0
        self._work = 0.0
        self._dissipated = {e.name: 0.0 for e in model.effects if e.dissipative}
        nothing = dict.fromkeys(self._dissipated, 0.0)
        self._before = Forces(np.zeros(own), np.zeros(own), nothing)

    @property
    def started(self) -> bool:
        """Whether a step has been accepted."""
        return self._number > 0

    @property
    def measures_errors(self) -> bool:
        """Whether the error of steps in time is measured."""
        return self._embedded is not None

    def steps(self) -> Iterator[Step]:
        """Yield the initial state and then each accepted step.

        Raises:
            StepFailedError: If a step cannot be made; the field is the last accepted.
            StabilityLostError: If no minimum lies beyond it.
        """
        first = self._program.milestones[0]
        self._restore()
        outcome, self._cutbacks = settle(
            self._model, self._constraints, self._equilibrium, first.displacement, self._smallest,
            self._stability.refuses,
        )  # fmt: skip
        self._states = [self._model.field.x.array.copy() for _ in self._states]
        if outcome is not None:
            force, load = self._equilibrium.force, self._model.loading.force()
            self._before = replace(self._before, force=force, load=load)
        yield self._record(outcome, first)
        self._cutbacks = 0
        for start, end in zip(self._program.milestones, self._program.milestones[1:], strict=False):
            yield from self._reach(start, end)

    def _reach(self, start: Milestone, end: Milestone) -> Iterator[Step]:
        """Step from one planned time to the next, in shorter steps where needed."""
        jump = start.jump
        planned = end.time - start.time
        if self._embedded is not None and (jump or not self._number):
            self._pace.aim(self._embedded.first(jump) * planned)
        while self._time < end.time:
            until = self._pace.next(self._time, end.time)
            length = until - self._time
            outcome = self._attempt(until, jump)
            if not self._number:
                self._check_rest(until, outcome)
            outcome = self._settled(until, planned, outcome)
            refused = self._stability.refuses(outcome)
            if outcome.converged and not refused:
                error = self._measure(until, jump)
                if self._is_too_long(error, length, planned):
                    self._cutbacks += 1
                    self._restore()
                    continue
                self._accept(until, jump, error)
                if self._embedded is None:
                    self._pace.made(length, outcome.iterations)
                loss = self._stability.passed()
                if loss is not None:
                    self._pace.found(length)
                jump = loss is not None
                yield self._record(outcome, end if until == end.time else None, loss)
                self._cutbacks = 0
                continue
            self._cutbacks += 1
            if self._stability.loss is not None:  # try farther beyond it, if that is wanted
                self._restore()
                if until == end.time or not self._stability.follows:
                    raise self._stability.give_up(self._cutbacks)
                self._pace.lengthen(length)
                continue
            if refused:
                self._pace.bisect(until, length)
            elif not self._pace.cut(length, planned):
                found = diagnose(self._model, self._equilibrium, outcome, self._states[0])
                displacement = self._program.displacement(until)
                raise StepFailedError(until, displacement, length, outcome, self._cutbacks, found)
            self._restore()

    def _measure(self, until: float, jump: bool) -> StepError | None:
        """Return the error of the step that was just solved, where enough is known."""
        if self._embedded is None or jump or len(self._steps) < 2:
            return None
        step = until - self._time
        wrong = rate_error(self._model.field.x.array, self._states, self._steps, step)
        return self._embedded.measure(wrong, self._scheme.weights(step, self._steps[0]))

    def _is_too_long(self, error: StepError | None, length: float, planned: float) -> bool:
        """Set the length of the next step, and return whether it is this one made again."""
        if self._embedded is None or error is None:
            return False
        best = length * self._embedded.growth(error)
        self._pace.aim(best)
        return self._embedded.refuses(error) and best >= self._smallest * planned

    def _check_rest(self, until: float, outcome: Outcome) -> None:
        """Refuse a penalty that makes the sheet at rest unstable, whatever was found."""
        reached = self._model.field.x.array.copy()
        self._model.field.x.array[:] = self._states[0]
        if fault := unsound_penalty(self._model, self._equilibrium):
            displacement = self._program.displacement(until)
            step = until - self._time
            raise UnsoundSheetError(until, displacement, step, outcome, 0, fault)
        self._model.field.x.array[:] = reached

    def _settled(self, until: float, planned: float, outcome: Outcome) -> Outcome:
        """Return the outcome, or how a saddle was left that is next to the last minimum."""
        share, force = (until - self._time) / planned, self._before.force
        if not self._stability.refuses(outcome) or not self._stability.is_close(
            force, share, self._smallest
        ):
            return outcome
        now, then = ((t, self._program.displacement(t)) for t in (self._time, until))
        return self._stability.leave(now, then, force, outcome)

    def _attempt(self, until: float, jump: bool) -> Outcome:
        """Solve for the stage state of a step that ends at ``until``."""
        model, scheme = self._model, self._scheme
        step = until - self._time
        start, end = (self._program.displacement(t) for t in (self._time, until))
        prescribe(model, self._constraints, start + scheme.stage * (end - start))
        if model.rate_weights:
            self._set_rate(scheme.weights(step, self._step_before(step, jump)))
        model.last.x.array[:] = self._states[0]
        self._predict(scheme.stage * step, jump)
        return self._equilibrium.solve()

    def _step_before(self, step: float, jump: bool) -> float | None:
        """Return the length of the last step; at rest before the start, so as if equal."""
        if jump:
            return None
        return self._steps[0] if self._steps else step

    def _set_rate(self, weights: tuple[float, ...]) -> None:
        for constant, weight in zip(self._model.rate_weights, weights, strict=True):
            constant.value = weight
        for field, state in zip(self._model.history, self._states, strict=False):
            field.x.array[:] = state

    def _predict(self, ahead: float, jump: bool) -> None:
        """Start from the extrapolated motion, unless that would cross the families."""
        field, step = self._model.field, self._equilibrium.barrier.step
        field.x.array[:] = self._states[0]
        if not self._predicts or jump or not self._steps or ahead > FARTHEST_AHEAD * self._steps[0]:
            return
        step.x.array[:] = extrapolation(self._states, self._steps, ahead)
        if self._equilibrium.barrier.limit() > 2.0:
            field.x.array[:] += step.x.array

    def _restore(self) -> None:
        self._model.field.x.array[:] = self._states[0]
        self._equilibrium.restore()

    def _accept(self, until: float, jump: bool, error: StepError | None) -> None:
        """Take the converged stage state; account work and dissipation."""
        model, scheme = self._model, self._scheme
        step = until - self._time
        field = model.field.x.array
        plastic = self._equilibrium.plastic_force()
        lost, loads = model.dissipated_power(), model.loading.force()
        stage = Forces(self._equilibrium.force, loads, lost, plastic)
        increment = (field - self._states[0]) / scheme.stage
        for name, energy in model.dissipated_energy().items():
            self._dissipated[name] += energy / scheme.stage
        if scheme.stage < 1:
            field[:] = self._states[0] + increment
            if model.rate_weights:
                self._set_rate(end_weights(step, self._step_before(step, jump) or step))
            model.loading.set(self._program.displacement(until))
            now = Forces(self._equilibrium.evaluate_force(), model.loading.force(), stage.power)
            mean = stage
        else:
            now = stage
            mean = self._mean_after_jump(now) if jump else self._before.mean(now)
        moved = increment[: self._own]
        self._work += self._constraints.work(mean.force, moved)
        self._work += float(model.comm.allreduce(mean.load @ moved))
        for name, power in mean.power.items():
            self._dissipated[name] += step * power
        self._equilibrium.keep()
        errors = [e.power if e else 0.0 for e in (self._error, error)]
        self._dissipated_error += step * sum(errors) / 2
        self._before, self._error = now, error
        self._states = [field.copy(), *self._states[:3]]
        self._steps = [step, *([] if jump else self._steps[:2])]
        self._time = until
        self._number += 1

    def _mean_after_jump(self, now: Forces) -> Forces:
        """Return the mean of a step whose velocity jumped at its start.

        Friction jumps with it to what it is at the end; all else is continuous.
        """
        model, mean = self._model, self._before.mean(now)
        if not model.rate_weights:
            return mean
        field, end = model.field.x.array, model.field.x.array.copy()
        model.friction.value = 0.0
        after = self._equilibrium.evaluate_force()
        field[:] = self._states[0]
        before = self._equilibrium.evaluate_force()
        field[:], model.friction.value = end, 1.0
        loads = now.load - self._before.load  # after and before have the same ones
        return replace(mean, force=now.force + (before - after + loads) / 2, power=now.power)

    def _record(
        self, outcome: Outcome | None, milestone: Milestone | None, loss: Loss | None = None
    ) -> Step:
        return Step(
            number=self._number,
            time=self._time,
            displacement=self._program.displacement(self._time),
            reactions=self._constraints.reactions(self._before.force),
            stored=self._model.stored_energy(),
            dissipated=dict(self._dissipated),
            work=self._work,
            iterations=outcome.iterations if outcome else 0,
            cutbacks=self._cutbacks,
            milestone=milestone,
            negatives=outcome.negatives if outcome else 0,
            loss=loss,
            error=self._error,
            dissipated_error=self._dissipated_error,
        )
