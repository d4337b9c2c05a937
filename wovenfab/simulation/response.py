"""A run without results on disk, and cases with other elements, steps and programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from wovenfab.case import Case, Cycles, Hold, Ramp
from wovenfab.model.model import Model
from wovenfab.record.history import peak_force
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.from_case import program_of_case
from wovenfab.simulation.peak_force import peak_force_bound
from wovenfab.simulation.prolongation import Prolongation
from wovenfab.simulation.simulation import Outcome, Simulation
from wovenfab.stepping.step import Step

Array = NDArray[np.float64]
#: Fewest steps of a segment or cycle.
FEWEST = 4
#: Share of an accuracy to which forces must balance where responses are compared.
LOOSE = 0.1


@dataclass(frozen=True)
class Response:
    """The response of a case at its planned times, or at all times where steps adapt.

    Attributes:
        steps: The initial state and the steps at these times.
        outcome: Effort of all steps.
        seconds: Wall time of the steps on this rank.
        model: The model, whose field is that of the largest force.
        states: The field by time, its unknowns with ghosts; empty unless asked for.
    """

    steps: tuple[Step, ...]
    outcome: Outcome
    seconds: float
    model: Model
    states: Mapping[float, Array]

    @property
    def times(self) -> Array:
        """Times, s, shape (n,)."""
        return np.array([s.time for s in self.steps])

    @property
    def displacements(self) -> Array:
        """Displacement of the program, m."""
        return np.array([s.displacement for s in self.steps])

    @property
    def forces(self) -> Array:
        """Force of the driven edge along its motion, N."""
        return np.array([s.force for s in self.steps])

    @property
    def dissipated(self) -> Array:
        """Energy dissipated since the start, J."""
        return np.array([sum(s.dissipated.values()) for s in self.steps])

    @property
    def figures(self) -> dict[str, float]:
        """Peak force (N) and all the energy dissipated (J)."""
        return {
            "peak_force_N": peak_force(self.forces),
            "dissipated_J": float(self.dissipated[-1]),
        }

    @property
    def count(self) -> int:
        """Number of steps after the initial state."""
        return len(self.steps) - 1

    @property
    def peak_force_bound(self) -> float:
        """Force of largest size that the curve may reach, between steps, too, N."""
        return peak_force_bound(self.times, self.forces)


def response_of(
    case: Case, sheet: Sheet, lower: Response | None = None, with_states: bool = False
) -> Response:
    """Return the response of a case; collective.

    Args:
        case: The case.
        sheet: Its sheet.
        lower: The response of lower degree on the same mesh, with its states: the initial
            guess of steps to the same times, which takes fewer tangents.
        with_states: Whether the response has its states.

    Raises:
        StepFailedError: If a step cannot be made.
        StabilityLostError: If the sheet buckles and the case says to stop there.
    """
    every = case.time.tolerance is not None
    steps: list[Step] = []
    states: dict[float, Array] = {}
    with Simulation(case, sheet) as simulation:
        field = simulation.model.field.x.array
        at_peak, largest = field.copy(), 0.0
        prolongation = None
        if lower is not None:
            prolongation = Prolongation(lower.states, lower.model, simulation.model)
            simulation.stepper.start_from(prolongation.guess)

        def observe(step: Step) -> None:
            nonlocal at_peak, largest
            if step.milestone is None and not every:
                return
            if abs(step.force) > largest:
                at_peak, largest = field.copy(), abs(step.force)
            steps.append(step)
            if prolongation is not None:
                prolongation.accept(step.time)
            if with_states:
                states[step.time] = field.copy()

        start = perf_counter()
        outcome = simulation.run(observe)
        seconds = perf_counter() - start
        if outcome.failure is not None:
            raise outcome.failure
        field[:] = at_peak
    return Response(tuple(steps), outcome, seconds, simulation.model, states)


def with_elements(case: Case, **changes: object) -> Case:
    """Return a case with other elements, such as ``degree=2``."""
    d = case.discretisation.model_copy(update=changes)
    return case.model_copy(update={"discretisation": d})


def trial_of(case: Case, accuracy: float) -> Case:
    """Return a shorter case with the same accuracy: only the largest of its cycles.

    Forces balance to the root of the solver's tolerance at least.

    Args:
        case: The case.
        accuracy: To which responses will be compared.
    """
    program = tuple(
        s.model_copy(update={"amplitudes": (max(s.amplitudes, key=abs),)})
        if isinstance(s, Cycles)
        else s
        for s in case.program
    )
    tolerance = max((LOOSE * accuracy) ** 2, case.solver.tolerance)
    solver = case.solver.model_copy(update={"tolerance": tolerance})
    return case.model_copy(update={"program": program, "solver": solver})


def with_steps(case: Case, share: float, tolerance: float | None = None) -> Case:
    """Return a case with about this share of its planned steps; a table keeps its rows.

    Args:
        case: The case.
        share: Number of planned steps over that of the case.
        tolerance: By which steps adapt in between; None for planned steps.
    """

    def fewer(steps: int) -> int:
        return max(FEWEST, round(steps * share))

    program = tuple(
        s.model_copy(update={"steps": fewer(s.steps)}) if isinstance(s, Ramp | Hold) else s
        for s in case.program
    )
    per_cycle = max(FEWEST, 2 * round(case.time.steps_per_cycle * share / 2))
    time = case.time.model_copy(update={"steps_per_cycle": per_cycle, "tolerance": tolerance})
    return case.model_copy(update={"program": program, "time": time})


def planned_steps(case: Case) -> int:
    """Return the number of planned steps of a case."""
    return len(program_of_case(case).milestones) - 1


def has_fixed_steps(case: Case) -> bool:
    """Return whether no segment can be divided in another number of steps."""
    return not any(isinstance(s, Cycles | Ramp | Hold) for s in case.program)
