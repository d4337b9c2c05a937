"""From one equilibrium to the next, with cut-backs where a step does not converge."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.model.constraints import Constraints
from wovenfab.model.model import Model
from wovenfab.solver.equilibrium import Equilibrium, Outcome
from wovenfab.stepping.program import Milestone, Program
from wovenfab.stepping.scheme import Scheme, end_weights
from wovenfab.stepping.stability import Loss, Stability, Treatment

#: Steps of the last length over which the motion is extrapolated, by a parabola and at all.
FAR_AHEAD, FARTHEST_AHEAD = 1.5, 4.0


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


class StepFailedError(Exception):
    """No equilibrium even for the smallest step; the last state has been restored.

    Attributes:
        time: Time that was not reached, s.
        displacement: Displacement that was not reached, m.
        step: Length of the smallest step tried, s.
        outcome: How the last attempt ended.
        cutbacks: Rejected attempts since the last accepted step.
    """

    def __init__(
        self, time: float, displacement: float, step: float, outcome: Outcome, cutbacks: int
    ) -> None:
        """Say where and why."""
        super().__init__(
            f"no equilibrium at t = {time:.6g} s (displacement {1e3 * displacement:.6g} mm) even "
            f"with a step of {step:.3g} s: {outcome.reason} after {outcome.iterations} iterations, "
            f"residual {outcome.residual:.3g} N"
        )
        self.time, self.displacement, self.step = time, displacement, step
        self.outcome, self.cutbacks = outcome, cutbacks


@dataclass(frozen=True)
class _Balance:
    """Forces and powers at one time, kept for the next step's trapezoid."""

    force: NDArray[np.float64]
    power: dict[str, float]


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
        """
        self._model = model
        self._constraints = constraints
        self._equilibrium = equilibrium
        self._program = program
        self._scheme = scheme
        self._smallest = smallest_step
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
        self._before = _Balance(np.zeros(own), dict.fromkeys(self._dissipated, 0.0))

    @property
    def started(self) -> bool:
        """Whether a step has been accepted."""
        return self._number > 0

    def steps(self) -> Iterator[Step]:
        """Yield the initial state and then each accepted step.

        Raises:
            StepFailedError: If a step cannot be made; the field is the last accepted.
            StabilityLostError: If no minimum lies beyond it.
        """
        first = self._program.milestones[0]
        self._constraints.set(first.displacement)
        yield self._record(None, first)
        for start, end in zip(self._program.milestones, self._program.milestones[1:], strict=False):
            yield from self._reach(start, end)

    def _reach(self, start: Milestone, end: Milestone) -> Iterator[Step]:
        """Step from one planned time to the next, halving where needed."""
        jump = start.jump
        pending = [(end.time, end)]
        planned = end.time - start.time
        while pending:
            until, milestone = pending[-1]
            outcome = self._settled(until, planned, self._attempt(until, jump))
            refused = self._stability.refuses(outcome)
            if outcome.converged and not refused:
                pending.pop()
                self._accept(until, jump)
                loss = self._stability.passed()
                jump = loss is not None
                yield self._record(outcome, milestone, loss)
                self._cutbacks = 0
                continue
            self._restore()
            self._cutbacks += 1
            if self._stability.loss is not None:  # try farther beyond it, if that is wanted
                pending.pop()
                if not pending or not self._stability.follows:
                    raise self._stability.give_up(self._cutbacks)
                continue
            half = (until - self._time) / 2
            if half < self._smallest * planned and not refused:
                end_of_step, step = self._program.displacement(until), until - self._time
                raise StepFailedError(until, end_of_step, step, outcome, self._cutbacks)
            pending.append((self._time + half, None))  # type: ignore[arg-type]

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
        self._constraints.set(start + scheme.stage * (end - start))
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
        if jump or not self._steps or ahead > FARTHEST_AHEAD * self._steps[0]:
            return
        step.x.array[:] = _extrapolation(self._states, self._steps, ahead)
        if self._equilibrium.barrier.limit() > 2.0:
            field.x.array[:] += step.x.array

    def _restore(self) -> None:
        self._model.field.x.array[:] = self._states[0]

    def _accept(self, until: float, jump: bool) -> None:
        """Take the converged stage state; account work and dissipation."""
        model, scheme = self._model, self._scheme
        step = until - self._time
        field = model.field.x.array
        stage = _Balance(self._equilibrium.force, model.dissipated_power())
        increment = (field - self._states[0]) / scheme.stage
        if scheme.stage < 1:
            field[:] = self._states[0] + increment
            if model.rate_weights:
                self._set_rate(end_weights(step, self._step_before(step, jump) or step))
            now = _Balance(self._equilibrium.evaluate_force(), stage.power)
            mean = stage
        else:
            now = stage
            mean = now if jump else _mean(self._before, now)
        self._work += self._constraints.work(mean.force, increment[: self._own])
        for name, power in mean.power.items():
            self._dissipated[name] += step * power
        self._before = now
        self._states = [field.copy(), *self._states[:3]]
        self._steps = [step, *([] if jump else self._steps[:2])]
        self._time = until
        self._number += 1

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
            work=self._work + self._model.load_work(),
            iterations=outcome.iterations if outcome else 0,
            cutbacks=self._cutbacks,
            milestone=milestone,
            negatives=outcome.negatives if outcome else 0,
            loss=loss,
        )


def _mean(a: _Balance, b: _Balance) -> _Balance:
    """Return the mean of two times: the trapezoidal rule, second order."""
    return _Balance(
        (a.force + b.force) / 2, {name: (a.power[name] + b.power[name]) / 2 for name in b.power}
    )


def _extrapolation(states: list[Any], steps: list[float], ahead: float) -> NDArray[np.float64]:
    """Return the change over ``ahead`` (s) of the polynomial through the last states.

    Linear through two states, quadratic through three (Newton's divided differences)
    where that is not far.
    """
    slope = (states[0] - states[1]) / steps[0]
    change = ahead * slope
    if len(steps) > 1 and ahead <= FAR_AHEAD * steps[0]:
        earlier = (states[1] - states[2]) / steps[1]
        change = change + ahead * (ahead + steps[0]) * (slope - earlier) / (steps[0] + steps[1])
    return np.asarray(change)
