"""A run without results on disk, and cases with other elements or steps.

``peak_force_N`` is the recorded force of largest size (``record.history.peak_force``). It changes
by chance from one step size to the next, in the same way with every scheme, and so hides errors
of the steps.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import chain
from math import inf
from typing import Any

import basix.ufl
import numpy as np
from numpy.typing import NDArray

from wovenfab.case import Case, CyclesSection, RampSection
from wovenfab.case.objects import simulation_of
from wovenfab.case.program import prescribe_forces, program_of_case
from wovenfab.model.model import Model
from wovenfab.record.figures import Columns, StandardTest, columns_of
from wovenfab.record.history import peak_force
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.progress import InterruptedRunError
from wovenfab.simulation.simulation import Outcome
from wovenfab.stepping.step import Step
from wovenfab.study.force_curve import ForceCurve

Array = NDArray[np.float64]
#: Fewest steps of a segment or cycle.
FEWEST = 4
#: Share of an accuracy to which forces must balance where responses are compared.
LOOSE = 0.1
#: Dissipated energy, over the largest force times the largest displacement, that is none: friction
#: that nowhere slides leaves as much by rounding.
NOTHING = 1e-6
#: Figure of a standard test, over the size of what it is a difference of, that is none: a loop that
#: is no wider than curves between few steps are wrong.
NO_LOOP = 1e-3
#: Units of figures that are not judged: a largest angle is prescribed, and a locking angle, where
#: two chords meet, changes with each number of steps.
UNJUDGED = ("rad",)
#: Unknowns of a tangent whose work is 1, and the power of unknowns by which work grows: the time
#: to form and solve is so within a factor of two for one and two placements of degree 2 to 5, with
#: and without friction. On two processors, 1 then takes about 0.1 s.
UNIT, GROWTH = 1e4, 1.2


def work(unknowns: float) -> float:
    """Return the work of forming and solving with a tangent of so many unknowns."""
    return float((unknowns / UNIT) ** GROWTH)


class Budget:
    """Work of runs by their tangents: the same on every machine, however busy.

    Attributes:
        limit: Work after which a run is given up.
        spent: Work of all runs so far.
    """

    def __init__(self, limit: float = inf) -> None:
        """Begin with nothing spent."""
        self.limit, self.spent = limit, 0.0

    def spend(self, tangents: int, unknowns: int) -> None:
        """Add the work of tangents with so many unknowns."""
        self.spent += tangents * work(unknowns)


@dataclass(frozen=True)
class Response:
    """The response of a case at its planned times, or at all times where steps adapt.

    Attributes:
        steps: The initial state and the steps at these times; with stored energies for tests.
        outcome: Effort of all steps.
        model: The model, whose field is that of the largest force.
        states: The field by time, its unknowns with ghosts; empty unless asked for.
        breaks: Times at which the force may jump or turn, s.
        loaded: Whether the program prescribes the force, which the displacement answers.
        tests: Standard tests whose figures are judged.
    """

    steps: tuple[Step, ...]
    outcome: Outcome
    model: Model
    states: Mapping[float, Array]
    breaks: tuple[float, ...] = ()
    loaded: bool = False
    tests: tuple[StandardTest, ...] = ()

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
        """Force that is conjugate to the program, N."""
        return np.array([s.force for s in self.steps])

    @property
    def curve(self) -> ForceCurve:
        """What answers the program against time: the force, or the displacement (m) of a load."""
        answer = self.displacements if self.loaded else self.forces
        return ForceCurve(self.times, answer, self.breaks)

    @property
    def dissipated(self) -> Array:
        """Energy dissipated since the start, J."""
        return np.array([sum(s.dissipated.values()) for s in self.steps])

    @property
    def figures(self) -> dict[str, float]:
        """The peak of what answers the program, all energy dissipated (J), and those of tests (SI).

        Energies and figures are zero if they are next to nothing. Under a prescribed force the
        peak is that of the displacement (m), and else of the force (N). Figures that the steps do
        not tell are left out.
        """
        force, travel = peak_force(self.forces), peak_force(self.displacements)
        loss, least = float(self.dissipated[-1]), NOTHING * abs(force * travel)
        peak = {"peak_displacement_m": travel} if self.loaded else {"peak_force_N": force}
        return {**peak, "dissipated_J": loss if loss > least else 0.0, **self._figures_of_tests()}

    @property
    def history(self) -> Columns:
        """The columns of ``history.csv`` of which figures of tests are made."""
        stored = np.array([sum(s.stored.values()) for s in self.steps])
        return columns_of(self.displacements, self.forces, stored + self.dissipated)

    def _figures_of_tests(self) -> dict[str, float]:
        found, history = dict[str, float](), self.history
        for test in self.tests:
            loop = test.loop(history)
            for name, figure in test.figures(history).items():
                if figure.value is not None and figure.unit not in UNJUDGED:
                    least = NO_LOOP * loop.size(figure.unit)
                    known = figure.value if abs(figure.value) > least else 0.0
                    found[name_of(test.name, name)] = known
        return found

    @property
    def count(self) -> int:
        """Number of steps after the initial state."""
        return len(self.steps) - 1


class TooLongError(RuntimeError):
    """A run was given up, because it took more tangents than it was allowed to."""


def response_of(
    case: Case,
    sheet: Sheet,
    lower: Response | None = None,
    with_states: bool = False,
    budget: Budget | None = None,
    tangents: float = inf,
    model: Model | None = None,
) -> Response:
    """Return the response of a case; collective.

    Args:
        case: The case.
        sheet: Its sheet.
        lower: The response of lower degree on the same mesh, with its states: the initial
            guess of steps to the same times, which takes fewer tangents.
        with_states: Whether the response has its states.
        budget: Gets what the run takes, also where it fails, and limits it.
        tangents: Number of tangents after which it is, too.
        model: That of a response to another program or to other steps, which loses its field.

    Raises:
        TooLongError: If it is given up.
        StepFailedError: If a step cannot be made.
        StabilityLostError: If the sheet buckles and the case says to stop there.
        InterruptedRunError: If a signal ends it.
    """
    every = case.time.tolerance is not None
    # Figures that a zone measures are not judged: it is not recorded.
    case = case.model_copy(update={"output": case.output.model_copy(update={"probes": {}})})
    steps: list[Step] = []
    states: dict[float, Array] = {}
    budget = budget or Budget()
    with simulation_of(case, sheet, model=model) as simulation:
        newton, unknowns, counted = simulation.solver.newton, simulation.model.unknowns, 0
        tests = simulation.output.tests
        simulation.stepper.measures_energy = bool(tests)  # no other figure is made of it
        field = simulation.model.field.x.array
        at_peak, largest = field.copy(), 0.0
        prolongation = None
        if lower is not None:
            prolongation = Prolongation(lower.states, lower.model, simulation.model)
            simulation.stepper.start_from(prolongation.guess)

        def spend() -> None:
            nonlocal counted
            budget.spend(newton.formed - counted, unknowns)
            counted = newton.formed

        def observe(step: Step) -> None:
            nonlocal at_peak, largest
            spend()
            if budget.spent > budget.limit:
                raise TooLongError(f"more work than is allowed after {step.number} steps")
            if simulation.outcome.iterations > tangents:
                raise TooLongError(f"more than {tangents:.0f} tangents in {step.number} steps")
            if step.milestone is None and not every:
                return
            if abs(step.force) > largest:
                at_peak, largest = field.copy(), abs(step.force)
            steps.append(step)
            if prolongation is not None:
                prolongation.accept(step.time)
            if with_states:
                states[step.time] = field.copy()

        outcome = simulation.run(observe)
        spend()
        if outcome.failure is not None:
            raise outcome.failure
        if outcome.signal:
            raise InterruptedRunError(outcome.signal)
        field[:] = at_peak
    loaded = any(prescribe_forces(case.program))
    return Response(
        tuple(steps),
        outcome,
        simulation.model,
        states,
        breaks_of(case),
        loaded,
        tests,
    )


def name_of(test: str, figure: str) -> str:
    """Return the name of a figure of a standard test among all that are judged."""
    return f"{test}: {figure}"


def is_set_valued(case: Case) -> bool:
    """Return whether a case has a set-valued law of friction."""
    return any(entry.effect.set_valued for entry in case.scene)


def depends_on_steps(case: Case) -> bool:
    """Return whether figures depend on the steps: with history, or read between them by a test."""
    return case.needs.history or bool(case.figures)


def breaks_of(case: Case) -> tuple[float, ...]:
    """Return the times (s) at which the force may jump or turn.

    These are reversals where friction has no rate, and jumps of the velocity where it has one.
    """
    if not depends_on_steps(case):
        return ()
    program, times = program_of_case(case), set[float]()
    if case.needs.rate:
        times |= {m.time for m in program.milestones if m.jump}
    if not case.needs.rate or is_set_valued(case):
        times |= program.reversals
    return tuple(sorted(times))


def with_elements(case: Case, **changes: object) -> Case:
    """Return a case with other elements, such as ``degree=2``."""
    d = case.discretisation.model_copy(update=changes)
    return case.model_copy(update={"discretisation": d})


def trial_of(case: Case, accuracy: float) -> Case:
    """Return a shorter case with the same accuracy: only the largest cycle, no extra times.

    Where nothing depends on steps, a cycle is only the way to its largest displacement.
    Forces balance to the root of the solver's tolerance at least; responses will be compared to
    the accuracy. Prescribed ones stay as exact as in the case.
    """
    program = tuple(_largest_cycle(s) if isinstance(s, CyclesSection) else s for s in case.program)
    match program:
        case (CyclesSection(amplitudes=(largest,)),) if not depends_on_steps(case):
            program = (RampSection(to=largest),)
    loose = 0.0 if any(prescribe_forces(case.program)) else (LOOSE * accuracy) ** 2
    tolerance = max(loose, case.solver.tolerance)
    solver = case.solver.model_copy(update={"tolerance": tolerance})
    trial = case.model_copy(update={"program": program, "solver": solver})
    return with_extra_times(trial, ())


def _largest_cycle(cycles: CyclesSection) -> CyclesSection:
    return cycles.model_copy(update={"amplitudes": (max(cycles.amplitudes),), "repeat": 1})


def with_steps(
    case: Case, share: float, tolerance: float | None = None, fewest: int = FEWEST
) -> Case:
    """Return a case with about this share of its planned steps; a table keeps its rows.

    Args:
        case: The case.
        share: Number of planned steps over that of the case.
        tolerance: By which steps adapt in between; None for planned steps.
        fewest: Of a ramp or a hold.
    """
    programs: dict[str, Any] = {
        name: tuple(
            s
            if isinstance(s, CyclesSection) or not s.steps
            else s.model_copy(update={"steps": max(fewest, round(s.steps * share))})
            for s in segments
        )
        for name, segments in case.programs.items()
    }
    per_cycle = max(FEWEST, 2 * round(case.time.steps_per_cycle * share / 2))
    time = case.time.model_copy(update={"steps_per_cycle": per_cycle, "tolerance": tolerance})
    return case.model_copy(update={**programs, "time": time})


def with_extra_times(case: Case, times: Iterable[float]) -> Case:
    """Return a case with these extra times (s), at which steps end, too, in place of its own."""
    time = case.time.model_copy(update={"extra_times": tuple(times)})
    return case.model_copy(update={"time": time})


def has_fixed_steps(case: Case) -> bool:
    """Return whether no segment can be divided in another number of steps."""
    segments = chain(*case.programs.values())
    return not any(isinstance(s, CyclesSection) or s.steps for s in segments)


def prolongated(values: Array, low: Model, high: Model) -> Array:
    """Return unknowns (m, with ghosts) of a higher degree that make the same field; collective."""
    elements = [
        basix.ufl.element("Lagrange", "triangle", m.balance.degree).basix_element
        for m in (low, high)
    ]
    table = elements[0].tabulate(0, elements[1].points)[0, :, :, 0]
    of_cells = values.reshape(-1, 2)[low.placements.blocks]
    return high.placements.from_cells(np.einsum("ij,cjkd->cikd", table, of_cells))


class Prolongation:
    """Initial guesses of steps from states of lower degree and the corrections so far.

    The correction by the higher degree is as smooth in time as the motion: it is extrapolated
    linearly.
    """

    def __init__(self, states: Mapping[float, Array], low: Model, high: Model) -> None:
        """Start without any step, from unknowns (m, with ghosts) of lower degree by time (s)."""
        self._states, self._low, self._high = states, low, high
        self._corrections: list[tuple[float, Array]] = []

    def guess(self, time: float) -> Array | None:
        """Return the initial guess for a time, or None where there is no state of lower degree."""
        if (state := self._prolongated(time)) is None:
            return None
        if self._corrections:
            (then, last), *before = reversed(self._corrections)
            state += last
            for earlier, previous in before:
                state += (last - previous) * ((time - then) / (then - earlier))
        return state

    def accept(self, time: float) -> None:
        """Store the correction in the model's present field."""
        if (state := self._prolongated(time)) is not None:
            correction = (time, self._high.field.x.array - state)
            self._corrections = [*self._corrections[-1:], correction]

    def _prolongated(self, time: float) -> Array | None:
        state = self._states.get(time)
        return None if state is None else prolongated(state, self._low, self._high)
