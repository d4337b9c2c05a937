"""One run of an accuracy study: ``python -m wovenfab.study.accuracy.measure`` in its own process.

It prints one line of JSON. A process of its own makes peak memory and wall time those of this
run alone.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from math import sqrt
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from forms.kinematics import displacements
from wovenfab.case import Case, read_case
from wovenfab.model.assembly import cache_folder, compile_form
from wovenfab.model.model import Model
from wovenfab.simulation.from_case import sheet_of
from wovenfab.simulation.progress import peak_memory
from wovenfab.simulation.response import interpolated_peak_force
from wovenfab.simulation.simulation import Simulation
from wovenfab.stepping.step import Step
from wovenfab.study.accuracy.settings import Setting
from wovenfab.study.runner import Command, Store, execute, fingerprint

PEAK_FORCE, DISSIPATED, RMS_BETA = "peak_force_interpolated_N", "dissipated_J", "rms_beta_m"
#: Another process may be compiling kernels of its own meanwhile; then the run starts again.
_MOST_STARTS = 4


@dataclass(frozen=True)
class Measured:
    """Results and cost of a run.

    Attributes:
        values: Largest force of the driven edge along its motion (N; see
            :func:`interpolated_peak_force`), dissipated energy per cycle (J; of the whole
            program without cycles), and root mean square of beta over the sheet when the
            displacement is largest (m); only those that the scene has.
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


def measure(case: Case, stop_if_compiled: bool = False) -> Measured:
    """Run a case in this process, on one rank, and return its results and cost.

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
        recorded: list[Step] = []
        farthest, rms, paused = -1.0, 0.0, 0.0

        def observe(step: Step) -> None:
            nonlocal farthest, rms, paused
            recorded.append(step)
            if slip.is_defined and abs(step.displacement) > farthest:
                moment = time.perf_counter()
                farthest, rms = abs(step.displacement), slip()
                paused += time.perf_counter() - moment

        start = time.perf_counter()
        outcome = simulation.run(observe)
        return Measured(
            values=_values(recorded, simulation) | ({RMS_BETA: rms} if farthest >= 0 else {}),
            unknowns=simulation.model.unknowns,
            steps=outcome.steps,
            iterations=outcome.iterations,
            tangents=outcome.tangents,
            cutbacks=outcome.cutbacks,
            setup=setup,
            stepping=time.perf_counter() - start - paused,
            memory=peak_memory(),
            failure="" if outcome.failure is None else str(outcome.failure),
        )


def _values(steps: Sequence[Step], simulation: Simulation) -> dict[str, float]:
    """Return peak force and dissipated energy per cycle, where there are any."""
    values = {}
    if len(steps) > 1:
        times, forces = (np.array([getattr(s, name) for s in steps]) for name in ("time", "force"))
        kinks = [s.milestone is not None and s.milestone.jump for s in steps]
        values[PEAK_FORCE] = interpolated_peak_force(times, forces, kinks)
    if steps and steps[-1].dissipated:
        cycles = max(len(simulation.program.cycles), 1)
        values[DISSIPATED] = sum(steps[-1].dissipated.values()) / cycles
    return values


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


class StoredRuns:
    """Runs settings of a case in processes, unless the store has their results.

    Attributes:
        asked: Number of settings so far.
        stored: Number of these whose results were there already.
    """

    def __init__(
        self,
        case: Case,
        folder: Path,
        progress: Callable[[float], None] = lambda seconds: None,
    ) -> None:
        """Run nothing yet.

        Args:
            case: The case, read from a file.
            folder: Where results are stored, a file each.
            progress: Called several times a second during a run with its wall time, s.
        """
        self._case, self._store, self._progress = case, Store(folder), progress
        self.asked = self.stored = 0

    def __call__(self, setting: Setting) -> Measured:
        """Return results and cost of a setting.

        Raises:
            KeyboardInterrupt: This process was interrupted; the run was ended, too.
        """
        self.asked += 1
        case = self._case.changed(*setting.overrides)
        key = fingerprint(case, Path(__file__))
        if (result := self._store.load(key)) is not None:
            self.stored += 1
            return Measured(**result)
        measured = self._run(case)
        self._store.save(key, key, asdict(measured))
        return measured

    def _run(self, case: Case) -> Measured:
        module = "wovenfab.study.accuracy.measure"
        command = Command(["-m", module, str(case.path), *case.overrides])
        compiled = 0.0
        for _ in range(_MOST_STARTS):
            ended = execute(command, self._progress)
            if ended.failure:
                return Measured(failure=ended.failure, compile=compiled)
            measured = Measured(**ended.result)
            if not measured.compile:
                return replace(measured, compile=compiled)
            compiled += measured.compile
        return Measured(failure="kernels were compiled again and again", compile=compiled)


if __name__ == "__main__":
    result = measure(read_case(Path(sys.argv[1]), sys.argv[2:]), stop_if_compiled=True)
    print(json.dumps(asdict(result)))
