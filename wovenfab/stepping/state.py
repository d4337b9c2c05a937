"""The accepted states of a problem, the initial one, and attempts at the next one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.model.memory import attributes, take_attributes
from wovenfab.model.model import preserved
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.problem import SolveResult
from wovenfab.stepping.program import SAME, Program
from wovenfab.stepping.schemes import Scheme, extrapolation
from wovenfab.stepping.step import StartFailedError

if TYPE_CHECKING:
    from wovenfab.stepping.force_control import ForceControl

Array = NDArray[np.float64]
#: Accepted states that are kept: as many as the error estimate in time needs.
KEPT = 4
#: Steps of the last length over which the state is extrapolated at all.
FARTHEST_AHEAD = 4.0
#: Largest number of states that are kept for the way back.
VISITED = 16
#: Distance from the linearly extrapolated state, over the change in a step, from which the step
#: counts as a snap. In bias extension it is far below, in a snap about one.
SNAP = 0.3
#: What a later step depends on.
MEMORY = "time", "number", "states", "steps", "at_rest", "displacements", "before"
VARIABLES = "variables"


class State:
    """Accepted states of a problem, and attempts at the next one.

    Attributes:
        time: Of the last accepted state, s.
        number: Of accepted steps.
        states: Accepted states, latest first, m.
        steps: Times between them since the velocity last jumped, s.
        displacements: Displacements of the program in them, m.
        reached: That at the end of the step that is attempted, m.
        before: Displacement (m) or force (N) when the program last changed between the two.
        force_control: Finds the displacement where the program prescribes a force.
        at_rest: Whether the motion began smoothly from rest and its velocity never jumped.
    """

    def __init__(
        self, solver: EquilibriumSolver, program: Program, scheme: Scheme, predict: bool
    ) -> None:
        """Start at the reference state.

        Args:
            solver: Solver of the problem.
            program: The load program.
            scheme: The time scheme.
            predict: Start a step from the extrapolated state, not from the last one.
        """
        self._solver, self._model = solver, solver.problem.model
        self._program, self._scheme, self._predicts = program, scheme, predict
        # Both displacements (m) of states and these, where nothing depends on the past; else None.
        has_history = bool(self._model.history or self._model.memory)
        self._visited: list[tuple[float, float, Array]] | None = None if has_history else []
        self._memory = self._model.memory
        self._model.stage.value = scheme.stage
        if self._memory:
            self._memory.start()
        self.initial_guess: Callable[[float], Array | None] = lambda time: None
        self._misled = -inf  # time at which the guess has led to no solution, s
        self._ahead = 0.0  # from the last state to the stage of the step, s; 0 after a jump
        self.time, self.number = 0.0, 0
        self.states: list[Array] = [np.zeros(self._model.field.x.array.size) for _ in range(KEPT)]
        self.steps: list[float] = []
        self.at_rest = True
        first = program.milestones[0]
        start = 0.0 if program.prescribes_force(first.time) else first.value
        self.displacements = [start] * KEPT
        self.reached, self.before = start, 0.0
        self.force_control: ForceControl | None = None

    @property
    def displacement(self) -> float:
        """Displacement of the program in the last accepted state, m."""
        return self.displacements[0]

    @property
    def second(self) -> float:
        """Displacement of the second program in the last accepted state, m."""
        return self._program.second(self.time)

    def begin(self) -> None:
        """Take the present state as that at all earlier times, too."""
        self.states = [self._model.field.x.array.copy() for _ in self.states]
        self._keep_visited()

    def snapshot(self) -> dict[str, Any]:
        """Return the accepted states and when they were, and internal variables."""
        variables = self._memory.snapshot() if self._memory else {}
        return {**attributes(self, *MEMORY, "_visited"), VARIABLES: variables}

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on from the states of a snapshot."""
        take_attributes(self, snapshot, *MEMORY)
        if self._visited is not None:
            self._visited = [(d, s, state) for d, s, state in snapshot.get("visited", [])]
        if self._memory:
            self._memory.resume(snapshot[VARIABLES])
        self._model.field.x.array[:] = self.states[0]

    def attempt(self, until: float, jump: bool) -> SolveResult:
        """Solve for the stage state of a step; collective.

        Args:
            until: Time at its end, s.
            jump: The velocity jumps at its start.
        """
        program, step, stage = self._program, until - self.time, self._scheme.stage
        second = self.second
        self._solver.problem.prescribe_second(second + stage * (program.second(until) - second))
        if self._model.rate_weights:
            self._set_rate(self._scheme.weights(self.lengths(step, jump)))
        if self._memory:
            self._memory.begin(self.states[0], step)
        ahead = stage * step
        far = jump or not self.steps or ahead > FARTHEST_AHEAD * self.steps[0]
        self._ahead = 0.0 if far else ahead
        value = program.value(until, self.before)
        force = program.prescribes_force(until)
        self._model.ahead.value = stage * self._growth(step, None if force else value)
        guess = None if until == self._misled else self._guess(until, value)
        guessed = guess is not None and self._start_by(stage * (guess - self.states[0]))
        extrapolated = not guessed and self._extrapolate()
        if not force:
            result = self.solve_for(value, allow_fallback=not guessed)
            if guessed and not result.converged:
                self._misled = until  # shorter steps would end at the same guess
                self.restore()
                self._extrapolate()
                result = self.solve_for(value)
            return result
        assert self.force_control is not None
        self.reached = self.displacement
        if extrapolated:
            past = [np.array(u) for u in self.displacements]
            self.reached += float(extrapolation(past, self.steps, step))
        start = self.before
        if self.time not in program.changes:
            start = program.value(self.time, self.before)
        value = start + stage * (value - start)
        scale = max(abs(value), abs(self.before), program.largest_force)
        return self.force_control.solve(self, value, scale)

    def _growth(self, step: float, displacement: float | None) -> float:
        """Return the change in a step over that in the last one, as far as it can be foretold.

        It is the ratio of their lengths, and after a jump of the velocity that of what the program
        does in them.

        Args:
            step: Length of the step, s.
            displacement: Of the program at its end, m; None where it is not prescribed.
        """
        if self._ahead:
            return step / self.steps[0]
        latest, earlier = self.displacements[:2]
        if displacement is None or latest == earlier:
            return 0.0
        growth = (displacement - latest) / (latest - earlier)
        return growth if abs(growth) <= FARTHEST_AHEAD else 0.0

    def solve_for(self, displacement: float, allow_fallback: bool = True) -> SolveResult:
        """Solve for the stage state of a step that ends at a displacement (m); collective.

        Args:
            displacement: Of the program, m.
            allow_fallback: As of :meth:`EquilibriumSolver.solve`.
        """
        start, self.reached = self.displacement, displacement
        self._solver.problem.prescribe(start + self._scheme.stage * (displacement - start))
        self._model.last.x.array[:] = self.states[0]
        return self._solver.solve(allow_fallback)

    def _guess(self, until: float, displacement: float) -> Array | None:
        """Return a state to start from: one that is given, or one that was there already."""
        given = self.initial_guess(until)
        if given is not None or not self._visited or self._program.prescribes_force(until):
            return given
        return self._visited_at(displacement, self._program.second(until))

    def _visited_at(self, displacement: float, second: float) -> Array | None:
        """Return the state at both displacements (m), if it was there and is kept."""
        error = SAME * max(map(abs, self.displacements))
        for at, second_at, state in self._visited or []:
            if abs(at - displacement) <= error and abs(second_at - second) <= error:
                return state
        return None

    def _keep_visited(self) -> None:
        """Keep the accepted state for the way back."""
        if self._visited is None or self._visited_at(self.displacement, self.second) is not None:
            return
        self._visited = [
            *self._visited[1 - VISITED :],
            (self.displacement, self.second, self.states[0]),
        ]

    def forget_visited(self) -> None:
        """Forget the way here, where stability was lost on it: another one may lead back."""
        if self._visited:
            self._visited = []

    def _has_snapped(self) -> bool:
        """Return whether the present state is far from where the last ones lead; collective.

        A step can end on another branch although both of its ends are minima.
        """
        ahead, last = -np.diff([self.reached, *self.displacements[:2]])
        if not self.steps or not last:
            return False
        own = slice(self._model.placements.owned)
        change = self._model.field.x.array - self.states[0]
        missed = change - extrapolation(self.states, [last], ahead)
        squares = np.array([np.square(vector[own]).sum() for vector in (missed, change)])
        self._model.comm.Allreduce(MPI.IN_PLACE, squares)
        return bool(squares[0] > SNAP**2 * squares[1])

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
                self._set_rate(scheme.weights_at_end(self.lengths(step, jump)))
            model.ahead.value /= scheme.stage
            self._solver.problem.prescribe_second(self._program.second(until))
            model.loading.set(self.reached)
        return change

    def accept(self, until: float, jump: bool) -> None:
        """Take the present state as that at the end of a step.

        Args:
            until: Time at its end, s.
            jump: The velocity jumped at its start.
        """
        self._solver.accept()
        if self._memory:
            self._memory.accept()
        snapped = self._visited is not None and not jump and self._has_snapped()
        if snapped:
            self.forget_visited()
        self.states = [self._model.field.x.array.copy(), *self.states[: KEPT - 1]]
        self.displacements = [self.reached, *self.displacements[: KEPT - 1]]
        steps = [until - self.time, *([] if jump else self.steps[: KEPT - 2])]
        self.steps = [] if snapped else steps  # nothing is extrapolated across a snap
        self.at_rest &= not jump
        self.time = until
        self.number += 1
        self._keep_visited()

    def restore(self) -> None:
        """Go back to the last accepted state."""
        self._model.field.x.array[:] = self.states[0]
        self._solver.restore()

    def lengths(self, step: float, jump: bool) -> list[float]:
        """Return the lengths of a step and of those before it that its rate may look back over.

        What rested before the start did so in steps of any length.

        Args:
            step: Length of the step, s.
            jump: The velocity jumps at its start.
        """
        known = [step] if jump else [step, *self.steps]
        rest = KEPT - len(known) if self.at_rest and not jump else 0
        return [*known, *(known[-1] for _ in range(rest))]

    def _set_rate(self, weights: tuple[float, ...]) -> None:
        constants = self._model.rate_weights
        for i, constant in enumerate(constants):
            constant.value = weights[i] if i < len(weights) else 0.0
        for field, state in zip(self._model.history, self.states, strict=False):
            field.x.array[:] = state

    def _extrapolate(self) -> bool:
        """Start from the state that is extrapolated, or from the last; return whether so."""
        if not (self._ahead and self._predicts):
            self._model.field.x.array[:] = self.states[0]
            return False
        return self._start_by(extrapolation(self.states, self.steps, self._ahead))

    def _start_by(self, change: Array) -> bool:
        """Change the last state (m) unless the families would cross; return whether so."""
        field = self._model.field.x.array
        field[:] = self.states[0]
        if self._solver.crossing.limit(change) <= 2.0:
            return False
        field[:] += change
        return True


