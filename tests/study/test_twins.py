"""Twins: parameters found again from curves that finer cells and steps made with them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.study.test_fit import as_measured, found
from wovenfab.case import read_case
from wovenfab.study.fit.fit_file import Fit, read_fit
from wovenfab.study.fit.identifiability import describe_identifiability, knowledge
from wovenfab.study.fit.objective import Objective
from wovenfab.study.fit.response import computed
from wovenfab.study.fit.search import search_with_slack

BIAS = """\
sheet: {length: 0.3 m, width: 0.1 m, fibres: [45 deg, -45 deg]}
effects:
  stretch: {stiffness: 1e5 N/m}
  shear: {stiffness: 60 N/m}
  bending: {stiffness: 0.3 N*m}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 30 mm, steps: 10}
discretisation: {degree: 4, mesh_size: 25 mm}
"""
ALONG = {
    "sheet.fibres": ["0 deg", "90 deg"],
    "sheet.length": "0.1 m",
    "program.to": "3 mm",
    "program.steps": 4,
}
ELASTIC = {"stretch.stiffness": 1.4e5, "shear.stiffness": 83.0, "bending.stiffness": 0.4}
LOOP = """\
sheet: {length: 0.6 m, width: 0.2 m, fibres: [45 deg, -45 deg]}
effects:
  stretch: {stiffness: 16 MN/m}
  shear: {stiffness: 400 N/m}
  bending: {stiffness: 50 N*m}
  coupling: {stiffness: 6 MN/m^3}
  slip_friction: {strength: 40 kN/m^2, slope: 100 s/m}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: cycles, amplitudes: [20 mm, 30 mm], max_velocity: 50 mm/s}
time: {steps_per_cycle: 80}
discretisation: {degree: 3, mesh_size: 60 mm}
"""
OF_LOOP = {
    "bending.stiffness": 70.0,
    "shear.stiffness": 300.0,
    "coupling.stiffness": 8e6,
    "slip_friction.strength": 55e3,
    "slip_friction.slope": 70.0,
}
MACHINE = """\
sheet: {length: 200 mm, width: 100 mm, fibres: [45 deg, -45 deg]}
effects:
  stretch: {stiffness: 3e4 N/m}
  shear: {stiffness: 20 N/m}
  spin_friction: {strength: 4 N/m, law: coulomb}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: cycles, amplitudes: [20 mm], frequency: 0.1 Hz}
discretisation: {degree: 1, mesh_size: 100 mm}
time: {steps_per_cycle: 32}
"""
OF_MACHINE = {
    "shear.stiffness": 20.0,
    "spin_friction.strength": 4.0,
    "machine.compliance": 1e-4,
    "machine.displacement": 0.3e-3,
    "machine.force": 0.05,
}
FIT_OF_MACHINE = """\
refine: false
tests:
  - {case: case.yaml, measured: curve.csv, error: 0.3 %}
parameters:
  shear.stiffness: {start: 30 N/m}
  spin_friction.strength: {start: 3 N/m}
  machine.compliance: {start: 2e-5 m/N, bounds: ["1e-6 m/N", "1e-2 m/N"]}
  machine.displacement: {bounds: ["-1 mm", "1 mm"]}
  machine.force: {bounds: ["-1 N", "1 N"]}
