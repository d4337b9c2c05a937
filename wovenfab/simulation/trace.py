"""A run that writes nothing: what a case answers with other elements or steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wovenfab.case import Case, Cycles, Hold, Ramp
from wovenfab.model.model import Model
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.assemble import program_of_case
from wovenfab.simulation.raised import raised
from wovenfab.simulation.rig import rig_of

Array = NDArray[np.float64]
#: Fewest steps of a segment or cycle.
FEWEST = 4
#: Tolerance of Newton's method that is enough to compare answers.
LOOSE = 1e-6
#: Steps before and after a crest that tell how high it is, and points between two steps.
REACH, BETWEEN = 3, 33


@dataclass(frozen=True)
class Trace:
    """The answer of a case at its planned times, or at all where steps adapt.

    Attributes:
        times: s, shape (n,).
        displacements: Of the program, m.
        forces: On the driven edge along its motion, N.
        dissipated: Energy lost since the start, J.
        iterations: Newton iterations, all together.
        cutbacks: Rejected attempts: where there are some, there were more steps than planned.
        model: The model, whose field is that of the largest force.
        states: The field at each time, its unknowns with ghosts.
    """

    times: Array
    displacements: Array
    forces: Array
    dissipated: Array
    iterations: int
    cutbacks: int
    model: Model
    states: tuple[Array, ...]

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
        return crest_of(self.times, self.forces)

    def state(self, time: float, model: Model) -> Array | None:
        """Return the field at a time in the unknowns of a model of higher degree, if known."""
        at = np.flatnonzero(self.times == time)
        return raised(self.states[at[0]], self.model, model) if len(at) else None


def crest_of(times: Array, forces: Array) -> float:
    """Return the force of largest size that the curve reaches, maybe between two steps.

    Before and after it the curve goes on as parabolas through three steps each, which meet
    where it is largest, be that smooth or, where friction turns round, a kink.

    Args:
        times: Of the steps, s, shape (n,).
        forces: At the steps, N, shape (n,).
    """
    at = int(np.abs(forces).argmax())
    sign = 1.0 if forces[at] >= 0 else -1.0
    best = abs(float(forces[at]))
    for j in (at - 1, at):
        if j < REACH - 1 or j + REACH >= len(times):
            continue
        t = np.linspace(times[j], times[j + 1], BETWEEN)
        before, after = slice(j - REACH + 1, j + 1), slice(j + 1, j + REACH + 1)
        sides = [_parabola(times[s], sign * forces[s], t) for s in (before, after)]
        best = max(best, float(np.minimum(*sides).max()))
    return sign * best


def _parabola(times: Array, values: Array, at: Array) -> Array:
    origin = times[-1]
    return np.asarray(np.polyval(np.polyfit(times - origin, values, 2), at - origin))


def trace_of(case: Case, sheet: Sheet, near: Trace | None = None) -> Trace:
    """Return the answer of a case; collective.

    Args:
        case: The case.
        sheet: Its sheet.
        near: The answer with elements of lower degree on the same mesh: steps to the same
            times begin there, which takes fewer iterations.

    Raises:
        StepFailedError: If a step cannot be made.
        StabilityLostError: If the sheet buckles and the case says to stop there.
    """
    every = case.time.tolerance is not None
    rows: list[tuple[float, float, float, float]] = []
    states: list[Array] = []
    iterations, cutbacks = 0, 0
    with rig_of(case, sheet) as rig:
        field, model = rig.model.field.x.array, rig.model
        if near is not None:
            rig.march.begin_near(lambda time: near.state(time, model))
        for step in rig.march.steps():
            iterations += step.iterations
            cutbacks += step.cutbacks
            if step.milestone is None and not every:
                continue
            force, _ = rig.force(step.reactions)
            rows.append((step.time, step.displacement, force, sum(step.dissipated.values())))
            states.append(field.copy())
        times, displacements, forces, dissipated = np.array(rows).T
        field[:] = states[int(np.abs(forces).argmax())]
    columns = times, displacements, forces, dissipated
    return Trace(*columns, iterations, cutbacks, model, tuple(states))


def discretised(case: Case, **changes: object) -> Case:
    """Return a case with other elements, such as ``degree=2``."""
    d = case.discretisation.model_copy(update=changes)
    return case.model_copy(update={"discretisation": d})


def brief(case: Case) -> Case:
    """Return a case with what matters for its accuracy: the largest of its cycles.

    Equilibrium is sought no more accurately than answers are compared.
    """
    program = tuple(
        s.model_copy(update={"amplitudes": (max(s.amplitudes, key=abs),)})
        if isinstance(s, Cycles)
        else s
        for s in case.program
    )
    solver = case.solver.model_copy(update={"tolerance": max(LOOSE, case.solver.tolerance)})
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
