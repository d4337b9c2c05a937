"""One run in a process of its own: its cost and its results.

``python -m benchmarks.probe CASE [KEY=VALUE ...]`` prints a line of JSON. Compiling is
not counted; nothing is written.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from wovenfab.study.runner import Command, Ended, execute_all, here

CASE = Path(__file__).parents[1] / "configs" / "bias-1x3.yaml"


@dataclass(frozen=True)
class Sample:
    """Cost and results of a run.

    Attributes:
        unknowns, steps, iterations: Numbers; iterations of all steps together.
        seconds: Wall time of the steps.
        memory: Peak memory of all ranks beyond what they had before the mesh, bytes.
        force: Recorded force of largest size of the driven edge along its motion, N.
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
    return samples([overrides], ranks, case)[0]


def samples(overrides: Sequence[Sequence[str]], ranks: int = 1, case: Path = CASE) -> list[Sample]:
    """Run a case with several sets of overrides at the same time."""
    commands = [Command(["-m", "benchmarks.probe", str(case), *o], ranks) for o in overrides]
    ended: dict[int, Ended] = {}
    execute_all(commands, here(len(commands)), on_end=ended.__setitem__)
    for index, of_run in ended.items():
        if of_run.failure:
            raise RuntimeError(f"{' '.join(overrides[index])} failed: {of_run.errors[-2000:]}")
    return [Sample(**ended[index].result) for index in range(len(commands))]


def main(case_file: str, overrides: Sequence[str]) -> None:
    """Run here, on all ranks, and print the sample on the first."""
    from mpi4py import MPI

    from wovenfab.case import read_case
    from wovenfab.case.objects import sheet_of, simulation_of
    from wovenfab.record.history import peak_force
    from wovenfab.simulation.progress import peak_memory

    comm = MPI.COMM_WORLD
    before = peak_memory()
    case = read_case(Path(case_file), overrides)
    with simulation_of(case, sheet_of(case, comm)) as simulation:
        comm.barrier()
        start = time.perf_counter()
        steps = list(simulation.steps())
        seconds = time.perf_counter() - start
        result = Sample(
            unknowns=simulation.model.unknowns,
            steps=len(steps) - 1,
            iterations=sum(step.iterations for step in steps),
            seconds=comm.allreduce(seconds, op=MPI.MAX),
            memory=comm.allreduce(peak_memory() - before),
            force=peak_force([step.force for step in steps]),
            dissipated=sum(steps[-1].dissipated.values()),
        )
    if comm.rank == 0:
        print(json.dumps(asdict(result)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
