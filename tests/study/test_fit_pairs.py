"""Pairs and formulas: what a fit keeps of them, and sensitivities by a factor of their values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from wovenfab.case import Case, CaseError, read_case
from wovenfab.case.objects import differentiate, sheet_of, simulation_of
from wovenfab.forms.effect import Target
from wovenfab.stepping.sensitivity import TangentLinear
from wovenfab.study.effects import by_factor, sensitivities, value_of
from wovenfab.study.fit.fit_file import read_fit, with_values
from wovenfab.study.fit.objective import Objective

CASE = """\
sheet: {length: 200 mm, width: 100 mm, fibres: [45 deg, -45 deg]}
effects:
  stretch: {stiffness: 1e5 N/m}
  shear: {stiffness: 50 N/m}
  bending: {stiffness: [0.1 N*m, 0.02 N*m]}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 15 mm, steps: 2}
discretisation: {degree: 2, mesh_size: 100 mm}
solver: {tolerance: 1e-12}
"""
FORMULA = "50 N/m * (1 + x/0.2 m)"
SQUARE = "10 N/m + 1e3 N/m^3 * x**2"


def case(folder: Path, **values: object) -> Case:
    (folder / "case.yaml").write_text(CASE)
    changes = {f"effects.{k.replace('_', '.', 1)}": v for k, v in values.items()}
    return read_case(folder / "case.yaml", changes)


def force(of: Case) -> float:
    with simulation_of(of, sheet_of(of, MPI.COMM_SELF)) as simulation:
        return [step.force for step in simulation.steps()][-1]


@pytest.mark.parametrize(
    ("target", "given", "more", "less"),
    [
        (
            Target("bending", "stiffness"), ["0.1 N*m", "0.02 N*m"],
            ["0.101 N*m", "0.0202 N*m"], ["0.099 N*m", "0.0198 N*m"],
        ),
        pytest.param(
            Target("bending", "stiffness", (1,)), ["0.1 N*m", "0.02 N*m"],
            ["0.1 N*m", "0.0202 N*m"], ["0.1 N*m", "0.0198 N*m"], marks=pytest.mark.slow,
        ),
        pytest.param(
            Target("shear", "stiffness"), FORMULA, f"1.01 * {FORMULA}", f"0.99 * {FORMULA}",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            Target("shear", "stiffness", coefficient=3), FORMULA,
            FORMULA.replace("0.2", "0.202"), FORMULA.replace("0.2", "0.198"),
            marks=pytest.mark.slow,
        ),
    ],
    ids=str,
)  # fmt: skip
def test_one_per_cent_more_is_the_difference_that_it_makes(
    target: Target, given: object, more: object, less: object, tmp_path: Path
) -> None:
    base = case(tmp_path)
    key = f"effects.{target.effect}.{target.parameter}"
    of, up, down = (base.changed({key: value}) for value in (given, more, less))
    by = by_factor(target, of)
    columns = sensitivities(of, [by], MPI.COMM_SELF, lambda step: None)
    change = 0.01 * value_of(by, of) * columns[f"d_force/d_{by}"][-1]
    assert change == pytest.approx((force(up) - force(down)) / 2, rel=1e-3)


def fit_file(folder: Path, *sought: str) -> Path:
    (folder / "curve.csv").write_text("u_mm,F_N\n0,0\n7.5,1\n15,2\n")
    lines = ["tests:", "  - {case: case.yaml, measured: curve.csv}", "parameters:"]
    (folder / "fit.yaml").write_text("\n".join([*lines, *(f"  {s}" for s in sought)]) + "\n")
    return folder / "fit.yaml"


def test_a_fit_of_an_unequal_pair_keeps_its_ratio(tmp_path: Path) -> None:
    case(tmp_path)
    fit = read_fit(fit_file(tmp_path, "bending.stiffness:"))
    (unknown,) = fit.unknowns
    assert unknown.start == 0.1
    changed = with_values(fit.tests[0].case, fit.unknowns, {"bending.stiffness": 0.3})
    assert changed.effects["bending"]["stiffness"] == pytest.approx((0.3, 0.06))
    with Objective(fit, tmp_path / "runs") as objective:
        at = objective.evaluate({"bending.stiffness": 0.1})
        up, down = (objective.evaluate({"bending.stiffness": v}) for v in (0.1001, 0.0999))
    difference = (up.residuals - down.residuals) / 2e-3  # by the logarithm
    size = np.abs(difference).max()
    assert np.abs(at.jacobian[:, 0] - difference).max() < 1e-3 * size


def test_one_family_of_a_pair_leaves_the_other_alone(tmp_path: Path) -> None:
    case(tmp_path)
    fit = read_fit(fit_file(tmp_path, "bending.stiffness[2]:"))
    changed = with_values(fit.tests[0].case, fit.unknowns, {"bending.stiffness[2]": 0.3})
    assert changed.effects["bending"]["stiffness"] == (0.1, 0.3)


@pytest.mark.parametrize(
    ("value", "change", "name", "said"),
    [
        ("50 N/m", SQUARE, "shear.stiffness#3", "must stay"),
        ("50 N/m", "50 N/m * (x/1 m)", "shear.stiffness", "by a formula"),
        ("0.02 N*m", "1 N * x", "bending.stiffness", "by a formula"),
        ("0.02 N*m", "0 N*m", "bending.stiffness", "no ratio"),
    ],
)
def test_what_cannot_be_sought_is_refused_before_any_run(
    value: str, change: str, name: str, said: str, tmp_path: Path
) -> None:
    (tmp_path / "case.yaml").write_text(CASE.replace(value, change))
    with pytest.raises(CaseError, match=said) as refused:
        read_fit(fit_file(tmp_path, f"{name}:"))
    assert "fit.yaml" in str(refused.value)


def test_numbers_that_are_no_exponent_of_a_length_may_be_sought(tmp_path: Path) -> None:
    text = f"shear: {{stiffness: {SQUARE}}}"
    (tmp_path / "case.yaml").write_text(CASE.replace("shear: {stiffness: 50 N/m}", text))
    fit = read_fit(fit_file(tmp_path, "shear.stiffness#1:", "shear.stiffness#2:"))
    assert [u.start for u in fit.unknowns] == [10.0, 1e3]


def test_curves_of_other_parameters_are_not_taken_for_those_of_a_fit(tmp_path: Path) -> None:
    case(tmp_path)
    both = {"shear.stiffness": 50.0, "stretch.stiffness": 1e5}
    columns = []
    for names in (["shear.stiffness"], ["stretch.stiffness", "shear.stiffness"]):
        fit = read_fit(fit_file(tmp_path, *(f"{name}:" for name in names)))
        with Objective(fit, tmp_path / "runs") as objective:
            columns.append(objective.evaluate({n: both[n] for n in names}).jacobian)
    assert columns[1].shape[1] == 2
    assert columns[1][:, 1] == pytest.approx(columns[0][:, 0])


def test_vectors_of_derivatives_end_with_the_simulation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    of, ended = case(tmp_path), []
    destroy = TangentLinear.destroy

    def counted(self: TangentLinear) -> None:
        ended.append(self)
        destroy(self)

    monkeypatch.setattr(TangentLinear, "destroy", counted)
    with simulation_of(of, sheet_of(of, MPI.COMM_SELF)) as simulation:
        differentiate(simulation, of, [Target("shear", "stiffness")])
        differentiate(simulation, of, [Target("stretch", "stiffness")])
    assert len(ended) == 2 and not any(one._b or one._x for one in ended)
