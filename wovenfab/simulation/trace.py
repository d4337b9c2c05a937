"""A run that writes nothing: what a case answers with other elements or steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wovenfab.case import Case, Cycles, Hold, Ramp
from wovenfab.model.model import Model
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.assemble import (
    constraints_of,
    driven_edge,
    equilibrium_of,
    model_of,
    program_of_case,
    scheme_of,
)
from wovenfab.stepping.march import March

Array = NDArray[np.float64]
#: Fewest steps of a cycle.
FEWEST = 4


@dataclass(frozen=True)
class Trace:
    """The answer of a case at its planned times.

    Attributes:
        times: s, shape (n,).
        displacements: Of the program, m.
        forces: On the driven edge along its motion, N.
        dissipated: Energy lost since the start, J.
        model: The model, whose field is that of the largest force.
    """

    times: Array
    displacements: Array
    forces: Array
    dissipated: Array
    model: Model

    @property
    def figures(self) -> dict[str, float]:
        """Largest force in size (N) and all the energy dissipated (J)."""
        peak = float(self.forces[np.abs(self.forces).argmax()])
        return {"peak_force_N": peak, "dissipated_J": float(self.dissipated[-1])}


def trace_of(case: Case, sheet: Sheet) -> Trace:
    """Return the answer of a case; collective.

    Raises:
        StepFailedError: If a step cannot be made.
        StabilityLostError: If the sheet buckles and the case says to stop there.
    """
    model = model_of(case, sheet)
    constraints = constraints_of(case, model)
    equilibrium = equilibrium_of(case, model, constraints)
    edge, direction = driven_edge(case)
    rows: list[tuple[float, float, float, float]] = []
    largest, state = -1.0, model.field.x.array.copy()
    try:
        march = March(
            model,
            constraints,
            equilibrium,
            program_of_case(case),
            scheme_of(case),
            case.time.smallest_step,
            case.solver.stability,
        )
        for step in march.steps():
            if step.milestone is None:
                continue
            force = float(np.dot(direction, step.reactions[edge]))
            rows.append((step.time, step.displacement, force, sum(step.dissipated.values())))
            if abs(force) > largest:
                largest, state = abs(force), model.field.x.array.copy()
    finally:
        equilibrium.destroy()
    model.field.x.array[:] = state
    times, displacements, forces, dissipated = np.array(rows).T
    return Trace(times, displacements, forces, dissipated, model)


def discretised(case: Case, **changes: object) -> Case:
    """Return a case with other elements, such as ``degree=2``."""
    d = case.discretisation.model_copy(update=changes)
    return case.model_copy(update={"discretisation": d})


def paced(case: Case, share: float) -> Case:
    """Return a case with about this share of its steps; a table keeps its rows.

    Args:
        case: The case.
        share: Wanted number of steps over that of the case.
    """

    def fewer(steps: int) -> int:
        return max(2, round(steps * share))

    program = tuple(
        s.model_copy(update={"steps": fewer(s.steps)}) if isinstance(s, Ramp | Hold) else s
        for s in case.program
    )
    per_cycle = max(FEWEST, 2 * round(case.time.steps_per_cycle * share / 2))
    time = case.time.model_copy(update={"steps_per_cycle": per_cycle})
    return case.model_copy(update={"program": program, "time": time})


def steps_in(case: Case) -> int:
    """Return the number of planned steps of a case."""
    return len(program_of_case(case).milestones) - 1


def keeps_its_steps(case: Case) -> bool:
    """Return whether no segment can be divided in another number of steps."""
    return not any(isinstance(s, Cycles | Ramp | Hold) for s in case.program)
