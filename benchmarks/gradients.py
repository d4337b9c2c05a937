"""What derivatives by five parameters cost, over the run itself.

``python -m benchmarks.gradients CASE`` runs a case with derivatives and without, in turns, and
prints a line of JSON.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

from benchmarks.figure import Figure
from wovenfab.study.runner import Command
from wovenfab.study.runner import execute as execute_command

CASE = Path(__file__).parents[1] / "configs" / "bias-1x3.yaml"
BY = ("shear.stiffness", "bending.stiffness", "coupling.stiffness", "slip_friction.strength",
      "slip_friction.slope")  # fmt: skip
#: Pairs of runs.
PAIRS = 3


def gradients() -> list[Figure]:
    """Return the cost of derivatives of force and dissipated energy along all three loops."""
    figures = []
    for ranks in (1, 2):
        ended = execute_command(Command(["-m", "benchmarks.gradients", str(CASE)], ranks))
        if ended.failure:
            raise RuntimeError(ended.errors[-2000:])
        result: dict[str, Any] = ended.result
        figures.append(
            Figure(
                f"derivatives by five parameters, {ranks} ranks",
                result["with"] / result["without"] - 1,
                1.0,
                "x",
                f"{result['without']:.1f} s without, {result['with']:.1f} s with derivatives, "
                f"{result['steps']} steps, medians of {PAIRS}; over the time without",
            )
        )
    return figures


def main(case_file: str) -> None:
    """Measure here, on all ranks, and print the times of the steps on the first."""
    from mpi4py import MPI

    from wovenfab.case import read_case
    from wovenfab.case.objects import differentiate, sheet_of, simulation_of
    from wovenfab.forms.effect import Target

    comm, case = MPI.COMM_WORLD, read_case(Path(case_file))
    targets = [Target(effect, name) for effect, name in (text.split(".") for text in BY)]
    sheet, steps = sheet_of(case, comm), 0
    seconds: tuple[list[float], list[float]] = ([], [])
    for _ in range(PAIRS):
        for number in (0, 1):
            with simulation_of(case, sheet) as simulation:
                if number:
                    differentiate(simulation, case, targets)
                comm.barrier()
                start = perf_counter()
                steps = sum(1 for _ in simulation.steps()) - 1
                seconds[number].append(perf_counter() - start)
    if comm.rank == 0:
        without, derived = map(median, seconds)
        print(json.dumps({"without": without, "with": derived, "steps": steps}))


if __name__ == "__main__":
    main(sys.argv[1])
