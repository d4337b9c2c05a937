"""Long runs: nothing drifts, and nothing grows."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from mpi4py import MPI

from benchmarks.hard.pictures import draw_long
from benchmarks.hard.row import Bound, Family, Figures, Row, Setting
from wovenfab.case.objects import sheet_of, simulation_of
from wovenfab.record.history import read_history
from wovenfab.record.results import open_results
from wovenfab.simulation.progress import Progress, Stopwatch
from wovenfab.simulation.run import run

#: Cycle from which loops must repeat, and from which memory may not grow.
RUN_IN, SETTLED = 2, 5


def cycles(setting: Setting) -> Figures:
    """Run many cycles as ``wovenfab run`` does, results on disk; serial."""
    case = setting.case
    per_cycle, memory = case.time.steps_per_cycle, []

    def report(progress: Progress) -> None:
        if progress.step is not None and progress.step.number % per_cycle == 0:
            memory.append(_resident())

    with TemporaryDirectory() as folder:
        directory = open_results(Path(folder) / "run", overwrite=True)
        with simulation_of(case, sheet_of(case, MPI.COMM_WORLD)) as simulation:
            outcome, _, summary = run(simulation, directory, report, Stopwatch())
        history = read_history(directory)
    memory = memory[1:]  # the first is at the start
    force, steps = history["force_N"], len(history["step"]) - 1
    count = steps // per_cycle
    loops = np.array([force[i * per_cycle : (i + 1) * per_cycle + 1] for i in range(count)])
    each = np.diff(history["imbalance_J"][::per_cycle])
    lost = np.diff(history["dissipated_J"][::per_cycle])
    iterations = history["newton_iterations"][1:]
    changes = np.abs(loops - loops[-1]).max(axis=1) / np.abs(force).max()
    return Figures(
        unknowns=summary["unknowns"],
        steps=steps,
        mean=float(iterations.mean()),
        worst=int(iterations.max()),
        cutbacks=summary["cut_backs"],
        margin=None,
        imbalance=float(np.abs(each / lost).max()),
        end="finished" if outcome.failure is None else str(outcome.failure),
        series={
            "differences": changes.tolist(),
            "imbalance": (each / lost).tolist(),
            "memory": memory,
        },
    ).with_checks(
        change_of_the_loop=float(changes[RUN_IN - 1]),
        drift_of_the_imbalance=float(np.ptp((each / lost)[RUN_IN - 1 :])),
        growth_of_memory=memory[-1] / memory[min(SETTLED, count) - 1] - 1,
    )


def _resident() -> float:
    """Return this process's resident memory, MB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1e3


def _cycles(count: int) -> str:
    return f"program.amplitudes=[{', '.join(['40 mm'] * count)}]"


FAMILY = Family(
    number=9,
    title="Long runs",
    text=(
        "Slow cycles (0.25 Hz), so that the slip of one has relaxed in the next: its relaxation "
        "time is eta zeta/K_c = 0.23 s. The change is "
        "that of the force between cycle 2 and the last, over the largest force; the imbalance is "
        "that of each cycle over the energy it dissipates, and its drift the change of that since "
        "cycle 2: BDF2 loses the same share in each."
    ),
    rows=(
        Row(
            name="long",
            title="200 cycles of 40 mm with slip friction",
            hard="thousands of steps: errors and memory might add up",
            remedy="PETSc objects made once; rows written and forgotten",
            setting=Setting(
                "bias-1x3",
                (
                    _cycles(200),
                    "program.max_velocity=null",
                    "program.frequency=0.25 Hz",
                    "time.steps_per_cycle=20",
                    "discretisation.degree=2",
                    "discretisation.mesh_size=150 mm",
                    "output.every=1000",
                ),
            ),
            measure=cycles,
            bounds=(
                Bound("worst", most=10),
                Bound("cutbacks", most=0),
                Bound("change of the loop", most=1e-6),
                Bound("drift of the imbalance", most=1e-6),
                Bound("growth of memory", most=0.02),
            ),
            quick=(_cycles(6), "time.steps_per_cycle=8"),
            quick_bounds=(Bound("drift of the imbalance", most=1e-5),),
        ),
    ),
    draw=draw_long,
)
