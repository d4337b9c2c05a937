"""How large the project is, against the sizes it keeps: ``make size``."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PICTURES = {".png", ".gif", ".svg", ".jpg"}
#: Runs the command line, and prints at the end how many of the project's files it imported.
COUNTING = """\
import atexit, sys
ours = lambda: [m for n, m in sys.modules.items() if n.partition(".")[0] in ("forms", "wovenfab")]
atexit.register(lambda: print("files:", sum(bool(getattr(m, "__file__", None)) for m in ours())))
from wovenfab.cli.app import main
sys.argv[0] = "wovenfab"
main()
"""
#: The default case, coarse and short.
SHORT = (
    "program.amplitudes=10 mm",
    "discretisation={degree: 2, mesh_size: 150 mm}",
    "time.steps_per_cycle=4",
)


@dataclass(frozen=True)
class Size:
    """One count and the most that it may be."""

    name: str
    value: int
    most: int

    def __str__(self) -> str:
        """Return one line of the table."""
        return f"{self.name:45} {self.value:9} {self.most:9}{'  *' * (self.value > self.most)}"


def sizes_of_files() -> list[Size]:
    """Return the sizes of code, tests and documents."""
    installed = [_lines(p) for top in ("forms", "wovenfab") for p in (ROOT / top).rglob("*.py")]
    tests = sum(_lines(path) for path in (ROOT / "tests").rglob("*.py"))
    docs = [p.stat().st_size for p in (ROOT / "docs").rglob("*") if p.suffix in PICTURES]
    return [
        Size("lines installed (forms, wovenfab)", sum(installed), 19500),
        Size("lines of tests", tests, 11500),
        Size("bytes of pictures in docs", sum(docs), 3_000_000),
    ]


def size_of_imports() -> Size:
    """Return how many of the installed modules a plain run imports, by a short run."""
    with tempfile.TemporaryDirectory() as folder:
        changes = [word for change in SHORT for word in ("--set", change)]
        case = ROOT / "configs" / "bias-1x3.yaml"
        run = subprocess.run(
            [sys.executable, "-c", COUNTING, "run", case, "-o", f"{folder}/run", *changes],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
    count = run.stdout.rpartition("files: ")[2]
    return Size("files that wovenfab run imports", int(count), 70)


def _lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


if __name__ == "__main__":
    sizes = [*sizes_of_files(), size_of_imports()]
    print(f"{'':45} {'is':>9} {'at most':>9}", *sizes, sep="\n")
    sys.exit(any(size.value > size.most for size in sizes))
