"""``make unchanged before=REVISION``: all cases give the same histories as with an earlier commit.

``python3 -m benchmarks.unchanged CODE COMMIT`` runs the cases of a copy of that commit with its
code and with this one. Histories of the commit are stored by its name in ``results/unchanged``.
"""

from __future__ import annotations

import os
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wovenfab.record.history import read_history
from wovenfab.record.summary import SUMMARY
from wovenfab.study.runner import Command, execute_all, here

ROOT = Path(__file__).parents[1]
RESULTS = Path("results") / "unchanged"
RANKS = (1, 2)
#: Largest difference of a column over the largest value of its unit.
LIMIT = 1e-9
ITERATIONS = "newton_iterations"

History = Mapping[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Difference:
    """The largest difference of two histories.

    Attributes:
        column: The column that differs most, or what differs in another way.
        size: Difference over the largest value before of all columns of its unit; infinite for
            other ways.
        iterations: Of Newton's method, before and after.
    """

    column: str
    size: float
    iterations: tuple[int, int] = (0, 0)


def difference(before: History, after: History) -> Difference:
    """Return the largest difference of two histories, but for Newton's iterations.

    What vanishes by symmetry is round-off, and compared with what does not: with all columns of
    its unit.
    """
    iterations = _iterations(before), _iterations(after)
    if list(before) != list(after):
        return Difference(f"columns {sorted(set(before) ^ set(after))}", np.inf, iterations)
    rows = [len(history["step"]) for history in (before, after)]
    if rows[0] != rows[1]:
        return Difference(f"{rows[0]} and {rows[1]} rows", np.inf, iterations)
    scales: dict[str, float] = defaultdict(float)
    for name, values in before.items():
        unit = name.rpartition("_")[2]
        scales[unit] = max(scales[unit], float(np.abs(values).max(initial=0.0)))
    sizes = {}
    for name in before.keys() - {ITERATIONS}:
        largest = float(np.abs(before[name] - after[name]).max(initial=0.0))
        sizes[name] = largest / (scales[name.rpartition("_")[2]] or 1.0)
    column = max(sizes, key=lambda name: (sizes[name], name))
    return Difference(column, sizes[column], iterations)


def _iterations(history: History) -> int:
    return int(np.sum(history.get(ITERATIONS, 0)))


def cases_of(code: Path) -> list[Path]:
    """Return the case files of a checkout, those of the paper's figures included."""
    configs = code / "configs"
    return sorted((*configs.glob("*.yaml"), *(configs / "paper").glob("*1x*.yaml")))


def run_all(code: Path, cases: Sequence[Path], folder: Path, ranks: int) -> None:
    """Run cases by the code of a checkout unless their results are there.

    Args:
        code: The checkout.
        cases: Case files.
        folder: Where each gets a results directory of its name.
        ranks: MPI ranks.

    Raises:
        RuntimeError: A run has left no results.
    """
    folder.mkdir(parents=True, exist_ok=True)
    directories = {folder.resolve() / _name(case): case.resolve() for case in cases}
    left = {d: case for d, case in directories.items() if not (d / SUMMARY).is_file()}
    commands = []
    for directory, case in left.items():
        arguments = ["-m", "wovenfab", "run", str(case), "-o", str(directory), "--overwrite"]
        arguments += ["--set", "output.pictures=false"]
        environment = {"PYTHONPATH": str(code.resolve())}
        commands.append(Command(arguments, ranks, environment=environment, folder=code))
    print(f"{len(commands)} runs of {code} on {ranks} ranks", flush=True)
    failures = {}
    execute_all(
        commands,
        here(max((os.cpu_count() or 1) // ranks, 1)),
        on_end=lambda index, ended: failures.update({list(left)[index]: ended.failure}),
    )
    for directory, failure in failures.items():  # a run that stops early has results, too
        if not (directory / SUMMARY).is_file():
            raise RuntimeError(f"{directory.name}: {failure}")


def _name(case: Path) -> str:
    return case.stem if case.parent.name == "configs" else f"{case.parent.name}-{case.stem}"


def compare(
    code: Path, commit: str, cases: Sequence[Path], ranks: Sequence[int] = RANKS
) -> dict[str, Difference]:
    """Return the largest difference of each case on each number of ranks.

    Args:
        code: A copy of the commit.
        commit: Its name.
        cases: Its case files.
        ranks: Numbers of ranks.
    """
    differences = {}
    for count in ranks:
        before, after = (RESULTS / name / str(count) for name in (commit, "now"))
        for case in cases:
            (after / _name(case) / SUMMARY).unlink(missing_ok=True)
        run_all(code, cases, before, count)
        run_all(ROOT, cases, after, count)
        for case in cases:
            pair = (read_history(folder / _name(case)) for folder in (before, after))
            differences[f"{_name(case)} | {count}"] = difference(*pair)
    return differences


def main(code: str, commit: str) -> int:
    """Print the differences as a table; return 1 where one is beyond the limit."""
    differences = compare(Path(code), commit, cases_of(Path(code)))
    print("| case | ranks | largest difference | column | iterations before | now |")
    print("|---|---:|---:|---|---:|---:|")
    for name, largest in differences.items():
        mark = "" if largest.size <= LIMIT else "  **changed**"
        before, now = largest.iterations
        print(f"| {name} | {largest.size:.1e} | {largest.column}{mark} | {before} | {now} |")
    changed = sum(d.size > LIMIT for d in differences.values())
    print(f"\n{changed} of {len(differences)} histories have changed since {commit}")
    return 1 if changed else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:3]))
