"""One run of an accuracy study: ``python -m wovenfab.study.accuracy.measure`` in its own process.

It prints one line of JSON. A process of its own makes peak memory and wall time those of this
run alone.
"""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from wovenfab.case import Case, read_case
from wovenfab.case.fingerprint import fingerprint
from wovenfab.case.objects import sheet_of, simulation_of
from wovenfab.forms.kinematics import displacements
from wovenfab.model.assembly import cache_folder, compile_form
from wovenfab.model.model import Model
from wovenfab.record.results import has_checkpoint
from wovenfab.simulation.checkpoint import Checkpoints, load_checkpoint
from wovenfab.simulation.progress import (
    InterruptedRunError,
    Interruption,
    Stopwatch,
    peak_memory,
)
from wovenfab.simulation.simulation import Outcome
from wovenfab.stepping.step import Step
from wovenfab.study.accuracy.settings import Setting
from wovenfab.study.response import interpolated_peak_force
from wovenfab.study.runner import Command, Store, execute

PEAK_FORCE, DISSIPATED, RMS_BETA = "peak_force_interpolated_N", "dissipated_J", "rms_beta_m"
#: Another process may be compiling kernels of its own meanwhile; then the run starts again.
_MOST_STARTS = 4
#: Exit code of a run that a signal ended, less the signal's number.
_SIGNALLED = 128


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


@dataclass
class Recorded:
    """What is known of a run so far; plain values, which a checkpoint keeps.

    Attributes:
        times, forces: Of each state (s, N).
        kinks: Whether prescribed values jump there.
        dissipated: Energy so far (J); None where nothing dissipates.
        farthest: Largest displacement so far (m); negative before the first state.
        rms: Root mean square of beta there (m).
        seconds: Time of all steps.
        memory: Largest memory, bytes.
        effort: That of the outcome so far.
    """

    times: list[float] = field(default_factory=list)
    forces: list[float] = field(default_factory=list)
    kinks: list[bool] = field(default_factory=list)
    dissipated: float | None = None
    farthest: float = -1.0
    rms: float = 0.0
    seconds: float = 0.0
    memory: int = 0
    effort: dict[str, Any] = field(default_factory=dict)

    def add(self, step: Step) -> None:
        """Add a state."""
        self.times.append(step.time)
        self.forces.append(step.force)
        self.kinks.append(step.milestone is not None and step.milestone.jump)
        self.dissipated = sum(step.dissipated.values()) if step.dissipated else None

    def values(self, cycles: int) -> dict[str, float]:
        """Return the values of :class:`Measured` that the run has."""
        values = {}
        if len(self.times) > 1:
            times, forces = np.array(self.times), np.array(self.forces)
            values[PEAK_FORCE] = interpolated_peak_force(times, forces, self.kinks)
        if self.dissipated is not None:
            values[DISSIPATED] = self.dissipated / max(cycles, 1)
        return values | ({RMS_BETA: self.rms} if self.farthest >= 0 else {})


def measure(case: Case, folder: Path | None = None) -> Measured:
    """Run a case in this process, on one rank, and return its results and cost.

    Args:
        case: The case.
        folder: For checkpoints; the run goes on from the one that is there. If kernels have to be
            compiled, which takes time and memory, no step is made: nothing but ``compile`` is
            known. None to run in any case and without checkpoints.

    Raises:
        InterruptedRunError: A signal ended the run; its last state is in the folder.
    """
    before, start = _kernels(), time.perf_counter()
    with simulation_of(case, sheet_of(case, MPI.COMM_WORLD)) as simulation:
        slip = RmsBeta(simulation.model)
        setup = time.perf_counter() - start
        if folder is not None and _kernels() != before:
            return Measured(compile=setup)
        so_far, watch = Recorded(), Stopwatch()

        def look(step: Step) -> None:
            so_far.add(step)
            if slip.is_defined and abs(step.displacement) > so_far.farthest:
                so_far.farthest, so_far.rms = abs(step.displacement), slip()
            if checkpoints is not None:
                checkpoints(step)

        def known() -> Recorded:
            return replace(
                so_far,
                seconds=so_far.seconds + sum(watch.seconds.values()),
                memory=max(so_far.memory, peak_memory()),
                effort=simulation.outcome.effort,
            )

        checkpoints: Checkpoints | None = None
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            checkpoints = Checkpoints(
                simulation, folder, lambda: {"measured": asdict(known())}, lambda: None
            )
            if has_checkpoint(folder):
                checkpoint = load_checkpoint(folder, simulation.comm)
                simulation.resume(checkpoint)
                so_far = Recorded(**checkpoint.values["measured"])
                simulation.outcome = Outcome(**so_far.effort)
        with Interruption() as interruption:
            outcome = simulation.run(look, watch=watch, interruption=interruption)
        if outcome.signal:
            if checkpoints is not None:
                checkpoints.write()
            raise InterruptedRunError(outcome.signal)
        whole = known()
        return Measured(
            values=whole.values(len(simulation.program.cycles)),
            unknowns=simulation.model.unknowns,
            **outcome.effort,
            setup=setup,
            stepping=whole.seconds,
            memory=whole.memory,
            failure="" if outcome.failure is None else str(outcome.failure),
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


class StoredRuns:
    """Runs settings of a case in processes, unless the store has their results.

    Attributes:
        asked: Number of settings so far.
        stored: Number of these whose results were there already.
    """

    def __init__(
        self, case: Case, folder: Path, progress: Callable[[float], None] = lambda seconds: None
    ) -> None:
        """Run nothing yet.

        Results are stored in the folder, a file each; ``progress`` is called several times a second
        during a run with its wall time, s.
        """
        self._case, self._store, self._progress = case, Store(folder), progress
        self.asked = self.stored = 0

    def __call__(self, setting: Setting) -> Measured:
        """Return results and cost of a setting.

        Raises:
            KeyboardInterrupt: This process was interrupted; the run was ended, too. The next
                call goes on from its last checkpoint.
        """
        self.asked += 1
        case = self._case.changed(*setting.overrides)
        key = fingerprint(case, Path(__file__))
        if (result := self._store.load(key)) is not None:
            self.stored += 1
            return Measured(**result)
        folder = self._store.folder / key
        measured = self._run(case, folder)
        self._store.save(key, key, asdict(measured))
        shutil.rmtree(folder, ignore_errors=True)
        return measured

    def _run(self, case: Case, folder: Path) -> Measured:
        module = "wovenfab.study.accuracy.measure"
        command = Command(["-m", module, str(case.path), str(folder.resolve()), *case.overrides])
        compiled = 0.0
        for _ in range(_MOST_STARTS):
            ended = execute(command, self._progress)
            if (ended.code < 0 or ended.code > _SIGNALLED) and has_checkpoint(folder):
                continue  # killed: it goes on from there
            if ended.failure:
                return Measured(failure=ended.failure, compile=compiled)
            measured = Measured(**ended.result)
            if not measured.compile:
                return replace(measured, compile=compiled)
            compiled += measured.compile
        return Measured(failure="it was compiled or killed again and again", compile=compiled)


if __name__ == "__main__":
    try:
        result = measure(read_case(Path(sys.argv[1]), sys.argv[3:]), Path(sys.argv[2]))
    except InterruptedRunError as signalled:
        sys.exit(_SIGNALLED + signalled.number)
    print(json.dumps(asdict(result)))
