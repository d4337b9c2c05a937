from math import nan
from pathlib import Path

import numpy as np
import pytest

from wovenfab.record.summary import read_summary, summarise, versions, write_summary

HISTORY = {
    "step": np.arange(5.0),
    "time_s": np.linspace(0, 1, 5),
    "displacement_m": np.array([0.0, 0.01, 0.02, 0.01, 0.0]),
    "force_N": np.array([0.0, 100.0, 250.0, -300.0, -10.0]),
    "energy_J": np.array([0.0, 1.0, 3.0, 2.0, 0.4]),
    "dissipated_J": np.array([0.0, 1.0, 2.0, 3.0, 4.0]),
    "work_J": np.array([0.0, 2.0, 5.0, 5.0, 4.5]),
    "imbalance_J": np.array([0.0, 0.01, -0.2, 0.1, 0.0]),
    "newton_iterations": np.array([0.0, 3.0, 5.0, 4.0, 4.0]),
    "negative_eigenvalues": np.array([0.0, 0.0, 1.0, 2.0, 0.0]),
}


def summary(history: dict[str, np.ndarray] = HISTORY) -> dict:
    return summarise(
        history,
        [(0.0, 1.0)],
        outcome="finished",
        unknowns=1234,
        cut_backs=2,
        seconds={"solve": np.float64(1.5)},
        ranks=2,
        losses=[{"time_s": 0.25, "negative_eigenvalues": 1}],
    )


def test_the_summary_comes_back_as_it_was_made(tmp_path: Path) -> None:
    write_summary(tmp_path, summary())
    assert read_summary(tmp_path) == summary()


def test_the_figures_are_those_of_the_history() -> None:
    made = summary()
    assert (made["peak_force_N"], made["peak_force_at_m"]) == (-300.0, 0.01)
    assert made["newton_iterations"] == {"total": 16, "mean": 4.0, "worst": 5}
    assert (made["steps"], made["dissipated_J"], made["worst_imbalance_J"]) == (4, 4.0, 0.2)
    assert made["saddles"] == 2
    assert made["losses_of_stability"] == [{"time_s": 0.25, "negative_eigenvalues": 1}]
    assert [cycle["dissipated_J"] for cycle in made["cycles"]] == [4.0]


@pytest.mark.parametrize("rows", [0, 1])
def test_a_run_that_failed_at_once_has_a_summary(tmp_path: Path, rows: int) -> None:
    made = summary({name: values[:rows] for name, values in HISTORY.items()})
    write_summary(tmp_path, made)
    assert read_summary(tmp_path)["cycles"] == []


def test_a_number_that_is_not_finite_leaves_the_old_summary(tmp_path: Path) -> None:
    write_summary(tmp_path, {"outcome": "finished"})
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_summary(tmp_path, {"peak": np.float64(nan)})
    assert read_summary(tmp_path) == {"outcome": "finished"}


def test_the_versions_of_the_packages_are_known() -> None:
    found = versions()
    assert found["dolfinx"][0].isdigit()
    assert found["petsc"].count(".") == 2
