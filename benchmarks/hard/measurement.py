"""One case stepped to its end, with the figures of the suite; one that was killed goes on."""

from __future__ import annotations

import hashlib
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from benchmarks.hard.row import Figures, Setting
from wovenfab.case.objects import sheet_of, simulation_of
from wovenfab.model.constraints import Constraints
from wovenfab.model.model import Model
from wovenfab.parallel import on_root
from wovenfab.record.results import has_checkpoint, write_whole
from wovenfab.simulation.checkpoint import Checkpoints, load_checkpoint
from wovenfab.simulation.simulation import Observer
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.stepping.stability import StabilityLoss
from wovenfab.stepping.step import Step, StepSizeControl

#: Steps below which a sum of work by the trapezoidal rule says nothing.
ENOUGH_STEPS = 10
#: Variable with the folder for the checkpoints of a row; without it there are none.
FOLDER = "WOVENFAB_HARD_FOLDER"
#: Time or steps between two of them.
EVERY = "2 s"


class Measurement:
    """A case stepped to its end, with what the figures of the suite need.

    Attributes:
        simulation: The case.
        steps: The accepted steps so far.
        margins: Smallest admissibility margin up to each of them.
        end: ``"finished"`` or the diagnosis.
        loss: The loss of stability that ended it, if one did.
    """

    def __init__(
        self,
        setting: Setting,
        comm: MPI.Comm | None = None,
        solver: type[EquilibriumSolver] | None = None,
        step_size: Callable[[float], StepSizeControl] = StepSizeControl,
    ) -> None:
        """Compile the case of a setting; collective.

        Args:
            setting: The case.
            comm: Its ranks; all unless given.
            solver: Another solver than the setting's, for comparison.
            step_size: Another step size control, for comparison.
        """
        case = setting.case.changed(f"output.checkpoint={EVERY}")
        self._setting = setting
        sheet = sheet_of(case, comm or MPI.COMM_WORLD)
        self.simulation = simulation_of(
            case, sheet, solver=solver or setting.solver, step_size=step_size
        )
        self.steps: list[Step] = []
        self.margins: list[float] = []
        self.end = "finished"
        self.loss: StabilityLoss | None = None

    @property
    def model(self) -> Model:
        """The compiled model."""
        return self.simulation.model

    @property
    def equilibrium(self) -> EquilibriumSolver:
        """The solver."""
        return self.simulation.solver

    @property
    def constraints(self) -> Constraints:
        """The prescribed placements."""
        return self.equilibrium.problem.constraints

    def run(self, *observers: Observer) -> Measurement:
        """Go through the program and free the PETSc objects; collective.

        It goes on from where an earlier process was killed, unless there are observers: they have
        not seen the steps before that.
        """
        checkpoints = () if observers else self._checkpoints()
        margins, crossing = [np.inf, *self.margins], self.equilibrium.crossing

        def monitor(snes: Any, *_: Any) -> None:
            self.equilibrium.problem.load(snes.getSolution())
            margins.append(crossing.margin())

        self.equilibrium.newton.snes.setMonitor(monitor)

        def record(step: Step) -> None:
            margins.append(crossing.margin())
            self.steps.append(step)
            self.margins.append(min(margins))

        with self.simulation:
            failure = self.simulation.run(record, *observers, *checkpoints).failure
        if failure is not None:
            self.end, self.loss = str(failure), getattr(failure, "loss", None)
        self.margins[-1] = min(margins)
        return self

    def _checkpoints(self) -> tuple[Observer, ...]:
        """Take the state of the last checkpoint, if any; return what writes others. Collective."""
        if FOLDER not in os.environ:
            return ()
        comm, setting = self.simulation.comm, self._setting
        what = "\0".join(
            [setting.base, *setting.overrides, setting.solver.__name__, str(comm.size)]
        )
        place = Path(os.environ[FOLDER]) / hashlib.sha256(what.encode()).hexdigest()[:16]
        rows = place / "steps.pickle"
        if comm.bcast(has_checkpoint(place)):
            kept = load_checkpoint(place, comm)
            self.simulation.resume(kept)
            steps, margins = comm.bcast(pickle.loads(rows.read_bytes()) if comm.rank == 0 else None)
            self.steps, self.margins = steps[: kept.step + 1], margins[: kept.step + 1]
        on_root(comm, lambda: place.mkdir(parents=True, exist_ok=True))

        def write_steps() -> None:
            write_whole(rows, pickle.dumps((self.steps, self.margins)))

        return (Checkpoints(self.simulation, place, dict, write_steps),)

    @property
    def force(self) -> NDArray[np.float64]:
        """Force (N) of the driven edge along its motion, at each step."""
        return np.array([s.force for s in self.steps])

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
        self.simulation.destroy()


def measured(setting: Setting) -> Figures:
    """Run a setting and return its figures; collective."""
    return Measurement(setting).run().figures()


def last_force(setting: Setting) -> float:
    """Return the force (N) at the end of a setting's program; collective."""
    return float(Measurement(setting).run().force[-1])
