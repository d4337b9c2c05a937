"""Steps that are chosen for an accuracy: their true errors, and the tangents that they take.

The scenes are those of ``make random`` whose steps have an error, on the coarse elements on which
steps are tried, so that elements play no part.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from mpi4py import MPI

from benchmarks.figure import Figure
from benchmarks.random_scenes import SEED, scene
from wovenfab.case import Case, read_case
from wovenfab.case.objects import sheet_of
from wovenfab.sheet.sheet import Sheet
from wovenfab.study.errors.choice import base_case, coarsest
from wovenfab.study.errors.step_search import StepSearch, equal_steps
from wovenfab.study.response import depends_on_steps, response_of, trial_of

SCENES = (1, 3, 4, 7, 9, 13, 15, 16, 20, 21, 22, 25)
ACCURACIES = (0.01, 0.0025, 0.0008)
#: Equal steps of the reference over the usual number.
FINER = 16.0
#: Error over what is asked that counts as too large: a reference is not exact.
TOO_LARGE = 1.1


def step_choice() -> list[Figure]:
    """Return how many errors are too large, and the tangents of the chosen steps and of trials."""
    wrong = chosen = tried = 0
    for number, case, sheet in _trials():
        exact = response_of(equal_steps(case, FINER), sheet).figures
        for accuracy in ACCURACIES:
            lines: list[str] = []
            steps = StepSearch(case, MPI.COMM_SELF, lines.append).steps_for(accuracy)
            assert steps is not None
            made = response_of(steps.of(case), sheet)
            errors = (abs(made.figures[n] / value - 1) for n, value in exact.items() if value)
            share, tangents = max(errors) / accuracy, made.outcome.iterations
            said = steps.estimated_error / accuracy
            print(
                f"scene {number}, {100 * accuracy:g} %: {made.count} {steps.words}, "
                f"{tangents} tangents; error {share:.2f} of that, {said:.2f} expected",
                flush=True,
            )
            wrong += share > TOO_LARGE or said > TOO_LARGE
            chosen += tangents
            tried += sum(int(line.split()[-2]) for line in lines)
    count = len(SCENES) * len(ACCURACIES)
    note = f"{count} searches on coarse elements"
    return [
        Figure("steps whose error is too large", wrong, 0, "", f"of {count}"),
        Figure("tangents of the chosen steps", chosen, 2250, "", note),
        Figure("tangents of their trials", tried, 7500, "", note),
    ]


def _trials() -> Iterator[tuple[int, Case, Sheet]]:
    """Yield the scenes as steps are tried on them."""
    with tempfile.TemporaryDirectory() as folder:
        for number in SCENES:
            case = base_case(read_case(scene(number, SEED, Path(folder))))
            assert depends_on_steps(case)
            coarse = coarsest(case, sheet_of(case, MPI.COMM_SELF))
            trial = trial_of(coarse, ACCURACIES[1])
            yield number, trial, sheet_of(trial, MPI.COMM_SELF)
