"""A study of accuracy finds the true errors of cases whose exact answers are known."""

from __future__ import annotations

import re
from dataclasses import replace
from math import sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

import wovenfab
from benchmarks.accuracy_page import ROOT, STUDIES, Shown
from benchmarks.random_scenes import MORE
from tests.benchmarks.test_small_random_scenes import ESTIMATE
from tests.cli.test_commands import rows
from tests.verification.test_closed_forms import SLOPE, SOFT, SPIN, STIFF, bias_pull
from wovenfab.case import CaseError, read_case
from wovenfab.cli.studies import study_accuracy
from wovenfab.record.summary import read_summary
from wovenfab.study.accuracy import (
    ACCURACIES,
    DEGREES,
    DOUBT,
    Priced,
    Study,
    doubled,
    finer_case,
    for_accuracies,
)
from wovenfab.study.variations import folder_of_run

#: A strip along its yarns whose stiffness varies: springs in series.
SPRINGS = """
sheet: {length: 1 m, width: 0.5 m, fibres: [0 deg, 90 deg]}
effects:
  stretch: {stiffness: 1e5 N/m * (1 + 0.9*sin(7*x/1 m))}
  shear: {stiffness: 400 N/m}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 1 mm, steps: 1}
"""
#: A homogeneous pull with spin friction: an ordinary differential equation.
PULL = f"""
sheet: {{length: 1 m, width: 1 m, fibres: [45 deg, -45 deg]}}
effects:
  stretch: {{stiffness: {STIFF} N/m}}
  shear: {{stiffness: {SOFT} N/m}}
  spin_friction: {{strength: {SPIN} N/m, slope: {SLOPE} s}}
boundary:
  left: {{displacement: [0, free]}}
  bottom: {{displacement: [free, 0]}}
  right: {{displacement: [program, free]}}
program: {{type: cycles, amplitudes: '150, 300 mm', frequency: 0.5 Hz}}
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "case.yaml"
    path.write_text(text)
    return path


def spring_force() -> dict[str, float]:
    compliance = quad(lambda x: 1 / (1e5 * (1 + 0.9 * sin(7 * x))), 0, 1, epsabs=1e-16, limit=200)
    return {"peak_force_N": 0.5 * 1e-3 / compliance[0]}


def pull_figures() -> dict[str, float]:
    times = np.linspace(0, 2, 4001)
    y, force = bias_pull(0.3, 2.0, times)
    x = 1 + 0.15 * (1 - np.cos(np.pi * times))
    size, skew = sqrt((x[-1] ** 2 + y[-1] ** 2) / 2), (x[-1] / y[-1] - y[-1] / x[-1]) / 2
    stored = STIFF * (size - 1) ** 2 + SOFT * skew**2 / 2
    return {
        "peak_force_N": float(force[np.abs(force).argmax()]),
        "dissipated_J": float(np.trapezoid(force, x)) - stored,
    }


@pytest.mark.parametrize(
    ("text", "exact", "levels"),
    [
        pytest.param(SPRINGS, spring_force, 1, id="elements", marks=pytest.mark.slow),
        pytest.param(SPRINGS, spring_force, 3, id="smaller elements", marks=pytest.mark.slow),
        pytest.param(PULL, pull_figures, 2, id="steps", marks=pytest.mark.slow),
    ],
)
def test_errors_are_the_true_ones_and_stated_ones_are_honest(
    text: str, exact: Any, levels: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path, output = written(tmp_path, text), tmp_path / "study"
    assert study_accuracy(path, output, (), levels) == 0
    printed = capfd.readouterr().out
    found = rows(output, "accuracy")
    print(printed)
    assert len(found) == levels * len(DEGREES) + levels
    known = exact()
    for name, true in known.items():
        finest = read_summary(next((output / "finer").glob("*/")))[name]
        doubt = float(re.findall(r"to about ([\d.e-]+) %", printed)[0]) / 100
        assert abs(finest / true - 1) <= doubt
        for row in found:
            summary = read_summary(output / "runs" / folder_of_run(row["run"]))
            wrong = abs(summary[name] / true - 1)
            assert float(row[f"error_of_{name}"]) == pytest.approx(wrong, abs=doubt)
            if row["stated_error"]:
                assert wrong <= ESTIMATE * float(row["stated_error"]) + MORE / 100
    assert (output / "accuracy.png").stat().st_size > 10_000
    # What is there is not run again.
    assert study_accuracy(path, output, (), levels) == 0
    assert f"{len(found)} of {len(found)} runs were there already" in capfd.readouterr().out
    assert rows(output, "accuracy") == found


def stated(path: Path, *overrides: str) -> dict[str, dict[str, float]]:
    """Return the figures of a run for an accuracy, with their errors."""
    said = wovenfab.simulate(read_case(path, overrides)).summary["accuracy"]
    assert not said["shortfall"]
    return said["figures"]


@pytest.mark.slow
def test_the_displacement_under_a_force_has_the_error_of_the_force_under_a_displacement(
    tmp_path: Path,
) -> None:
    """So it is with springs, which are linear."""
    path = written(tmp_path, SPRINGS)
    (moved,) = stated(path, "accuracy=5 %").values()
    loaded = stated(path, "accuracy=5 %", "program={type: ramp, to: 25 N, steps: 1}")
    answer = loaded.pop("peak_displacement_m")
    assert not loaded
    assert answer["relative_error"] == pytest.approx(moved["relative_error"], rel=0.01)
    wrong = abs(answer["value"] / (1e-3 * 25 / spring_force()["peak_force_N"]) - 1)
    assert 0.01 * answer["relative_error"] < wrong < 2 * answer["relative_error"]


def test_a_program_of_forces_and_displacements_has_no_accuracy(tmp_path: Path) -> None:
    mixed = "program=[{type: ramp, to: 1 N, duration: 1 s}, {type: ramp, to: 0 mm, duration: 1 s}]"
    with pytest.raises(CaseError) as caught:
        read_case(written(tmp_path, PULL), [mixed, "accuracy=1 %"])
    assert [p.key for p in caught.value.problems] == ["accuracy"]


@pytest.mark.slow
def test_stated_errors_of_creep_are_larger_than_true_ones(tmp_path: Path) -> None:
    path, mesh = written(tmp_path, PULL), "mesh: crossed, mesh_size: 0.5 m, degree: 2"
    program = "program=[{type: ramp, to: 1 N, duration: 0.5 s, steps: STEPS}, "
    program += "{type: hold, duration: 0.5 s, steps: STEPS}]"
    found = stated(
        path, program.replace("STEPS", "40"), "accuracy=5 %", "discretisation={mesh: crossed}"
    )
    fine = program.replace("STEPS", "100")
    finer = wovenfab.simulate(read_case(path, [fine, f"discretisation={{{mesh}}}"]))
    true = {
        "peak_displacement_m": float(finer.history["displacement_m"].max()),
        "dissipated_J": finer.summary["dissipated_J"],
    }
    assert found.keys() == true.keys()
    for name, figure in found.items():
        assert abs(figure["value"] - true[name]) < figure["error"] < 0.05 * true[name]


def test_cells_and_steps_are_halved_from_level_to_level_in_the_largest_cycle(
    tmp_path: Path,
) -> None:
    path = written(tmp_path, PULL + "time: {steps_per_cycle: 80, scheme: midpoint}\n")
    members = [m.case for m in doubled(read_case(path), tmp_path / "cases", 3)]
    assert [c.discretisation.degree for c in members] == [d for d in DEGREES for _ in range(3)]
    sizes = [c.discretisation.mesh_size for c in members[:3]]
    steps = [c.time.steps_per_cycle for c in members[:3]]
    assert sizes == pytest.approx([0.5, 0.25, 0.125])
    assert steps == [20, 40, 80]
    assert {c.time.scheme for c in members} == {"midpoint"}
    assert all(c.program[0].amplitudes == (0.3,) for c in members)  # type: ignore[union-attr]


def test_what_an_accuracy_chooses_is_left_to_it(tmp_path: Path) -> None:
    elements = "discretisation: {degree: 2, mesh_size: 0.5 m, mesh: crossed}\n"
    path = written(tmp_path, PULL + elements + "time: {steps_per_cycle: 80}\n")
    members = [m.case for m in for_accuracies(read_case(path), tmp_path / "cases", 2)]
    assert [c.accuracy for c in members] == list(ACCURACIES[:2])
    assert all(c.discretisation.mesh == "crossed" for c in members)
    assert all("scheme" not in c.time.model_fields_set for c in members)
    named = read_case(path, ["time.scheme=midpoint"])
    (one,) = for_accuracies(named, tmp_path / "cases", 1)
    assert one.case.time.scheme == "midpoint"


def test_a_case_whose_errors_cannot_be_stated_is_refused_with_the_reason(tmp_path: Path) -> None:
    path, force = written(tmp_path, PULL), "program={type: ramp, to: 10 N, duration: 1 s}"
    with pytest.raises(CaseError, match="force is prescribed"):
        study_accuracy(path, tmp_path / "study", [force], 1)


FAST = Priced("fast", None, 2, 0.1, 100, 10, 1.0, 0.0, None, {"peak_force_N": 0.05})


def test_the_finer_answer_to_steps_of_first_order_is_wrong_by_a_third_and_less_than_doubted(
    tmp_path: Path,
) -> None:
    """A fourth as wrong, that is by a third of the distance; half of it is on the safe side."""
    text = PULL.replace("'150, 300 mm'", "300 mm") + "discretisation: {degree: 2, mesh_size: 1 m}"
    first = "time={scheme: backward-euler, steps_per_cycle: 40}"
    case = read_case(written(tmp_path, text), (first,))
    own, finer = (wovenfab.simulate(c).summary for c in (case, finer_case(case)))
    for name, exact in pull_figures().items():
        distance, error = abs(finer[name] - own[name]), abs(finer[name] - exact)
        assert error < abs(own[name] - exact) / 3
        assert 0.5 * DOUBT * distance < error < DOUBT * distance
    assert finer["steps"] <= 5 * own["steps"]


def test_a_stated_error_is_too_small_only_beyond_what_the_finer_answer_is_wrong_by() -> None:
    true = replace(FAST, label="true", seconds=2.0, stated=0.010, errors={"peak_force_N": 0.0099})
    near = replace(true, label="near", seconds=3.0, errors={"peak_force_N": 0.0105})
    wrong = replace(true, label="wrong", seconds=4.0, errors={"peak_force_N": 0.02})
    exact = {"peak_force_N": 1.0, "unknowns": 1, "steps": 1}
    study = Study((FAST, true, near, wrong), exact, 0.001)
    safe = replace(true, label="safe", seconds=5.0, errors={"peak_force_N": 0.0085})
    study = replace(study, runs=(*study.runs, safe))
    assert study.understated == [wrong] and study.proven == [safe]
    assert "large enough: safe" in study.proof() and "too small: wrong" in study.proof()
    assert study.efficient == [FAST, true, safe]


@pytest.mark.parametrize("shown", STUDIES, ids=lambda s: s.name)
def test_the_cases_of_the_page_can_be_read(shown: Shown) -> None:
    assert read_case(ROOT / shown.case, shown.settings).needs.placements == (
        1 if "bonded" in shown.name else 2
    )
