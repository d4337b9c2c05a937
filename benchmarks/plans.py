"""Elements and steps that are chosen for an accuracy: the work of choosing them and of their runs.

The scenes are some of those of ``make random``. Work is that of tangents, the same everywhere.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from unittest.mock import patch

from mpi4py import MPI

from benchmarks.figure import Figure
from benchmarks.random_scenes import SEED, scene
from wovenfab.case import read_case
from wovenfab.study.errors.choice import plan
from wovenfab.study.response import Budget, work

SCENES = (3, 6, 7, 9, 22, 25, 52)
#: Tangents of a step, about.
TANGENTS = 3


def plans() -> list[Figure]:
    """Return how many plans fall short, the work of their trials, and about that of their runs."""
    spent, short, tried, runs = list[float](), 0, 0.0, 0.0
    spend = Budget.spend

    def note(budget: Budget, tangents: int, unknowns: int) -> None:
        spent.append(tangents * work(unknowns))
        spend(budget, tangents, unknowns)

    with tempfile.TemporaryDirectory() as folder, patch.object(Budget, "spend", note):
        for number in SCENES:
            spent.clear()
            case = read_case(scene(number, SEED, Path(folder)))
            found = plan(case, MPI.COMM_SELF, lambda line: None)
            assert found.estimate is not None
            unknowns, steps = found.estimate.response.model.unknowns, found.case.planned_steps
            run = TANGENTS * steps * work(unknowns)
            print(
                f"scene {number}: {unknowns} unknowns, {steps} steps, work {sum(spent):.0f} and "
                f"{run:.0f}; error {100 * found.estimate.worst:.2g} % expected",
                flush=True,
            )
            short += bool(found.shortfall)
            tried += sum(spent)
            runs += run
    of = f"of {len(SCENES)} random fabrics for 1 %"
    return [
        Figure("plans that fall short", short, 0, "", of),
        Figure("work of their trials", tried, 480, "", f"{of}; 1 is a tangent of 10 000 unknowns"),
        Figure("work of their runs", runs, 168, "", f"{of}, {TANGENTS} tangents a step"),
    ]