def equilibrate(
    solver: EquilibriumSolver,
    program: float,
    smallest: float,
    refuses: Callable[[SolveResult], bool],
) -> tuple[SolveResult | None, int]:
    """Bring a problem from where it starts to rest under a program value; collective.

    Friction carries nothing at rest. It is left out, so that none is dissipated on the way,
    which is one step or, where that fails, several smaller ones.

    Args:
        solver: Solver of the problem, whose field is the state of reference or another.
        program: The program's first value, m.
        smallest: Share of what is prescribed below which stepping ends.
        refuses: Whether an equilibrium must not be accepted, since it is no minimum.

    Returns:
        How it was found, with all iterations, or None where nothing acts; and the
        number of rejected attempts.

    Raises:
        StartFailedError: If there is no such state; the model is as it was at the last
            share that could be reached.
    """
    problem, model = solver.problem, solver.problem.model
    problem.prescribe(program)
    moved = model.loading.force().any() or problem.constraints.origin.any()
    moved = model.comm.allreduce(bool(moved), op=MPI.LOR)
    if not moved and not problem.constraints.unmet(model.field):
        return None, 0
    field = model.field.x.array
    share, step, iterations, rejected = 0.0, 1.0, 0, 0
    with preserved(model.friction):
        model.friction.value = 0.0
        while share < 1:
            reached = field.copy()
            model.last.x.array[:] = reached
            problem.prescribe(program, share + step)
            result = solver.solve()
            if result.converged and not refuses(result):
                share += step
                iterations += result.iterations
                continue
            field[:] = reached
            rejected += 1
            if step / 2 < smallest:
                raise StartFailedError(0.0, program, step, result, rejected)
            step /= 2
    return replace(result, iterations=iterations), rejected
