"""The state in which a program begins: at rest under what is there from the start.

The states that a march has passed, and the one that it looks for next.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.model.constraints import Constraints
from wovenfab.model.model import Model
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.options import SolveResult
from wovenfab.stepping.program import Program
from wovenfab.stepping.schemes import Scheme, end_weights, extrapolation
from wovenfab.stepping.step import StartFailedError


def prescribe(model: Model, constraints: Constraints, program: float, share: float = 1.0) -> None:
    """Prescribe placements and dead loads for a program value (m), or a share of them."""
    constraints.set(program, share)
    model.loading.set(program, share)


def equilibrate(
    model: Model,
    constraints: Constraints,
    equilibrium: EquilibriumSolver,
    program: float,
    smallest: float,
    refuses: Callable[[SolveResult], bool],
) -> tuple[SolveResult | None, int]:
    """Bring a model from its reference state to rest under a program value; collective.

    Friction carries nothing at rest and is left out, so that none is lost on the way,
    which is gone in one step or, where that fails, in smaller ones.

    Args:
        model: The model in its reference state.
        constraints: Its prescribed placements.
        equilibrium: Its solver.
        program: The program's first value, m.
        smallest: Share of what is prescribed below which stepping ends.
        refuses: Whether an equilibrium must not be taken, since it is no minimum.

    Returns:
        How it was found, with all iterations and tangents, or None where nothing acts; and the
        number of rejected attempts.

    Raises:
        StartFailedError: If there is no such state; the model is as it was at the last
            share that could be reached.
    """
    prescribe(model, constraints, program)
    loaded = model.comm.allreduce(bool(model.loading.force().any()), op=MPI.LOR)
    if not loaded and not constraints.unmet(model.field):
        return None, 0
    field = model.field.x.array
    share, step, iterations, tangents, rejected = 0.0, 1.0, 0, 0, 0
    model.friction.value = 0.0
    try:
        while share < 1:
            reached = field.copy()
            model.last.x.array[:] = reached
            prescribe(model, constraints, program, share + step)
            outcome = equilibrium.solve()
            if outcome.converged and not refuses(outcome):
                share += step
                iterations += outcome.iterations
                tangents += outcome.tangents
                continue
            field[:] = reached
            rejected += 1
            if step / 2 < smallest:
                raise StartFailedError(0.0, program, step, outcome, rejected)
            step /= 2
    finally:
        model.friction.value = 1.0
    return replace(outcome, iterations=iterations, tangents=tangents), rejected


Array = NDArray[np.float64]
#: Accepted states that are kept: as many as an error in time needs.
KEPT = 4
#: Steps of the last length over which the motion is extrapolated at all.
FARTHEST_AHEAD = 4.0


class State:
    """The motion of a model so far, and attempts at its next state.

    Attributes:
        time: Of the last accepted state, s.
        number: Of accepted steps.
        states: Accepted states, latest first, m.
        steps: Times between them since the velocity last jumped, s.
    """

    def __init__(
        self,
        model: Model,
        constraints: Constraints,
        equilibrium: EquilibriumSolver,
        program: Program,
        scheme: Scheme,
        predict: bool,
    ) -> None:
        """Be at the reference state.

        Args:
            model: The compiled model.
            constraints: Its prescribed placements.
            equilibrium: Its solver.
            program: The load program.
            scheme: The time scheme.
            predict: Start a step from the extrapolated motion, not from the last state.
        """
        self._model, self._constraints, self._equilibrium = model, constraints, equilibrium
        self._program, self._scheme, self._predicts = program, scheme, predict
        self._guess: Callable[[float], Array | None] = lambda time: None
        self.time, self.number = 0.0, 0
        self.states: list[Array] = [np.zeros(model.field.x.array.size) for _ in range(KEPT)]
        self.steps: list[float] = []

    def begin_near(self, guess: Callable[[float], Array | None]) -> None:
        """Begin attempts from a guess where one is known (see ``March.begin_near``)."""
        self._guess = guess

    def begin(self) -> None:
        """Take the present state as the one that the model has always been in."""
        self.states = [self._model.field.x.array.copy() for _ in self.states]

    def attempt(self, until: float, jump: bool) -> SolveResult:
        """Solve for the stage state of a step; collective.

        Args:
            until: Time at its end, s.
            jump: The velocity jumps at its start.
        """
        model, scheme = self._model, self._scheme
        step = until - self.time
        start, end = (self._program.displacement(t) for t in (self.time, until))
        prescribe(model, self._constraints, start + scheme.stage * (end - start))
        if model.rate_weights:
            self._set_rate(scheme.weights(step, self._step_before(step, jump)))
        model.last.x.array[:] = self.states[0]
        self._predict(until, scheme.stage * step, jump)
        return self._equilibrium.solve()

    def finish(self, until: float, jump: bool) -> Array:
        """Go from the stage state on to the end of its step; return the change in it, m.

        Args:
            until: Time at its end, s.
            jump: The velocity jumped at its start.
        """
        model, scheme, field = self._model, self._scheme, self._model.field.x.array
        change = np.asarray((field - self.states[0]) / scheme.stage)
        if scheme.stage < 1:
            step = until - self.time
            field[:] = self.states[0] + change
            if model.rate_weights:
                self._set_rate(end_weights(step, self._step_before(step, jump) or step))
            model.loading.set(self._program.displacement(until))
        return change

    def accept(self, until: float, jump: bool) -> None:
        """Take the present state as that at the end of a step.

        Args:
            until: Time at its end, s.
            jump: The velocity jumped at its start.
        """
        self._equilibrium.keep()
        self.states = [self._model.field.x.array.copy(), *self.states[: KEPT - 1]]
        self.steps = [until - self.time, *([] if jump else self.steps[: KEPT - 2])]
        self.time = until
        self.number += 1

    def restore(self) -> None:
        """Go back to the last accepted state."""
        self._model.field.x.array[:] = self.states[0]
        self._equilibrium.restore()

    def _step_before(self, step: float, jump: bool) -> float | None:
        """Return the length of the last step; at rest before the start, so as if equal."""
        if jump:
            return None
        return self.steps[0] if self.steps else step

    def _set_rate(self, weights: tuple[float, ...]) -> None:
        for constant, weight in zip(self._model.rate_weights, weights, strict=True):
            constant.value = weight
        for field, state in zip(self._model.history, self.states, strict=False):
            field.x.array[:] = state

    def _predict(self, until: float, ahead: float, jump: bool) -> None:
        """Start from a guess or the extrapolated motion, unless that would cross the families."""
        field, step = self._model.field, self._equilibrium.barrier.step
        field.x.array[:] = self.states[0]
        far = jump or not self.steps or ahead > FARTHEST_AHEAD * self.steps[0]
        if (guess := self._guess(until)) is not None:
            step.x.array[:] = self._scheme.stage * (guess - self.states[0])
        elif far or not self._predicts:
            return
        else:
            step.x.array[:] = extrapolation(self.states, self.steps, ahead)
        if self._equilibrium.barrier.limit() > 2.0:
            field.x.array[:] += step.x.array
