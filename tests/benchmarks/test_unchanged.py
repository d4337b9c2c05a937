"""Histories of two versions of the code are compared column by column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import unchanged
from benchmarks.unchanged import ROOT, cases_of, compare, difference

HISTORY = {
    "step": np.arange(3.0),
    "force_N": np.array([0.0, 50.0, -200.0]),
    "force_transverse_N": np.array([0.0, 1e-9, 0.0]),  # vanishes by symmetry
    "newton_iterations": np.array([0.0, 3.0, 4.0]),
}


@pytest.mark.parametrize(
    ("change", "column", "size"),
    [
        ({}, "step", 0.0),
        ({"newton_iterations": np.array([0.0, 2.0, 4.0])}, "step", 0.0),
        ({"force_transverse_N": np.array([0.0, -1e-9, 0.0])}, "force_transverse_N", 1e-11),
        ({"force_N": np.array([2e-6, 50.0, -200.0])}, "force_N", 1e-8),
        ({"work_J": np.zeros(3)}, "columns ['work_J']", np.inf),
        ({name: values[:2] for name, values in HISTORY.items()}, "3 and 2 rows", np.inf),
    ],
)
def test_the_largest_difference_is_relative_to_the_largest_value_of_its_unit(
    change: dict[str, np.ndarray], column: str, size: float
) -> None:
    largest = difference(HISTORY, {**HISTORY, **change})
    assert largest.column == column
    assert largest.size == pytest.approx(size)


@pytest.mark.slow
def test_the_same_code_gives_the_same_history_and_stored_ones_are_not_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unchanged, "RESULTS", tmp_path / "results")
    configs = tmp_path / "configs"
    configs.mkdir()
    pull = "program: {type: ramp, to: 1 mm, steps: 1}\ndiscretisation: {mesh_size: 300 mm}\n"
    (configs / "small.yaml").write_text(f"from: {ROOT}/configs/bonded-1x3.yaml\n{pull}")
    (case,) = cases_of(tmp_path)
    for _ in range(2):
        assert compare(ROOT, "abc", [case], ranks=(1,))["small | 1"].size == 0.0
    times = [
        (tmp_path / "results" / name / "1" / "small" / "history.csv").stat().st_mtime
        for name in ("abc", "now")
    ]
    assert times[1] > times[0]
