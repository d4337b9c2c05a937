"""From an empty kernel cache to the first converged step of the default case."""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks.figure import Figure
from wovenfab.record.summary import read_summary
from wovenfab.study.runner import Command, execute

CASE = Path(__file__).parents[1] / "configs" / "bias-1x3.yaml"
#: One small step of the default case: the same kernels, hence the same compilation.
ONE_STEP = "program={type: ramp, to: 0.03 mm, steps: 1, duration: 1.6 ms}"
#: Longest cold start that is accepted (s).
LIMIT = 15.0
MEANING = "from the command to the end of one step, nothing compiled beforehand"


def cold_start() -> list[Figure]:
    """Print the phases of a cold and of a warm start; return the cold ones."""
    print("Cold start: empty kernel cache to the first converged step of configs/bias-1x3.yaml")
    print("ranks  cache  import   mesh    JIT  1st step    all")
    figures = []
    for ranks in (1, 2):
        with tempfile.TemporaryDirectory() as cache:
            for state in ("empty", "warm"):
                whole, phases = _start(ranks, Path(cache))
                print(
                    f"{ranks:>5} {state:>6} {phases['import']:7.2f} {phases['mesh']:6.2f} "
                    f"{phases['compile']:6.2f} {phases['first step']:9.2f} {whole:6.2f}  s"
                )
                if state == "empty":
                    name = f"cold start, {ranks} rank{'s' * (ranks > 1)}"
                    figures.append(Figure(name, whole, LIMIT, "s", MEANING))
    return figures


def _start(ranks: int, cache: Path) -> tuple[float, dict[str, float]]:
    """Return the wall time (s) of a one-step run, process start included, and its phases."""
    with tempfile.TemporaryDirectory() as results:
        arguments = ["-m", "wovenfab", "run", str(CASE), "-o", f"{results}/run"]
        arguments += ["--set", ONE_STEP, "--set", "output.pictures=false"]
        ended = execute(Command(arguments, ranks, environment={"XDG_CACHE_HOME": str(cache)}))
        if ended.failure:
            raise RuntimeError(ended.failure)
        return ended.seconds, read_summary(f"{results}/run")["wall_time_s"]