"""


def twin(path: Path, truth: Mapping[str, float], finer: Mapping[str, Any], noise: float = 0.0,
         seed: int = 0) -> None:  # fmt: skip
    """Write the curve of a case with other parameters beside it."""
    changes = {f"effects.{name}": value for name, value in truth.items()}
    made = computed(read_case(path, {**changes, **finer}), [])
    path.with_suffix(".csv").write_text(as_measured(made.displacement, made.force, noise, seed))


def fit_of(folder: Path, names: Mapping[str, Any], error: str, refine: bool, *tests: str) -> Fit:
    rows = [f"  - {{case: {t}.yaml, measured: {t}.csv, error: {error}}}" for t in tests]
    sought = [f"  {name}:" for name in names]
    text = [f"refine: {str(refine).lower()}", "tests:", *rows, "parameters:", *sought]
    (folder / "fit.yaml").write_text("\n".join(text) + "\n")
    return read_fit(folder / "fit.yaml")


@pytest.mark.slow
def test_elastic_parameters_of_two_tests_on_a_finer_mesh_are_found_to_a_thousandth(
    tmp_path: Path,
) -> None:
    bias, along = tmp_path / "bias.yaml", tmp_path / "along.yaml"
    bias.write_text(BIAS)
    along.write_text(read_case(bias, ALONG).to_yaml())
    for path, steps in ((bias, 20), (along, 8)):
        twin(path, ELASTIC, {"discretisation.mesh_size": "12.5 mm", "program.steps": steps})
    values, _, _ = found(fit_of(tmp_path, ELASTIC, "0.5 %", True, "bias", "along"), tmp_path)
    assert values == pytest.approx(ELASTIC, rel=1e-3)


@pytest.mark.slow
def test_of_a_slow_loop_bending_is_known_and_two_pairs_only_together(tmp_path: Path) -> None:
    path = tmp_path / "loop.yaml"
    path.write_text(LOOP)
    twin(path, OF_LOOP, {"discretisation.mesh_size": "30 mm", "time.steps_per_cycle": 160})
    fit = fit_of(tmp_path, OF_LOOP, "0.5 %", False, "loop")
    values, about, _ = found(fit, tmp_path)
    words = "\n".join(describe_identifiability(about, fit))
    assert values["bending.stiffness"] == pytest.approx(70.0, rel=1e-2)
    assert "shear.stiffness and coupling.stiffness are determined only together" in words
    assert "slip_friction.strength and slip_friction.slope are determined only together" in words
    product = values["slip_friction.strength"] * values["slip_friction.slope"]
    assert product == pytest.approx(55e3 * 70.0, rel=0.05)


@pytest.mark.slow
def test_the_product_of_strength_and_slope_alone_makes_a_slow_loop(tmp_path: Path) -> None:
    path = tmp_path / "loop.yaml"
    path.write_text(LOOP)
    at = {f"effects.{name}": value for name, value in OF_LOOP.items()}
    of_strength, of_slope = "effects.slip_friction.strength", "effects.slip_friction.slope"
    other = {of_strength: 1.5 * at[of_strength], of_slope: at[of_slope] / 1.5}
    more = {of_strength: 1.1 * at[of_strength]}
    true, twin_force, stronger = (
        computed(read_case(path, {**at, **change}), []).force for change in ({}, other, more)
    )
    assert np.abs(twin_force - true).max() < 0.2 * np.abs(stronger - true).max()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_of_a_noisy_curve_intervals_hold_the_truth(seed: int, tmp_path: Path) -> None:
    path = tmp_path / "bias.yaml"
    path.write_text(BIAS.replace("degree: 4", "degree: 2"))
    twin(path, ELASTIC, {"program.steps": 60}, 0.01, seed)
    sought = ("shear.stiffness", "bending.stiffness")
    path.write_text(path.read_text().replace("1e5", "1.4e5"))
    fit = fit_of(tmp_path, dict.fromkeys(sought), "1 %", False, "bias")
    _, about, _ = found(fit, tmp_path)
    for interval in about.intervals:
        assert interval.low < ELASTIC[interval.name] < interval.high


@pytest.mark.slow
def test_intervals_of_a_machine_with_coulomb_friction_hold_the_truth_in_ten_repeats(
    tmp_path: Path,
) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(MACHINE)
    (tmp_path / "fit.yaml").write_text(FIT_OF_MACHINE)
    made = computed(read_case(path), [])
    at = made.displacement + OF_MACHINE["machine.compliance"] * made.force
    at += OF_MACHINE["machine.displacement"]
    hits, widths = [], []
    for seed in range(10):
        curve = as_measured(at, made.force + OF_MACHINE["machine.force"], 0.003, seed)
        (tmp_path / "curve.csv").write_text(curve)
        fit = read_fit(tmp_path / "fit.yaml")
        with Objective(fit, tmp_path / "runs") as objective:
            result = search_with_slack(objective, fit)
            e = result.evaluation
            known = knowledge(fit, result.values, e.residuals, e.jacobian, e.comparisons)
            sizes = objective.slopes(result.values)
        hits.append([i.low <= OF_MACHINE[i.name] <= i.high for i in known.intervals])
        widths.append([i.half for i in known.intervals] * sizes)
        print(seed, dict(result.values), hits[-1], widths[-1])
    assert (np.sum(hits, axis=0) >= 9).all()
    assert (np.max(widths, axis=0) < 5 * np.min(widths, axis=0)).all()
