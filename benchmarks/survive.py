"""``python3 -m benchmarks.survive [KILLS]``: runs that are killed again and again, and go on.

Slip and spin friction, two placements, adaptive steps. Each part runs on a random number of ranks
and is killed without warning, at a random moment or while it writes a checkpoint or fields. The
last history must be that of a run that was left alone. Then 400 cycles in 20 parts.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mpi4py import MPI

from benchmarks.figure import Figure
from wovenfab.case import Case, read_case
from wovenfab.interface import execute
from wovenfab.parallel import child_environment
from wovenfab.record.history import read_history

ROOT = Path(__file__).parents[1]
CASE = ROOT / "configs" / "bias-1x3.yaml"
COARSE = (
    *("output.pictures=false", "discretisation={degree: 2, mesh_size: 75 mm}"),
    "effects.spin_friction={strength: 30 N/m, slope: 40 s}",
)
KILLED = (
    *COARSE,
    "program={type: cycles, amplitudes: [10 mm, 20 mm, 15 mm], max_velocity: 0.5 m/s}",
    *("time={steps_per_cycle: 80, tolerance: 3e-3}", "output.checkpoint=3", "output.every=1"),
)
CYCLES, PARTS = 400, 20
LONG = (
    *COARSE,
    f"program={{type: cycles, amplitudes: [{', '.join(['5 mm'] * CYCLES)}], frequency: 5 Hz}}",
    *("time.steps_per_cycle=8", "output.every=100", "discretisation.mesh_size=150 mm"),
)
#: Kills unless another number is asked for, and ranks of a part at most.
KILLS, RANKS = 50, 4
#: Seconds from the first step of a part to its kill, at most.
LONGEST = 1.0
#: Seconds in which the ranks must end when one of them dies.
END = 30.0
#: Largest difference of histories on different numbers of ranks, over the largest value.
SAME = 1e-8


@dataclass
class Tally:
    """What happened.

    Attributes:
        kills: Number of kills after the first step of a part.
        writing: How many of them hit a file that was being written.
        lost: Largest number of steps that had to be made again.
        end: Longest time from the death of a rank to the end of all, s.
        difference: Largest difference of a last history from the undisturbed one, relative.
        runs: Number of runs that came to their end.
    """

    kills: int = 0
    writing: int = 0
    lost: int = 0
    end: float = 0.0
    difference: float = 0.0
    runs: int = 0
    parts: list[int] = field(default_factory=list)


def survive(kills: int = KILLS) -> list[Figure]:
    """Kill and resume so many times, then compare cycles in parts with cycles in one piece."""
    generator, tally = random.Random(1), Tally()
    case = read_case(CASE, KILLED)
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "whole"
        execute(case, whole, comm=MPI.COMM_SELF)
        expected = read_history(whole)
        print(f"undisturbed: {len(expected['step']) - 1} steps", flush=True)
        while tally.kills < kills:
            directory = Path(folder) / f"run-{tally.runs}"
            _one_run(directory, kills, generator, tally)
            tally.difference = max(tally.difference, difference(read_history(directory), expected))
            tally.runs += 1
        drift = _cycles_in_parts(Path(folder))
    print(
        f"{tally.kills} kills, {tally.writing} of them while a file was being written; "
        f"{tally.runs} runs came to their end; largest loss {tally.lost} steps; "
        f"largest difference {tally.difference:.1e}"
    )
    return [
        Figure("kills survived", tally.kills, kills, "", "each went on to the end", at_least=True),
        Figure("difference after kills", tally.difference, SAME, "", "relative, any ranks"),
        Figure("steps lost at a kill", tally.lost, 2 * 3, "", "a checkpoint every 3 steps"),
        Figure("end after the death of a rank", tally.end, END, "s", "all ranks and mpirun"),
        Figure("drift of 400 cycles in 20 parts", drift, 1e-12, "", "relative, same ranks"),
    ]


def difference(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> float:
    """Return the largest difference of two histories over the largest value of its kind."""
    if len(one["step"]) != len(other["step"]):
        return float("inf")
    worst = 0.0
    for name, values in other.items():
        if name == "newton_iterations":  # steps are equal to the tolerance of the solver
            continue
        alike = [n for n in other if n.rsplit("_", 1)[-1] == name.rsplit("_", 1)[-1]]
        scale = max(float(np.abs(other[n]).max()) for n in alike) or 1.0
        worst = max(worst, float(np.abs(one[name] - values).max()) / scale)
    return worst


def _one_run(directory: Path, kills: int, generator: random.Random, tally: Tally) -> None:
    """Run a case to its end through all kills that are left."""
    begun = False
    while True:
        ranks = generator.randint(1, RANKS)
        rows = _rows(directory)
        log = directory.with_suffix(".log")
        part = _start(directory, log, ranks, begun)
        spared = tally.kills >= kills
        killed = not spared and _kill(part, directory, log, ranks, generator, tally)
        part.wait()
        output = log.read_text()
        if begun and "going on after step" in output:
            step = int(output.split("going on after step ")[1].split()[0])
            tally.lost = max(tally.lost, rows - 1 - step)
        if not killed:
            if part.returncode:
                raise RuntimeError(
                    f"a part on {ranks} ranks ended with {part.returncode}: {output}"
                )
            return
        begun = begun or (directory / "checkpoint.h5").exists()


def _start(directory: Path, log: Path, ranks: int, resume: bool) -> subprocess.Popen[bytes]:
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    arguments = ["run", str(CASE), "-o", str(directory), "--resume" if resume else "--overwrite"]
    changes = [word for text in KILLED for word in ("--set", text)]
    own = os.environ | {"PYTHONPATH": child_environment()["PYTHONPATH"], "OMP_NUM_THREADS": "1"}
    with log.open("wb") as output:
        return subprocess.Popen(
            [*launcher, sys.executable, "-P", "-m", "wovenfab", *arguments, *changes],
            env=own, stdout=output, stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip


def _kill(
    part: subprocess.Popen[bytes],
    directory: Path,
    log: Path,
    ranks: int,
    generator: random.Random,
    tally: Tally,
) -> bool:
    """Kill a part; return whether that came before its end."""
    while part.poll() is None and b"stepping" not in log.read_bytes():
        time.sleep(0.005)
    writing = generator.random() < 0.5
    if writing:
        until = time.monotonic() + END
        while part.poll() is None and time.monotonic() < until and not _is_writing(directory):
            pass
    else:
        time.sleep(generator.uniform(0, LONGEST))
    if part.poll() is not None:
        return False
    tally.kills += 1
    tally.writing += writing and _is_writing(directory)
    processes = _session(part.pid)
    began = time.monotonic()
    if ranks > 1 and generator.random() < 0.5:  # one rank alone dies; the others must not hang
        os.kill(generator.choice([p for p in processes if p != part.pid]), signal.SIGKILL)
        part.wait(2 * END)
        while _session(part.pid) and time.monotonic() - began < 2 * END:
            time.sleep(0.05)
        tally.end = max(tally.end, time.monotonic() - began)
    for process in _session(part.pid):
        os.kill(process, signal.SIGKILL)
    part.wait()
    return True


def _session(leader: int) -> list[int]:
    """Return the living processes of a session."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            fields = (path / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == leader and fields[0] != "Z":
            found.append(int(path.name))
    return found


