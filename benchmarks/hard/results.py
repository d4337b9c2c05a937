"""Results of rows: each is run in a process of its own and stored.

``python -m benchmarks.hard.results ROW [--quick]`` runs a row and prints a line of JSON.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.hard.families import row_named
from benchmarks.hard.measurement import FOLDER
from benchmarks.hard.row import Figures, Row
from wovenfab.case.fingerprint import code
from wovenfab.record.results import this_process
from wovenfab.simulation.progress import peak_memory
from wovenfab.study.runner import Command, execute

ROOT = Path(__file__).parents[2]
_HARD = Path(__file__).parent
#: Code besides wovenfab's that decides the figures; pages and pictures do not.
SOURCES = (
    _HARD / "families",
    *sorted(p for p in _HARD.glob("*.py") if p.name not in ("__main__.py", "page.py")),
    ROOT / "wovenfab" / "cli",
)
#: Longest time of a row (s), full and quick.
LIMIT, QUICK_LIMIT = 1200.0, 300.0


@dataclass(frozen=True)
class Result:
    """The result of a row.

    Attributes:
        figures: Its figures, or None where it failed.
        failure: Why it failed.
        seconds: Wall time, start of the process included.
        memory: Largest resident memory of a rank, GB.
        commit: Commit of the code.
    """

    figures: Figures | None
    failure: str = ""
    seconds: float = 0.0
    memory: float = 0.0
    commit: str = ""

    @staticmethod
    def of(data: Mapping[str, Any] | None) -> Result | None:
        """Return a result from its JSON data."""
        if data is None:
            return None
        figures = None if data["figures"] is None else Figures(**data["figures"])
        return Result(**{**data, "figures": figures})


def row_fingerprint(row: Row) -> str:
    """Return what the figures of a row depend on: code, case files and changes.

    The case is not read: some rows add an effect of their own only when they are run.
    """
    setting = row.setting
    files = [p for folder in ("configs", "meshes") for p in (ROOT / folder).glob("*.*")]
    texts = [code(*SOURCES), setting.base, *setting.overrides]
    texts += [path.read_text(encoding="utf-8") for path in sorted(files)]
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:16]


def run_row(row: Row, quick: bool) -> Result:
    """Run a row in a process of its own; if this one is killed, the next call goes on."""
    arguments = ["-m", "benchmarks.hard.results", row.name, *(["--quick"] if quick else [])]
    limit = QUICK_LIMIT if quick else LIMIT
    parts = ROOT / "results" / "hard" / "parts" / f"{row.name}-{row_fingerprint(row)}"
    more = {FOLDER: str(parts)}
    command = Command(arguments, ranks=row.ranks, limit=limit, environment=more, folder=ROOT)
    ended = execute(command)
    shutil.rmtree(parts, ignore_errors=True)
    if ended.failure:
        return Result(None, ended.failure, ended.seconds)
    data, commit = ended.result, this_process().commit
    return Result(Figures(**data["figures"]), "", ended.seconds, data["memory"], commit)


def main(name: str, quick: bool) -> None:
    """Run the row on this process's ranks and print its figures; collective."""
    row = row_named(name)
    figures = (row.small() if quick else row).run()
    from mpi4py import MPI

    if MPI.COMM_WORLD.rank == 0:
        data = {"figures": asdict(figures), "memory": peak_memory() / 1e9}
        print(json.dumps(data, default=dict))


if __name__ == "__main__":
    main(sys.argv[1], "--quick" in sys.argv[2:])
