"""A run that writes nothing: what a case answers with other elements or steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from wovenfab.case import Case, Cycles, Hold, Ramp
from wovenfab.model.model import Model
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.from_case import program_of_case
from wovenfab.simulation.peak_force import upper_peak_force
from wovenfab.simulation.prolongation import Prolongation
from wovenfab.simulation.simulation import Simulation
from wovenfab.stepping.step import Step

Array = NDArray[np.float64]
#: Fewest steps of a segment or cycle.
FEWEST = 4
#: Share of an accuracy to which forces must balance where answers are compared.
LOOSE = 0.1


@dataclass(frozen=True)
class Response:
    """The answer of a case at its planned times, or at all where steps adapt.

    Attributes:
        times: s, shape (n,).
        displacements: Of the program, m.
        forces: On the driven edge along its motion, N.
        dissipated: Energy lost since the start, J.
        iterations: Newton iterations, all together.
        tangents: Number of them that formed one.
        seconds: Wall time of the steps on this rank.
        cutbacks: Rejected attempts: where there are some, there were more steps than planned.
        model: The model, whose field is that of the largest force.
        states: The field by time, its unknowns with ghosts; empty where it is not kept.
    """

    times: Array
    displacements: Array
    forces: Array
    dissipated: Array
    iterations: int
    tangents: int
    seconds: float
    cutbacks: int
    model: Model
    states: Mapping[float, Array]

    @property
    def figures(self) -> dict[str, float]:
        """Largest force in size (N) and all the energy dissipated (J)."""
        peak = float(self.forces[np.abs(self.forces).argmax()])
        return {"peak_force_N": peak, "dissipated_J": float(self.dissipated[-1])}

    @property
    def steps(self) -> int:
        """Number of steps."""
        return len(self.times) - 1

    @property
    def crest(self) -> float:
        """Largest force in size (N), between steps, too."""
        return upper_peak_force(self.times, self.forces)


def response_of(
    case: Case, sheet: Sheet, near: Response | None = None, keep: bool = False
) -> Response:
    """Return the answer of a case; collective.

    Args:
        case: The case.
        sheet: Its sheet.
        near: The answer with elements of lower degree on the same mesh, with its states: steps
            to the same times begin there, which takes fewer tangents.
        keep: Keep the states.

    Raises:
        StepFailedError: If a step cannot be made.
        StabilityLostError: If the sheet buckles and the case says to stop there.
    """
    every = case.time.tolerance is not None
    rows: list[tuple[float, float, float, float]] = []
    states: dict[float, Array] = {}
    with Simulation(case, sheet) as simulation:
        field = simulation.model.field.x.array
        largest = [field.copy()]
        start = None if near is None else Prolongation(near.states, near.model, simulation.model)
        if start is not None:
            simulation.stepper.start_from(start.guess)

        def observe(step: Step) -> None:
            if step.milestone is None and not every:
                return
            if abs(step.force) > max((abs(row[2]) for row in rows), default=0.0):
                largest[0] = field.copy()
            rows.append((step.time, step.displacement, step.force, sum(step.dissipated.values())))
            if start is not None:
                start.accept(step.time)
            if keep:
                states[step.time] = field.copy()

        begun = perf_counter()
        outcome = simulation.run(observe)
        seconds = perf_counter() - begun
        if outcome.failure is not None:
            raise outcome.failure
        field[:] = largest[0]
    times, displacements, forces, dissipated = np.array(rows).T
    effort = outcome.iterations, outcome.tangents, seconds, outcome.cutbacks
    return Response(times, displacements, forces, dissipated, *effort, simulation.model, states)


def discretised(case: Case, **changes: object) -> Case:
    """Return a case with other elements, such as ``degree=2``."""
    d = case.discretisation.model_copy(update=changes)
    return case.model_copy(update={"discretisation": d})


def brief(case: Case, accuracy: float) -> Case:
    """Return a case with what matters for its accuracy: the largest of its cycles.

    Forces balance to the root of the solver's tolerance at least.

    Args:
        case: The case.
        accuracy: To which answers will be compared.
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


def paced(case: Case, share: float, tolerance: float | None = None) -> Case:
    """Return a case with about this share of its planned steps; a table keeps its rows.

    Args:
        case: The case.
        share: Wanted number of planned steps over that of the case.
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


def steps_in(case: Case) -> int:
    """Return the number of planned steps of a case."""
    return len(program_of_case(case).milestones) - 1


def keeps_its_steps(case: Case) -> bool:
    """Return whether no segment can be divided in another number of steps."""
    return not any(isinstance(s, Cycles | Ramp | Hold) for s in case.program)
