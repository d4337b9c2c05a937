"""What checkpoints cost in time and memory.

``python -m benchmarks.checkpoints CASE [KEY=VALUE ...]`` runs a case into a folder that is removed
afterwards, and prints a line of JSON.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.figure import Figure
from wovenfab.study.runner import Command
from wovenfab.study.runner import execute as execute_command

CASE = Path(__file__).parents[1] / "configs" / "bias-1x3.yaml"
#: The time between two checkpoints, unless a case says otherwise (s).
EVERY = 300.0
#: About 200 000 unknowns, a checkpoint after each of three steps.
LARGE = (
    "discretisation.mesh_size=10mm",
    "program={type: ramp, to: 0.75 mm, steps: 3, duration: 6 ms}",
    "output.checkpoint=1",
)
#: A coarse sheet, a checkpoint after each step or none, and numbers of cycles of 16 steps.
COARSE = (
    "discretisation={degree: 2, mesh_size: 150 mm}",
    *("time.steps_per_cycle=16", "output.every=100"),
)
FEW, MANY = 50, 150


def checkpoints() -> list[Figure]:
    """Return what checkpoints take of a run, and how the memory grows with their number."""
    default, large = (_sample(o, ranks=2) for o in ((), LARGE))
    grown = [_memory("1", MANY) - _memory("1", FEW), _memory("false", MANY) - _memory("false", FEW)]
    number = 16 * (MANY - FEW)
    whole = sum(default["seconds"].values())
    print(f"default case, 2 ranks: {default['seconds']['checkpoints']:.3f} s of {whole:.1f} s")
    one = large["seconds"]["checkpoints"] / large["steps"]
    print(f"one checkpoint of {large['unknowns']} unknowns, 2 ranks: {one:.2f} s")
    return [
        Figure(
            "checkpoints of the default case",
            100 * default["seconds"]["checkpoints"] / whole,
            1.0,
            "%",
            f"one at the end of {default['steps']} steps, 2 ranks, share of the wall time",
        ),
        Figure(
            "checkpoints of a large case",
            100 * one / EVERY,
            1.0,
            "%",
            f"{large['unknowns']} unknowns, {one:.2f} s each, one in {EVERY:g} s, 2 ranks",
        ),
        Figure(
            "memory that a checkpoint leaves behind",
            (grown[0] - grown[1]) / number / 1e3,
            1.0,
            "kB",
            f"{number} steps more take {grown[0] / 1e6:.2f} MB with a checkpoint after each, and "
            f"{grown[1] / 1e6:.2f} MB with none, 1 rank",
        ),
    ]


def _memory(every: str, cycles: int) -> float:
    amplitudes = ", ".join(["5 mm"] * cycles)
    program = f"program={{type: cycles, amplitudes: [{amplitudes}], frequency: 5 Hz}}"
    return float(_sample((*COARSE, program, f"output.checkpoint={every}"))["memory"])


def _sample(overrides: Sequence[str], ranks: int = 1) -> dict[str, Any]:
    arguments = ["-m", "benchmarks.checkpoints", str(CASE), "output.pictures=false", *overrides]
    ended = execute_command(Command(arguments, ranks))
    if ended.failure:
        raise RuntimeError(f"{' '.join(overrides)} failed: {ended.errors[-2000:]}")
    result: dict[str, Any] = ended.result
    return result


def main(case_file: str, overrides: Sequence[str]) -> None:
    """Run here, on all ranks, and print what it took on the first."""
    from mpi4py import MPI

    from wovenfab.case import read_case
    from wovenfab.interface import execute
    from wovenfab.simulation.progress import peak_memory

    comm = MPI.COMM_WORLD
    with tempfile.TemporaryDirectory() as folder:
        place = Path(comm.bcast(folder)) / "run"
        summary = execute(read_case(Path(case_file), overrides), place, comm=comm).summary
        comm.barrier()
    memory = comm.allreduce(peak_memory())
    if comm.rank == 0:
        kept = {name: summary[name] for name in ("steps", "unknowns")}
        print(json.dumps({**kept, "seconds": summary["wall_time_s"], "memory": memory}))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
