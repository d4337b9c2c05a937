"""``python -m benchmarks.true_errors RESULTS...``: errors that runs state, against finer answers.

A run for an accuracy is compared with one of cells of 0.6 times the size, of another degree and of
shorter steps.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

import wovenfab
from wovenfab.case import read_case
from wovenfab.record.history import peak_force
from wovenfab.record.results import markdown
from wovenfab.study.accuracy import finer_case, percent
from wovenfab.study.cluster import CASE
from wovenfab.study.response import name_of


def values(run: wovenfab.Run) -> dict[str, float | None]:
    """Return what an accuracy may judge, by name, SI."""
    found = {name_of(t, n): value for t, of in run.figures.items() for n, value in of.items()}
    travel = peak_force(run.history["displacement_m"])
    return {**run.summary, "peak_displacement_m": travel, **found}


def table(stated: Mapping[str, float | None], own: Mapping, exact: Mapping) -> str:
    """Return a row for each figure: its value, the stated error and the true one."""
    rows = [
        [
            name,
            f"{own[name]:.6g}",
            "not known" if error is None else percent(error),
            percent(abs(own[name] / exact[name] - 1)) if exact.get(name) else "",
        ]
        for name, error in stated.items()
    ]
    return markdown(["figure", "value (SI)", "stated", "true"], rows, (0,))


def main(folder: Path) -> None:
    """Print the errors of the run of a results directory."""
    run = wovenfab.read_results(folder)
    case = read_case(folder / CASE, {"output.pictures": False})
    finer = finer_case(case)
    stated = {n: f["relative_error"] for n, f in run.summary["accuracy"]["figures"].items()}
    d = finer.discretisation
    print(f"{folder}, against degree {d.degree}, {d.mesh_size} m, {finer.planned_steps} steps:\n")
    print(table(stated, values(run), values(wovenfab.simulate(finer))), flush=True)


if __name__ == "__main__":
    for given in sys.argv[1:]:
        main(Path(given))
