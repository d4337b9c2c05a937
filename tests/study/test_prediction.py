"""Bands of predictions: what a fit leaves open of its parameters, carried to another test."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from tests.cli.test_commands import wovenfab
from wovenfab.case import Case, CaseError, read_case
from wovenfab.study.effects import sensitivities
from wovenfab.study.fit.fit_file import Fit, read_fit
from wovenfab.study.fit.identifiability import Identifiability, JointUncertainty, knowledge
from wovenfab.study.fit.objective import Objective
from wovenfab.study.fit.prediction import (
    FittedCase,
    FittedValues,
    describe_prediction,
    fitted_case,
    half_width,
    read_fitted,
    with_band,
)

#: A strip along its yarns, of one element: its force is K W u/L.
STRIP = """\
sheet: {length: 200 mm, width: 100 mm, fibres: [0 deg, 90 deg]}
effects:
  stretch: {law: linear, stiffness: [VALUE, 1e-3 N/m]}
  shear: {stiffness: 1e-3 N/m}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 2 mm, steps: 4}
discretisation: {degree: 1, mesh_size: 100 mm}
solver: {tolerance: 1e-12}
"""
BIAS = """\
sheet: {length: 200 mm, width: 100 mm, fibres: [45 deg, -45 deg]}
effects:
  stretch: {stiffness: 2e4 N/m}
  shear: {stiffness: 50 N/m}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 30 mm, steps: 4}
