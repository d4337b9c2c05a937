"""Measured rows beside computed curves: all that can be compared, and nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.study.test_fit import place
from wovenfab.measured.curve import Measured
from wovenfab.study.fit.fit_file import read_fit
from wovenfab.study.fit.objective import Objective
from wovenfab.study.fit.response import BranchError, ResponseCurve, compared, curve_of_history
from wovenfab.study.fit.search import search_with_slack

Array = NDArray[np.float64]
#: A loop with a jump of friction at the reversal: few steps, and a kink in each branch.
STEPS = np.array([0.0, 0.002, 0.01, 0.02, 0.018, 0.01, 0.0])
FORCES = np.array([0.0, 0.8, 1.4, 2.2, 0.6, 0.1, -0.6])


def measured(displacement: Array, force: Array) -> Measured:
    return Measured(Path("curve.csv"), displacement, force)


def along(rows: int) -> tuple[Array, Array]:
    """Return points on the straight lines between the steps, so many on each."""
    at = np.linspace(0, len(STEPS) - 1, rows * (len(STEPS) - 1) + 1)
    steps = np.arange(len(STEPS))
    return np.interp(at, steps, STEPS), np.interp(at, steps, FORCES)


@pytest.mark.parametrize("rows", [1, 7, 500])
def test_points_on_the_drawn_lines_have_no_distance(rows: int) -> None:
    found = compared(measured(*along(rows)), curve_of_history(STEPS, FORCES))
    assert np.abs(found.shares).max() < 1e-12
    assert found.rows.size == 6 * rows + 1 and found.left_out == ""


def test_rows_that_the_program_does_not_reach_are_counted() -> None:
    u = np.linspace(0, 0.03, 31)
    found = compared(measured(u, 50 * u), curve_of_history(u[:21], 50 * u[:21]))
    assert (found.rows.size, found.beyond) == (21, 10)
    assert "21 of 31 rows are compared, 10 lie beyond" in found.left_out
    assert "0 to 20 mm" in found.left_out
    with_toe = compared(measured(u, 50 * u), curve_of_history(u[:21], 50 * u[:21]), toe=0.0095)
    assert (with_toe.rows.size, with_toe.beyond) == (11, 10)


def test_slack_takes_rows_away_at_one_end_and_gives_others_at_the_other() -> None:
    u = np.linspace(0, 0.02, 41)
    slack, spring = 0.8e-3, 1e-4
    curve = ResponseCurve(u, 50 * u, 0 * u, np.zeros((41, 0)), (0, 40), 0.0)
    x = np.linspace(0, 0.022, 2201)
    force = 50 * (x - slack) / (1 + 50 * spring)  # of a spring in series with the sample
    machine = {"machine.displacement": slack, "machine.compliance": spring}
    found = compared(measured(x, force), curve, values=machine, reference=machine)
    reached = (force >= -1e-12) & (force <= 1 + 1e-12)
    margin = 2 + int(2 * 1e-3 * 0.02 / 1e-5)
    assert abs(found.rows.size - reached.sum()) <= margin
    assert abs(found.rows[0] - np.flatnonzero(reached)[0]) <= margin
    assert np.abs(found.computed - found.measured)[margin:-margin].max() < 1e-9
    without = compared(measured(x, force), curve, values=machine)
    assert without.rows[-1] < found.rows[-1] - 80


@pytest.mark.parametrize(
    ("u", "force", "remedy"),
    [(1, -1, "force: -1 N"), (-1, 1, "force: -1 N"), (-1, -1, "displacement: -1 mm")],
)
def test_reversed_signs_are_told_with_the_remedy(u: int, force: int, remedy: str) -> None:
    points, forces = along(5)
    with pytest.raises(BranchError) as caught:
        compared(measured(u * points, force * forces), curve_of_history(STEPS, FORCES))
    assert remedy in str(caught.value)


def test_displacements_from_another_zero_are_told_with_both_ranges() -> None:
    points, forces = along(5)
    with pytest.raises(BranchError, match="230 to 250 mm are measured, the program goes from 0 to"):
        compared(measured(points + 0.23, forces), curve_of_history(STEPS, FORCES))


def test_a_run_that_has_not_moved_is_told() -> None:
    with pytest.raises(BranchError, match="not moved"):
        compared(measured(*along(5)), curve_of_history(np.zeros(1), np.zeros(1)))


def test_the_search_goes_on_with_the_rows_that_slack_makes_comparable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slack, stiffness = 0.8e-3, 83.0
    u = np.linspace(0, 0.06, 31)

    def curves(
        objective: Objective, values: Mapping[str, float], scale: float
    ) -> Sequence[ResponseCurve]:  # of a spring that hardens, in place of a run
        force = values["shear.stiffness"] * (u + 40 * u**2)
        slopes = (force / values["shear.stiffness"])[:, None]
        return [ResponseCurve(u, force, 0 * u, slopes, (0, 30), 1e-3)]

    monkeypatch.setattr(Objective, "_curves", curves)
    x = np.linspace(0, 0.062, 311)
    free = np.maximum(x - slack, 0.0)
    rows = zip(1e3 * x, stiffness * (free + 40 * free**2), strict=True)
    text = "u_mm,F_N\n" + "".join(f"{a:.6f},{b:.9f}\n" for a, b in rows)
    parameters = "  shear.stiffness:\n  machine.displacement: {bounds: [-2 mm, 2 mm]}\n"
    head = "refine: false\ntests:\n  - {case: case.yaml, measured: curve.csv, error: 0.2 %}\n"
    fit = read_fit(place(tmp_path, f"{head}parameters:\n{parameters}", curve=text))
    with Objective(fit, tmp_path / "runs") as objective:
        found = search_with_slack(objective, fit)
    (comparison,) = found.evaluation.comparisons
    assert found.values["machine.displacement"] == pytest.approx(slack, rel=1e-3)
    assert found.values["shear.stiffness"] == pytest.approx(stiffness, rel=1e-3)
    compared_x = x[comparison.rows]
    assert compared_x[0] == pytest.approx(slack, abs=3e-4)
    assert compared_x[-1] == pytest.approx(0.06 + slack, abs=3e-4)
    assert len({(t.scale, *t.values.values()) for t in found.trials}) == len(found.trials)
