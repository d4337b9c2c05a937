"""How busy a sweep on a cluster keeps the processors: forty members, a Dask worker a processor."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from benchmarks.figure import Figure

type Process = subprocess.Popen[bytes]
ROOT = Path(__file__).parents[1]
CASE = ROOT / "configs" / "bias-1x3.yaml"
MEMBERS = 40
#: Seconds in which a scheduler starts, and a sweep ends.
START, END = 60.0, 3600.0


def busy() -> list[Figure]:
    """Return the share of the time in which processors worked, from the first second to the last.

    All that the machine does counts, so that the share means something on a quiet one only.
    """
    workers = len(os.sched_getaffinity(0))
    slopes = ", ".join(f"{60 + i / 2:g}" for i in range(MEMBERS))
    with tempfile.TemporaryDirectory() as name, dask_cluster(Path(name), workers) as (address, *_):
        before, start = _working(), time.monotonic()
        subprocess.run(
            [sys.executable, "-m", "wovenfab", "sweep", str(CASE), "-o", f"{name}/out",
             "--over", f"effects.slip_friction.slope={slopes} s/m",
             "--set", "output.pictures=false", "--cluster", address],
            check=True, timeout=END,
        )  # fmt: skip
        seconds = time.monotonic() - start
        share = (_working() - before) / (seconds * workers)
        finished = (Path(name) / "out" / "sweep.csv").read_text().count("finished")
    return [
        Figure("members that finished", finished, MEMBERS, "", f"of {MEMBERS}", at_least=True),
        Figure(
            "processors busy during a sweep", 100 * share, 95.0, "%",
            f"{MEMBERS} members on {workers} workers of one processor each, {seconds:.0f} s",
            at_least=True,
        ),
    ]  # fmt: skip


@contextmanager
def dask_cluster(folder: Path, workers: int) -> Iterator[tuple[str, list[Process], Process]]:
    """Yield the address of a scheduler, its workers of one thread each, and the scheduler.

    Each has a folder of its own in ``folder``; nothing of them is left at the end.
    """
    file, until = folder / "scheduler.json", time.monotonic() + START
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with ExitStack() as stack:

        def started(name: str, command: str, *options: str) -> Process:
            own = folder / name
            own.mkdir()
            words = [sys.executable, "-m", f"distributed.cli.{command}", "--no-dashboard"]
            environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(own)}
            running = subprocess.Popen([*words, *options], cwd=own, env=environment, **quiet)
            stack.enter_context(running)
            stack.callback(running.kill)
            return running

        listen = ("--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
        scheduler = started("scheduler", "dask_scheduler", *listen)
        while not file.exists() and time.monotonic() < until:
            time.sleep(0.1)
        address = str(json.loads(file.read_text(encoding="utf-8"))["address"])
        options = (address, "--nthreads", "1", "--no-nanny")
        names = [f"worker-{number}" for number in range(workers)]
        yield address, [started(name, "dask_worker", *options) for name in names], scheduler


def _working() -> float:
    """Return the time that all processors have worked since the machine started, s."""
    user, nice, system, _, _, interrupts, soft, *_ = map(
        int, Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()[1:]
    )
    return (user + nice + system + interrupts + soft) / os.sysconf("SC_CLK_TCK")
