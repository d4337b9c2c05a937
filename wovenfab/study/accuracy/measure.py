"""One run of an accuracy study: ``python -m wovenfab.study.accuracy.measure`` in its own process.

What it prints is one line of JSON. A process of its own makes peak memory and wall time
those of this run alone.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from forms.kinematics import displacements
from wovenfab.case import Case, read_case
from wovenfab.model.compiler import cache_folder, compile_form
from wovenfab.model.model import Model
from wovenfab.simulation.from_case import sheet_of
from wovenfab.simulation.peak_force import peak_force
from wovenfab.simulation.progress import peak_memory
from wovenfab.simulation.simulation import Simulation
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.step import Step, StepFailedError

QUANTITIES = PEAK_FORCE, DISSIPATED, RMS_BETA = "peak_force_N", "dissipated_J", "rms_beta_m"


@dataclass(frozen=True)
class Measured:
    """What a run gave and what it cost.

    Attributes:
        values: Largest force of the driven edge along its motion (N; see :func:`peak_force`),
            dissipated energy per cycle (J; of the whole program without cycles), and root mean
            square of beta over the sheet when the displacement is largest (m); only those
            that the scene has.
        unknowns: Number of unknowns.
        steps: Accepted steps.
        iterations: Newton iterations, all together.
        tangents: Number of them that formed one, which takes most of the time.
        cutbacks: How often a step had to be cut back.
        setup: Time for mesh, tables and solver, nothing being compiled, s.
        stepping: Time of all steps, s.
        memory: Largest memory of the process, bytes; its libraries are part of it.
        compile: Time to compile kernels beforehand, s; 0 where they were there.
        failure: Why it ended early, or nothing.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    unknowns: int = 0
    steps: int = 0
    iterations: int = 0
    tangents: int = 0
    cutbacks: int = 0
    setup: float = 0.0
    stepping: float = 0.0
    memory: int = 0
    compile: float = 0.0
    failure: str = ""

    @property
    def wall(self) -> float:
        """Time from the case to its last step, without compilation, s."""
        return self.setup + self.stepping

    @property
    def each_step(self) -> float:
        """Mean time of a step, s."""
        return self.stepping / max(self.steps, 1)


def measure(case: Case, stop_if_compiled: bool = False) -> Measured:
    """Run a case in this process, on one rank, and return what it gave and cost.

    Args:
        case: The case.
        stop_if_compiled: Return without a step if kernels had to be compiled, which takes
            time and memory; then nothing but ``compile`` is known.
    """
    before = _kernels()
    start = time.perf_counter()
    with Simulation(case, sheet_of(case, MPI.COMM_WORLD)) as simulation:
        slip = RmsBeta(simulation.model)
        setup = time.perf_counter() - start
        if stop_if_compiled and _kernels() != before:
            return Measured(compile=setup)
        return _march(simulation, slip, setup)


def _march(simulation: Simulation, slip: RmsBeta, setup: float) -> Measured:
    """Go through the program and return what it gave and cost, with the time before it (s)."""
    farthest, values = -1.0, {}
    steps: list[Step] = []
    forces: list[float] = []
    failure, paused = "", 0.0
    start = time.perf_counter()
    try:
        for step in simulation.steps():
            steps.append(step)
            forces.append(step.force)
            if slip.is_defined and abs(step.displacement) > farthest:
                moment = time.perf_counter()
                farthest, values[RMS_BETA] = abs(step.displacement), slip()
                paused += time.perf_counter() - moment
    except (StepFailedError, StabilityLostError) as error:
        failure = str(error)
    stepping = time.perf_counter() - start - paused
    if len(steps) > 1:
        times = np.array([s.time for s in steps])
        kinks = [s.milestone is not None and s.milestone.jump for s in steps]
        values[PEAK_FORCE] = peak_force(times, np.array(forces), kinks)
    if steps and steps[-1].dissipated:
        cycles = max(len(simulation.program.cycles), 1)
        values[DISSIPATED] = sum(steps[-1].dissipated.values()) / cycles
    return Measured(
        values={
            name: values[name] for name in (PEAK_FORCE, DISSIPATED, RMS_BETA) if name in values
        },
        unknowns=simulation.model.unknowns,
        steps=len(steps) - 1,
        iterations=sum(s.iterations for s in steps),
        tangents=sum(s.tangents for s in steps),
        cutbacks=sum(s.cutbacks for s in steps),
        setup=setup,
        stepping=stepping,
        memory=peak_memory(),
        failure=failure,
    )


class RmsBeta:
    """The root mean square over the sheet of beta = |chi_2 - chi_1|, m."""

    def __init__(self, model: Model) -> None:
        """Compile the integral, where there are two placements."""
        mesh = model.sheet.mesh
        one = fem.Constant(mesh, np.float64(1.0))
        self._square = None
        if model.placements.count == 2:
            first, second = displacements(model.field)
            slip = second - first
            self._square = compile_form(ufl.dot(slip, slip) * ufl.dx(mesh))
        self._area = fem.assemble_scalar(compile_form(one * ufl.dx(mesh)))

    @property
    def is_defined(self) -> bool:
        """Whether there are two placements."""
        return self._square is not None

    def __call__(self) -> float:
        """Return it for the model's present state."""
        return sqrt(fem.assemble_scalar(self._square) / self._area)


def _kernels() -> set[str]:
    return {path.name for path in cache_folder().glob("*.so")}


def read_measured(text: str) -> Measured:
    """Return what a run's JSON says."""
    content: dict[str, Any] = json.loads(text)
    return Measured(**content)


def dump_measured(measured: Measured) -> str:
    """Return a run's figures as one line of JSON."""
    return json.dumps(asdict(measured))


if __name__ == "__main__":
    found = measure(read_case(Path(sys.argv[1]), sys.argv[2:]), stop_if_compiled=True)
    print(dump_measured(found))
