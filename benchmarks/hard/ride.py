"""One case marched to its end, with the figures of the suite."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from benchmarks.hard.row import Figures, Setting
from wovenfab.case import Case
from wovenfab.model.constraints import Constraints
from wovenfab.model.model import Model
from wovenfab.simulation.from_case import (
    constraints_of,
    controls_of,
    driven_edge,
    model_of,
    program_of_case,
    scheme_of,
    sheet_of,
)
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.stepping.stability import StabilityLoss, StabilityLostError
from wovenfab.stepping.step import Step, StepFailedError
from wovenfab.stepping.step_size import StepSizeControl
from wovenfab.stepping.time_stepper import TimeStepper

#: Steps below which a sum of work by the trapezoidal rule says nothing.
ENOUGH_STEPS = 10


@dataclass
class Ride:
    """A case with all that it is marched with.

    Attributes:
        case, model, constraints, equilibrium: As the parts of a run.
        steps: The accepted steps so far.
        margins: Smallest admissibility margin up to each of them.
        pace: How steps are cut and grown.
        end: ``"finished"`` or the diagnosis.
        loss: The loss of stability that ended it, if one did.
    """

    case: Case
    model: Model
    constraints: Constraints
    equilibrium: EquilibriumSolver
    steps: list[Step] = field(default_factory=list)
    margins: list[float] = field(default_factory=list)
    pace: Callable[[float], StepSizeControl] = StepSizeControl
    end: str = "finished"
    loss: StabilityLoss | None = None

    def go(self, look: Callable[[Step], None] = lambda step: None) -> Ride:
        """March to the end; ``look`` is called after each accepted step. Collective."""
        seen = [np.inf]
        self.equilibrium.watch(lambda: seen.append(self.equilibrium.barrier.margin()))
        march = TimeStepper(
            self.model,
            self.constraints,
            self.equilibrium,
            program_of_case(self.case),
            scheme_of(self.case),
            self.case.time.smallest_step,
            self.case.solver.stability,
            self.case.solver.predictor == "quadratic",
            self.pace,
        )
        try:
            for step in march.steps():
                seen.append(self.equilibrium.barrier.margin())
                self.steps.append(step)
                self.margins.append(min(seen))
                look(step)
        except (StepFailedError, StabilityLostError) as error:
            self.end = str(error)
            self.loss = getattr(error, "loss", None)
        self.margins[-1] = min(seen)
        return self

    @property
    def force(self) -> NDArray[np.float64]:
        """Force (N) of the driven edge along its motion, at each step."""
        edge, direction = driven_edge(self.case)
        return np.array([np.dot(direction, s.reactions[edge]) for s in self.steps])

    def figures(self, **checks: float) -> Figures:
        """Return the figures, with more checks."""
        made = self.steps[1:]
        iterations = [s.iterations for s in made]
        work = np.array([s.work for s in self.steps])
        energy = [sum(s.stored.values()) + sum(s.dissipated.values()) for s in self.steps]
        size = float(np.abs(work).max(initial=0.0))
        summed = len(made) >= ENOUGH_STEPS and size > 0
        series = {
            "displacement": [s.displacement for s in self.steps],
            "time": [s.time for s in self.steps],
            "force": self.force.tolist(),
            "margin": self.margins,
            "iterations": iterations,
        }
        return Figures(
            unknowns=self.model.unknowns,
            steps=len(made),
            mean=float(np.mean(iterations)) if made else 0.0,
            worst=max(iterations, default=0),
            cutbacks=sum(s.cutbacks for s in made),
            margin=min(self.margins),
            imbalance=float(np.abs(work - energy).max() / size) if summed else None,
            end=self.end,
            series=series,
        ).with_checks(**checks)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.equilibrium.destroy()


def mount(
    setting: Setting,
    comm: MPI.Comm | None = None,
    solver: type[EquilibriumSolver] = EquilibriumSolver,
    pace: Callable[[float], StepSizeControl] = StepSizeControl,
) -> Ride:
    """Return the case of a setting, ready to be marched; collective.

    Args:
        setting: The case.
        comm: Its ranks; all unless given.
        solver: Another solver, for comparison.
        pace: Another way to cut and grow steps, for comparison.
    """
    case = setting.case
    model = model_of(case, sheet_of(case, comm or MPI.COMM_WORLD))
    constraints = constraints_of(case, model)
    controls = replace(controls_of(case), **setting.controls)
    equilibrium = solver(model, constraints, controls)
    return Ride(case, model, constraints, equilibrium, pace=pace)


def march(setting: Setting) -> Figures:
    """March a setting and return its figures; collective."""
    ride = mount(setting).go()
    figures = ride.figures()
    ride.destroy()
    return figures


def last_force(setting: Setting) -> float:
    """Return the force (N) at the end of a setting's program; collective."""
    ride = mount(setting).go()
    ride.destroy()
    return float(ride.force[-1])