discretisation: {degree: 2, mesh_size: 100 mm}
"""


def case(folder: Path, text: str, name: str = "case") -> Case:
    (folder / f"{name}.yaml").write_text(text)
    return read_case(folder / f"{name}.yaml")


def fitted(values: Mapping[str, float], covariance: Any, **more: Any) -> FittedValues:
    joint = {"quantile": 2.0, "shift": np.zeros(len(values)), "unseen": np.zeros((0, len(values)))}
    known = JointUncertainty(np.asarray(covariance, dtype=float), **(joint | more))
    return FittedValues(Path("fit.json"), values, (), known)


def banded(made: FittedCase) -> dict[str, list[float]]:
    targets = [*made.targets.values()]
    return with_band(sensitivities(made.case, targets, MPI.COMM_SELF, lambda _: None), made)


def known_of(fit: Fit, values: Mapping[str, float], folder: Path) -> Identifiability:
    with Objective(fit, folder / "runs") as objective:
        e = objective.evaluate(values)
    return knowledge(fit, values, e.residuals, e.jacobian, e.comparisons)


def test_the_band_of_a_spring_is_its_closed_form_and_the_machine_takes_no_part(
    tmp_path: Path,
) -> None:
    strip = case(tmp_path, STRIP.replace("VALUE", "500 N/m"))
    values = {"stretch.stiffness[1]": 800.0, "machine.compliance": 1e-4}
    covariance = [[16.0**2, 0.9 * 16 * 1e-5], [0.9 * 16 * 1e-5, 1e-10]]
    made = fitted_case(strip, fitted(values, covariance, shift=np.array([-3.0, 1.0])))
    columns = banded(made)
    u = np.array(columns["displacement_m"])
    assert columns["force_N"] == pytest.approx(800 * u / 2, abs=1e-6)
    half = (2 * 16 + 3) * u / 2  # W/L = 1/2
    for name, side in (("force_low_N", -1), ("force_high_N", 1)):
        assert columns[name] == pytest.approx(800 * u / 2 + side * half, rel=1e-4, abs=1e-6)
    assert any("machine.compliance" in line for line in describe_prediction(columns, made))
    assert made.replaced  # the case had another value


@pytest.mark.parametrize(("deviation", "far"), [(0.2, False), (0.3, True)])
def test_ends_of_a_band_that_change_a_parameter_by_half_are_said_to_be_far(
    deviation: float, far: bool, tmp_path: Path
) -> None:
    strip = case(tmp_path, STRIP.replace("VALUE", "800 N/m"))
    lines = []
    for part in (1e-3, deviation):  # of the value; an end is two of them away
        values = {"stretch.stiffness[1]": 800.0}
        made = fitted_case(strip, fitted(values, [[(part * 800.0) ** 2]]))
        assert not made.replaced
        lines.append(describe_prediction(banded(made), made))
    assert len(lines[1]) - len(lines[0]) == far


def test_what_is_known_as_a_sum_predicts_by_the_sum(tmp_path: Path) -> None:
    # Of two numbers of a formula the force of a strip tells one combination, its mean stiffness.
    same = case(tmp_path, STRIP.replace("VALUE", "300 N/m + 200 N/m * (1 + 0.1 * x / 0.2 m)"))
    rows = "\n".join(f"{u!r},{0.255 * u!r}" for u in np.linspace(0.0, 2.0, 12).tolist())
    (tmp_path / "curve.csv").write_text(f"u_mm,F_N\n{rows}\n")
    values = {"stretch.stiffness[1]#1": 300.0, "stretch.stiffness[1]#2": 200.0}
    (tmp_path / "fit.yaml").write_text(
        "tests: [{case: case.yaml, measured: curve.csv, error: 1 %}]\n"
        f"parameters: {{{', '.join(f'{name!r}: ' for name in values)}}}\n"
    )
    fit = read_fit(tmp_path / "fit.yaml")
    known = known_of(fit, values, tmp_path)
    assert all(np.isinf(i.half) for i in known.intervals)
    made = fitted_case(same, FittedValues(Path("fit.json"), values, (), known.joint))
    columns = banded(made)
    assert 0 < columns["force_high_N"][-1] / columns["force_N"][-1] - 1 < 0.02
    other = case(tmp_path, STRIP.replace("VALUE", "300 N/m + 200 N/m * (3 + x / 0.2 m)"), "other")
    beside = banded(fitted_case(other, made.fitted))
    assert np.isinf(beside["force_high_N"][-1])  # it depends on another combination


@pytest.mark.parametrize("correlation", [-0.999, 0.0, 0.999])
def test_correlations_make_bands_narrow_or_wide(correlation: float) -> None:
    r = correlation
    pair = JointUncertainty(
        np.array([[4.0, 4 * r], [4 * r, 4.0]]), 2.0, np.array([1.0, -1.0]), np.zeros((0, 2))
    )
    half = half_width(np.array([[1.0, 1.0]]), np.array([9.0]), pair)
    assert half == pytest.approx(2 * np.sqrt(8 * (1 + r)))


def test_fewer_rows_than_parameters_leave_a_combination_unseen(tmp_path: Path) -> None:
    case(tmp_path, BIAS)
    (tmp_path / "curve.csv").write_text("u_mm,F_N\n0,0\n15,1\n30,4\n")
    (tmp_path / "fit.yaml").write_text(
        "tests: [{case: case.yaml, measured: curve.csv}]\n"
        "parameters: {shear.stiffness: , stretch.stiffness: }\n"
    )
    fit = read_fit(tmp_path / "fit.yaml")
    values = {u.name: u.start for u in fit.unknowns}
    with Objective(fit, tmp_path / "runs") as objective:
        e = objective.evaluate(values)
    c = e.comparisons[0]
    last = replace(
        c, rows=c.rows[-1:], measured=c.measured[-1:], computed=c.computed[-1:],
        slopes=c.slopes[-1:], unresolved=c.unresolved[-1:], size=c.size[-1:],
    )  # fmt: skip
    known = knowledge(fit, values, e.residuals[-1:], e.jacobian[-1:], [last])
    assert known.joint.unseen.shape == (1, 2)
    assert all(np.isinf(i.half) for i in known.intervals)


def test_the_band_is_the_scatter_of_runs_with_parameters_drawn_from_the_covariance(
    tmp_path: Path,
) -> None:
    bias = case(tmp_path, BIAS)
    values = {"shear.stiffness": 50.0, "stretch.stiffness": 2e4}
    deviation = np.array([2.0, 1e3])
    covariance = np.outer(deviation, deviation) * [[1, -0.8], [-0.8, 1]]
    columns = banded(fitted_case(bias, fitted(values, covariance)))
    half = columns["force_high_N"][-1] - columns["force_N"][-1]
    drawn = np.random.default_rng(5).standard_normal((8, 2))
    drawn -= drawn.mean(axis=0)  # draws with this mean and covariance themselves: few are enough
    drawn = drawn @ np.linalg.inv(np.linalg.cholesky(np.cov(drawn.T))).T
    drawn = [*values.values()] + drawn @ np.linalg.cholesky(covariance).T
    forces = []
    for row in drawn:
        sample = fitted(dict(zip(values, map(float, row), strict=True)), covariance)
        of = fitted_case(bias, sample).case.changed("program.steps=1")
        forces.append(sensitivities(of, [], MPI.COMM_SELF, lambda _: None)["force_N"][-1])
    assert half / 2 == pytest.approx(np.std(forces, ddof=1), rel=0.05)
    alone = np.hypot(*(deviation * [columns[f"d_force/d_{n}"][-1] for n in values]))
    assert half / 2 < 0.9 * alone  # the correlation counts


@pytest.mark.slow
def test_a_fit_leaves_a_file_from_which_another_size_is_predicted(tmp_path: Path) -> None:
    case(tmp_path, STRIP.replace("VALUE", "500 N/m"))
    noise = np.random.default_rng(2).standard_normal(10)
    rows = "\n".join(f"{0.2 * (k + 1)},{0.08 * (k + 1) + 0.01 * e}" for k, e in enumerate(noise))
    (tmp_path / "curve.csv").write_text(f"u_mm,F_N\n0,0\n{rows}\n")
    (tmp_path / "fit.yaml").write_text(
        "refine: false\ntests: [{case: case.yaml, measured: curve.csv}]\n"
        "parameters: {'stretch.stiffness[1]': {bounds: [100 N/m, 5 kN/m]}}\n"
    )
    assert wovenfab("fit", "fit.yaml", "-o", "out", "--jobs", "1", cwd=tmp_path).returncode == 0
    told = wovenfab(
        "sensitivities", "case.yaml", "--set", "sheet.length=400 mm", "--fit", "out", "-o", "band",
        "--lab", "curve.csv", cwd=tmp_path,
    )  # fmt: skip
    assert told.returncode == 0, told.stderr
    result = json.loads((tmp_path / "out" / "fit.json").read_text())
    (one,) = result["parameters"].values()
    table = np.genfromtxt(tmp_path / "band" / "sensitivities.csv", delimiter=",", names=True)
    last = table[-1]
    assert last["force_N"] == pytest.approx(one["value"] * 0.1 * 2e-3 / 0.4, rel=1e-5)
    ratio = (last["force_high_N"] - last["force_N"]) / last["force_N"]
    assert ratio == pytest.approx(one["half"] + one["shift"], rel=1e-3)
    assert f"{last['force_N']:.4g} +-" in told.stdout
    assert (tmp_path / "band" / "band.png").exists()
    # Twice as long, the sample has half the force: its own curve lies beside the band.
    assert "curve.csv: 1 of 11 measured forces" in told.stdout


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "cannot be read"),
        ("[", "not the result"),
        ("[]", "may be off together"),
        ('{"parameters": {"a.b": {"value": 1, "at_bound": ""}}}', "may be off together"),
        (
            '{"parameters": {"a.b": {"value": 1, "at_bound": ""}}, '
            '"joint": {"covariance": [[1, 2]], "quantile": 2, "shift": [0], "unseen": []}}',
            "may be off together",
        ),
    ],
)
def test_what_is_no_result_of_a_fit_is_refused(
    content: str | None, said: str, tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / "fit.json").write_text(content)
    with pytest.raises(CaseError, match=said):
        read_fitted(tmp_path / "fit.json")


@pytest.mark.parametrize(
    "damage",
    [
        {"covariance": [[-1.0, 0.0], [0.0, 1.0]]},
        {"covariance": [[1.0, 3e4], [3e4, 1e8]]},
        {"covariance": [[1.0, 5.0], [0.0, 1e8]]},
        {"covariance": [[float("nan"), 0.0], [0.0, 1.0]]},
        {"quantile": -2.0},
        {"quantile": float("inf")},
        {"shift": [0.0, float("nan")]},
        {"unseen": [[float("nan"), 0.0]]},
    ],
    ids=str,
)
def test_a_band_that_no_fit_leaves_is_refused(damage: dict[str, Any], tmp_path: Path) -> None:
    joint = {"covariance": [[1.0, 9e3], [9e3, 1e8]], "quantile": 2.0, "shift": [0.0, 0.0]}
    values = {name: {"value": 1.0, "at_bound": ""} for name in ("a.b", "c.d")}
    text = json.dumps({"parameters": values, "joint": joint | {"unseen": []}})
    (tmp_path / "fit.json").write_text(text)
    read_fitted(tmp_path / "fit.json")
    text = json.dumps({"parameters": values, "joint": joint | {"unseen": []} | damage})
    (tmp_path / "fit.json").write_text(text)
    with pytest.raises(CaseError, match="damaged"):
        read_fitted(tmp_path / "fit.json")


def test_a_case_without_an_effect_of_the_fit_is_refused(tmp_path: Path) -> None:
    bias = case(tmp_path, BIAS)
    with pytest.raises(CaseError, match="bending"):
        fitted_case(bias, fitted({"bending.stiffness": 1.0}, [[1.0]]))
    with pytest.raises(CaseError, match="machine"):
        fitted_case(bias, fitted({"machine.force": 1.0}, [[1.0]]))
