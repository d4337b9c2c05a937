"""One row in a process of its own: it cannot take the suite down, nor hang it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

from benchmarks.hard.families import row_named
from benchmarks.hard.row import Row
from benchmarks.hard.store import Kept, figures_from
from wovenfab.record.results import this_process
from wovenfab.simulation.progress import peak_memory

#: Longest time of a row (s), whole and quick.
LIMIT, QUICK_LIMIT = 1200.0, 300.0


def work(row: Row, quick: bool) -> Kept:
    """Run a row in a process of its own and return what it gave."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "figures.json"
        command = [sys.executable, "-m", "benchmarks.hard.worker", row.name, str(out)]
        if quick:
            command.append("--quick")
        if row.ranks > 1:
            command = ["mpirun", "-n", str(row.ranks), *command]
        start = time.perf_counter()
        try:
            ended = subprocess.run(
                command,
                capture_output=True,
                text=True,
                check=False,
                timeout=QUICK_LIMIT if quick else LIMIT,
            )
        except subprocess.TimeoutExpired as late:
            return Kept(None, f"no end within {late.timeout:g} s")
        seconds = time.perf_counter() - start
        if not out.exists():
            lines = ended.stderr.strip().splitlines() or [f"exit code {ended.returncode}"]
            return Kept(None, lines[-1], seconds)
        data = json.loads(out.read_text(encoding="utf-8"))
    return Kept(figures_from(data["figures"]), "", seconds, data["memory"], this_process().commit)


def main(name: str, out: str, quick: bool) -> None:
    """Run the row on this process's ranks and leave its figures; collective."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    row = row_named(name)
    figures = (row.small() if quick else row).run()
    from mpi4py import MPI

    if MPI.COMM_WORLD.rank == 0:
        text = json.dumps({"figures": asdict(figures), "memory": peak_memory() / 1e9}, default=dict)
        Path(out).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], "--quick" in sys.argv[3:])
