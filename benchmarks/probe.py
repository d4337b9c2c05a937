"""One run in a process of its own: what it costs to step, and what it gives.

``python -m benchmarks.probe CASE [KEY=VALUE ...]`` prints a line of JSON. Compiling is
not counted; nothing is written.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

CASE = Path(__file__).parents[1] / "configs" / "bias-1x3.yaml"


@dataclass(frozen=True)
class Sample:
    """What a run cost and gave.

    Attributes:
        unknowns, steps, iterations: Numbers; iterations of all steps together.
        seconds: Wall time of the steps.
        memory: Peak memory of all ranks beyond what they had before the mesh, bytes.
        force: Largest force of the driven edge along its motion, N.
        dissipated: Energy dissipated at the end, J.
    """

    unknowns: int
    steps: int
    iterations: int
    seconds: float
    memory: float
    force: float
    dissipated: float


def sample(overrides: Sequence[str] = (), ranks: int = 1, case: Path = CASE) -> Sample:
    """Run a case in a new process on some ranks."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    command = [*launcher, sys.executable, "-m", __name__, str(case), *overrides]
    ended = subprocess.run(command, check=False, capture_output=True, text=True)
    if ended.returncode:
        raise RuntimeError(f"{' '.join(overrides)} failed:\n{ended.stderr[-2000:]}")
    return Sample(**json.loads(ended.stdout.strip().splitlines()[-1]))


def main(case_file: str, overrides: Sequence[str]) -> None:
    """Run here, on all ranks, and print the sample on the first."""
    from mpi4py import MPI

    from wovenfab.case import read_case
    from wovenfab.simulation.from_case import sheet_of
    from wovenfab.simulation.progress import peak_memory
    from wovenfab.simulation.simulation import Simulation

    comm = MPI.COMM_WORLD
    before = peak_memory()
    case = read_case(Path(case_file), overrides)
    with Simulation(case, sheet_of(case, comm)) as simulation:
        comm.barrier()
        start = time.perf_counter()
        steps = list(simulation.steps())
        seconds = time.perf_counter() - start
        found = Sample(
            unknowns=simulation.model.unknowns,
            steps=len(steps) - 1,
            iterations=sum(step.iterations for step in steps),
            seconds=comm.allreduce(seconds, op=MPI.MAX),
            memory=comm.allreduce(peak_memory() - before),
            force=max(step.force for step in steps),
            dissipated=sum(steps[-1].dissipated.values()),
        )
    if comm.rank == 0:
        print(json.dumps(asdict(found)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