def _rows(directory: Path) -> int:
    """Return the number of whole rows of the history."""
    try:
        return max(0, (directory / "history.csv").read_bytes().count(b"\n") - 1)
    except OSError:
        return 0


def _is_writing(directory: Path) -> bool:
    return any(
        path.name.endswith(".part")
        for folder in (directory, directory / "fields")
        if folder.is_dir()
        for path in folder.iterdir()
    )


def _cycles_in_parts(folder: Path) -> float:
    """Return the largest difference of many cycles in parts from the same in one piece."""
    case: Case = read_case(CASE, LONG)
    start = time.perf_counter()
    execute(case, folder / "one", comm=MPI.COMM_SELF)
    seconds = time.perf_counter() - start
    one = read_history(folder / "one")
    end = one["time_s"][-1]
    for part in range(PARTS):
        until = end * (part + 1) / PARTS if part + 1 < PARTS else np.inf
        execute(case, folder / "parts", comm=MPI.COMM_SELF, resume=part > 0, until=until)
    result = difference(read_history(folder / "parts"), one)
    peak = [np.abs(one["force_N"][one["time_s"] <= share * end]).max() for share in (0.01, 1)]
    print(
        f"{CYCLES} cycles, {len(one['step']) - 1} steps, {seconds:.0f} s in one piece: largest "
        f"difference of {PARTS} parts {result:.1e}; peak force of the first 1 % and of all "
        f"{peak[0]:.6g} and {peak[1]:.6g} N"
    )
    return result


def main() -> int:
    """Run and return the exit code."""
    figures = survive(int(sys.argv[1]) if len(sys.argv) > 1 else KILLS)
    print("== figures", *figures, sep="\n")
    return 0 if all(figure.kept for figure in figures) else 1


if __name__ == "__main__":
    sys.exit(main())
