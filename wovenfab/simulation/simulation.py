"""A sheet mounted for its test: everything that a march needs, put together from a case."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from wovenfab.case import Case
from wovenfab.model.constraints import Constraints
from wovenfab.model.model import Model
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.from_case import (
    constraints_of,
    driven_edge,
    equilibrium_of,
    model_of,
    program_of_case,
    scheme_of,
)
from wovenfab.stepping.program import Program
from wovenfab.stepping.stability import Treatment
from wovenfab.stepping.time_stepper import TimeStepper


@dataclass(frozen=True)
class Simulation:
    """What a case describes, ready to march.

    Attributes:
        model: The compiled model.
        constraints: Its prescribed placements.
        program: The load program.
        march: Goes through the program.
        driven: The edge whose force is told, and its direction of motion.
    """

    model: Model
    constraints: Constraints
    program: Program
    march: TimeStepper
    driven: tuple[str, tuple[float, float]]

    def force(self, forces: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
        """Return the force (N) of the driven edge along its motion and across it.

        Args:
            forces: Forces (N; x, y) of all held edges.
        """
        edge, (x, y) = self.driven
        fx, fy = forces[edge]
        return x * fx + y * fy, x * fy - y * fx


@contextmanager
def simulation_of(
    case: Case, sheet: Sheet, stability: Treatment | None = None
) -> Iterator[Simulation]:
    """Compile and mount a case on its sheet; its solver is freed at the end. Collective.

    Args:
        case: The validated case.
        sheet: Its meshed sheet.
        stability: What is done where stability is lost, if not what the case says.
    """
    model = model_of(case, sheet)
    constraints = constraints_of(case, model)
    equilibrium = equilibrium_of(case, model, constraints)
    program, scheme = program_of_case(case), scheme_of(case)
    march = TimeStepper(
        model,
        constraints,
        equilibrium,
        program,
        scheme,
        case.time.smallest_step,
        stability or case.solver.stability,
        case.solver.predictor == "quadratic",
        tolerance=case.time.tolerance,
    )
    try:
        yield Simulation(model, constraints, program, march, driven_edge(case))
    finally:
        equilibrium.destroy()
