"""Small scenes drawn at random reach their accuracy, and their stated errors are honest."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.random_scenes import MORE, scene
from tests.study.test_estimate import ALONE, sheet
from wovenfab.case import read_case
from wovenfab.study.accuracy import FIGURES, finer_case
from wovenfab.study.errors.choice import plan
from wovenfab.study.response import response_of

pytestmark = pytest.mark.slow

ACCURACY = 0.03
#: Seeds and numbers. On coarse cells of 7-19 degrees 4 and 5 agree on a loss that is too large.
SCENES = [*((1, n) for n in (3, 10, 15, 24, 32, 36, 37, 39, 47, 49, 51, 62)), (7, 19)]
#: True error over the stated one, which is an estimate, besides the 0.1 % of the benchmark.
ESTIMATE = 1.25


@pytest.mark.parametrize(("seed", "number"), SCENES)
def test_an_accuracy_is_reached_and_the_stated_error_is_honest(
    seed: int, number: int, tmp_path: Path
) -> None:
    case = read_case(scene(number, seed, tmp_path, ACCURACY))
    chosen = plan(case, ALONE, lambda text: None)
    assert not chosen.shortfall and chosen.estimate is not None
    resolved = tmp_path / "case.yaml"
    resolved.write_text(chosen.case.to_yaml(), encoding="utf-8")
    finer = finer_case(read_case(resolved))
    found = response_of(chosen.case, chosen.sheet).figures
    exact = response_of(finer, sheet(finer)).figures
    true = max(abs(found[f] / exact[f] - 1) for f in FIGURES if exact[f])
    stated = chosen.estimate.worst
    print(f"\n{case.title}: stated {stated:.2%}, true {true:.2%}")
    assert true <= ACCURACY
    assert true <= ESTIMATE * stated + MORE / 100
