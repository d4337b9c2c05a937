"""Parameters are found again from curves that were made with them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.cli.test_commands import wovenfab
from wovenfab.case import CaseError, read_case
from wovenfab.study.cluster import Cluster
from wovenfab.study.fit.fit_file import Fit, read_fit, with_values
from wovenfab.study.fit.identifiability import (
    Identifiability,
    describe_identifiability,
    knowledge,
    sign_runs,
)
from wovenfab.study.fit.objective import Objective
from wovenfab.study.fit.response import compared, computed
from wovenfab.study.fit.search import offset, search

CASE = """\
sheet: {length: 0.6 m, width: 0.2 m, fibres: [45 deg, -45 deg]}
effects:
  stretch: {stiffness: 2e5 N/m}
  shear: {stiffness: 60 N/m}
  bending: {stiffness: 2 N*m}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 60 mm, steps: 8}
discretisation: {degree: 2, mesh_size: 100 mm}
"""
FIT = """\
refine: false
tests:
  - {case: case.yaml, measured: curve.csv, error: 0.2 %}
parameters:
  shear.stiffness: {start: 60 N/m}
  stretch.stiffness: {start: 2e5 N/m}
"""
REPEATS = 1000
Array = NDArray[np.float64]
TRUTH = {"shear.stiffness": 83.0, "stretch.stiffness": 1.4e5}


def place(folder: Path, fit: str = FIT, case: str = CASE, curve: str | None = None) -> Path:
    """Write the files of a fit; return that of the fit."""
    (folder / "case.yaml").write_text(case)
    (folder / "fit.yaml").write_text(fit)
    (folder / "curve.csv").write_text(curve or "u_mm,F_N\n0,0\n30,1\n60,2\n")
    return folder / "fit.yaml"


def curve_of(
    folder: Path,
    truth: Mapping[str, float] = TRUTH,
    noise: float = 0.0,
    slack: float = 0.0,
    spring: float = 0.0,
    seed: int = 0,
) -> str:
    """Return a curve as a machine would measure it, with noise (of the largest force)."""
    changes = {f"effects.{name}": repr(value) for name, value in truth.items()}
    (folder / "case.yaml").write_text(CASE)
    if noise:
        changes["program.steps"] = "60"
    made = computed(read_case(folder / "case.yaml", changes), [])
    at = made.displacement + spring * made.force + slack
    return as_measured(at, made.force, noise, seed)


def as_measured(displacement: Array, force: Array, noise: float = 0.0, seed: int = 0) -> str:
    """Return a curve (m, N) as text, with noise (of the largest force)."""
    scatter = np.random.default_rng(seed).standard_normal(force.size)
    noisy = force + noise * np.abs(force).max() * scatter
    rows = [f"{u!r},{f!r}" for u, f in zip(displacement.tolist(), noisy.tolist(), strict=True)]
    return "\n".join(["u_m,F_N", *rows]) + "\n"


def found(fit: Fit, folder: Path) -> tuple[dict[str, float], Identifiability, float]:
    """Return values, what is known, and the work: a coarse run has a quarter of the cells."""
    with Objective(fit, folder / "runs") as objective:
        result = search(objective, fit)
    assert result.converged
    e = result.evaluation
    known = knowledge(fit, result.values, e.residuals, e.jacobian, e.comparisons)
    work = sum(0.25 if trial.coarse else 1.0 for trial in result.trials)
    return dict(result.values), known, work


@pytest.mark.slow
def test_parameters_of_a_curve_without_noise_are_found_to_a_thousandth(tmp_path: Path) -> None:
    fit = read_fit(place(tmp_path, curve=curve_of(tmp_path)))
    values, _, work = found(fit, tmp_path)
    assert values == pytest.approx(TRUTH, rel=1e-3)
    assert work <= 15
    again = Objective(fit, tmp_path / "runs")
    assert again.evaluate(values).residuals.size == 9  # from the store: nothing is computed


@pytest.mark.slow
def test_a_spring_in_series_and_slack_of_the_machine_are_found(tmp_path: Path) -> None:
    text = (
        "refine: false\n"
        "tests:\n  - {case: case.yaml, measured: curve.csv, error: 0.2 %}\nparameters:\n"
        "  shear.stiffness: {start: 60 N/m}\n"
        "  machine.compliance: {bounds: [0 m/N, 1e-3 m/N], start: 1e-4 m/N}\n"
        "  machine.displacement: {bounds: [-2 mm, 2 mm]}\n"
    )
    truth = {"shear.stiffness": 83.0}
    curve = curve_of(tmp_path, truth, slack=0.4e-3, spring=3e-4)
    values, _, _ = found(read_fit(place(tmp_path, text, curve=curve)), tmp_path)
    assert values["shear.stiffness"] == pytest.approx(83.0, rel=1e-2)
    assert values["machine.compliance"] == pytest.approx(3e-4, rel=2e-2)
    assert values["machine.displacement"] == pytest.approx(0.4e-3, rel=2e-2)


@pytest.mark.slow
def test_without_a_start_the_size_of_the_forces_gives_one(tmp_path: Path) -> None:
    text = FIT.replace("{start: 60 N/m}", "").replace("{start: 2e5 N/m}", "")
    far = {name: 8 * value for name, value in TRUTH.items()}
    fit = read_fit(place(tmp_path, text, curve=curve_of(tmp_path, far)))
    values, _, work = found(fit, tmp_path)
    assert values == pytest.approx(far, rel=1e-2)
    assert work <= 15


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say(tmp_path: Path) -> None:
    # Of the problem linearised at the truth, where each repeat costs nothing.
    fit = read_fit(place(tmp_path, curve=curve_of(tmp_path, noise=0.01)))
    with Objective(fit, tmp_path / "runs") as objective:
        e = objective.evaluate(TRUTH)
        slopes = objective.slopes(TRUTH)
    generator, hits = np.random.default_rng(3), np.zeros(2)
    q = objective.scaled(TRUTH)
    for _ in range(REPEATS):
        noise = generator.standard_normal(e.residuals.size) * 5  # 1 % with an error of 0.2 %
        step = np.linalg.lstsq(e.jacobian, noise, rcond=None)[0]
        rest = noise - e.jacobian @ step
        values = objective.values(q + step)
        known = knowledge(fit, values, rest, e.jacobian, e.comparisons)
        hits += [i.low <= TRUTH[i.name] <= i.high for i in known.intervals]
    assert slopes.shape == (2,)
    assert ((hits / REPEATS >= 0.90) & (hits / REPEATS <= 0.99)).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_noisy_curve_gives_intervals_that_hold_the_truth(seed: int, tmp_path: Path) -> None:
    fit = read_fit(place(tmp_path, curve=curve_of(tmp_path, noise=0.003, seed=seed)))
    _, known, _ = found(fit, tmp_path)
    assert [i.low <= TRUTH[i.name] <= i.high for i in known.intervals] == [True, True]


def test_a_parameter_without_effect_is_named(tmp_path: Path) -> None:
    case = CASE.replace("bending: {stiffness: 2 N*m}", "bending: {stiffness: 1e-9 N*m}")
    text = FIT.replace("0.2 %", "0.05 %") + "  bending.stiffness: {start: 1e-9 N*m}\n"
    fit = read_fit(place(tmp_path, text, case, curve_of(tmp_path)))
    values = {**TRUTH, "bending.stiffness": 1e-9}
    with Objective(fit, tmp_path / "runs") as objective:
        e = objective.evaluate(values)
    known = knowledge(fit, values, 0 * e.residuals, e.jacobian, e.comparisons)
    assert [i.determined for i in known.intervals] == [True, True, False]
    assert any("bending.stiffness" in line for line in describe_identifiability(known, fit))


def test_derivatives_of_compared_forces_agree_with_differences(tmp_path: Path) -> None:
    text = FIT + (
        "  machine.compliance: {bounds: [0 m/N, 1e-3 m/N], start: 2e-4 m/N}\n"
        "  machine.displacement: {bounds: [-2 mm, 2 mm]}\n"
        "  machine.force: {bounds: [-2 N, 2 N]}\n"
    )
    fit = read_fit(place(tmp_path, text, curve=curve_of(tmp_path, noise=0.01)))
    start = {u.name: u.start for u in fit.unknowns}
    start["machine.displacement"] = 1e-4
    with Objective(fit, tmp_path / "runs") as objective:
        q, e = objective.scaled(start), objective.evaluate(start)
        for k in range(len(q)):
            step = 1e-4 * np.eye(len(q))[k]
            ends = [objective.evaluate(objective.values(q + s * step)).residuals for s in (1, -1)]
            difference = (ends[0] - ends[1]) / 2e-4
            size = np.abs(difference).max()
            assert np.abs(e.jacobian[:, k] - difference).max() < 2e-4 * size


@pytest.mark.slow
def test_two_tests_are_fitted_side_by_side(tmp_path: Path) -> None:
    text = FIT.replace(
        "parameters",
        "  - {case: case.yaml, set: {program.to: 40 mm}, measured: curve.csv}\nparameters",
    )
    fit = read_fit(place(tmp_path, text, curve=curve_of(tmp_path)))
    with Objective(fit, tmp_path / "runs", Cluster(jobs=2)) as objective:
        e = objective.evaluate(TRUTH)
    assert [c.rows.size for c in e.comparisons] == [9, 6]
    assert np.abs(e.residuals[:9]).max() < 1e-6


def test_branches_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    from wovenfab.study.fit.response import BranchError

    back = "u_mm,F_N\n0,0\n30,1\n60,2\n30,1\n0,0\n"
    fit = read_fit(place(tmp_path, curve=back))
    curve = computed(fit.tests[0].case, [])
    with pytest.raises(
        BranchError, match=r"2 branches of loading and unloading.*; let the program"
    ):
        compared(fit.tests[0].measured, curve, fit.unknowns, TRUTH)


def test_few_runs_of_the_sign_are_known_as_an_error_of_the_model() -> None:
    generator = np.random.default_rng(5)
    noise = [sign_runs(generator.standard_normal(60))[2] for _ in range(200)]
    assert 0.002 < np.mean(np.array(noise) < 0.05) < 0.12
    assert sign_runs(np.sin(np.linspace(0, 12, 60)))[2] < 1e-6


def test_the_offset_is_zero_at_the_solution_and_large_far_from_it() -> None:
    generator = np.random.default_rng(2)
    jacobian, noise = generator.standard_normal((50, 3)), generator.standard_normal(50)
    rest = noise - jacobian @ np.linalg.lstsq(jacobian, noise, rcond=None)[0]
    assert offset(rest, jacobian) < 1e-10
    assert offset(rest + jacobian @ np.ones(3), jacobian) > 1


#: A fit file, or a change of one, and what is said.
BAD = {
    "no tests": ("tests: []\nparameters: {shear.stiffness: }\n", "tests: the list is empty"),
    "no parameters": ("tests: [{case: case.yaml, measured: curve.csv}]\n", "parameters: missing"),
    "unknown key": (FIT + "parametres: {}\n", "parametres: unknown key"),
    "no such case": (FIT.replace("case.yaml", "x.yaml"), "there is no file 'x.yaml'"),
    "no such curve": (FIT.replace("curve.csv", "x.csv"), "there is no file 'x.csv'"),
    "a spreadsheet": (FIT.replace("curve.csv", "curve.ods"), "expected a file that ends in"),
    "no curves": (FIT.replace("curve.csv", "[]"), "tests.0.measured: the list is empty"),
    "one of several curves": (
        FIT.replace("curve.csv", "[curve.csv, x.csv]"), "there is no file 'x.csv'",
    ),
    "no such cycle": (FIT.replace("error:", "cycle: 2, error:"), "no cycle 2: the curve has 0"),
    "half a row": (FIT.replace("error:", "zero: 0.5, error:"), "zero: expected a whole number"),
    "rest of all rows": (FIT.replace("error:", "drift: 2, error:"), "'drift: 2' needs"),
    "unit of the preload": (
        FIT.replace("error:", "preload: 1 mm, error:"), "preload: expected a force",
    ),
    "sheet of a text": (FIT.replace("error:", "sheet: A, error:"), "this is no workbook"),
    "unknown effect": (FIT + "  sheer.stiffness:\n", "no effect 'sheer'. Did you mean 'shear'?"),
    "unknown parameter": (FIT + "  shear.slope:\n", "shear has no parameter 'slope'. It has stiff"),
    "coefficient of a number": (FIT + "  bending.stiffness#1:\n", "the value has 0 coefficients"),
    "unknown part of the machine": (FIT + "  machine.mass:\n", "the machine has no 'mass'"),
    "machine without bounds": (FIT + "  machine.force:\n", "needs bounds"),
    "family of a pair": (FIT + "  bending.stiffness[3]:\n", "the families are [1] and [2]"),
    "bounds in reverse": (
        FIT + "  bending.stiffness: {bounds: [3 N*m, 1 N*m]}\n", "the bounds must increase",
    ),
    "negative bound": (
        FIT + "  bending.stiffness: {bounds: [-3 N*m, 1 N*m]}\n", "the bounds must increase from 0",
    ),
    "start outside": (
        FIT + "  bending.stiffness: {start: 9 N*m, bounds: [1 N*m, 3 N*m]}\n",
        "the start 9 N*m is outside of the bounds",
    ),
    "unit of the start": (FIT.replace("60 N/m", "60 mm"), "expected a force per length"),
    "nan": (FIT.replace("60 N/m", ".nan"), "got nan"),
    "logarithms of zero": (
        FIT + "  bending.stiffness: {bounds: [0 N*m, 3 N*m], scale: log}\n",
        "needs positive bounds",
    ),
    "error": (FIT.replace("0.2 %", "2 mm"), "expected an error such as 1 % or 0.1 N"),
    "no error": (FIT.replace("0.2 %", "0 %"), "expected an error such as 1 % or 0.1 N"),
    "weight": (FIT.replace("error:", "weight: 0, error:"), "weight: "),
    "set": (FIT.replace("error:", "set: {program.too: 3}, error:"), "program.too: unknown key"),
    "a profile of nothing": (FIT + "profiles: [bending.stiffness]\n", "none of the parameters to"),
    "an accuracy": (
        FIT.replace("error:", "set: {accuracy: 1 %, discretisation: null}, error:"),
        "a fit chooses cells and steps itself",
    ),
    "not YAML": ("tests: [", "this is not valid YAML"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_bad_fit_file_is_refused_in_words(name: str, tmp_path: Path) -> None:
    text, message = BAD[name]
    with pytest.raises(CaseError) as caught:
        read_fit(place(tmp_path, text))
    assert message in str(caught.value)


@pytest.mark.slow
def test_a_coefficient_of_a_formula_is_found(tmp_path: Path) -> None:
    formula = "60 N/m * (1 + 2 * exp(-x/0.2 m))"
    case = CASE.replace("stiffness: 60 N/m", f"stiffness: {formula}")
    place(tmp_path, case=case)
    truth = {"effects.shear.stiffness": formula.replace("0.2 m", "300 mm")}
    made = computed(read_case(tmp_path / "case.yaml", truth), [])
    (tmp_path / "curve.csv").write_text(as_measured(made.displacement, made.force))
    sought = "  shear.stiffness#4: {bounds: [50 mm, 1 m]}\n"
    (tmp_path / "fit.yaml").write_text(FIT[: FIT.index("  shear")] + sought)
    fit = read_fit(tmp_path / "fit.yaml")
    values, _, _ = found(fit, tmp_path)
    assert values == pytest.approx({"shear.stiffness#4": 0.3}, rel=1e-3)
    fitted = with_values(fit.tests[0].case, fit.unknowns, values)
    assert fitted.effects["shear"]["stiffness"].at(0.3, 0.0) == pytest.approx(
        60 * (1 + 2 * np.exp(-1)), rel=1e-3
    )


@pytest.mark.slow
def test_the_command_writes_page_picture_result_and_the_fitted_case(tmp_path: Path) -> None:
    text = FIT + "profiles: [shear.stiffness]\n"
    path = place(tmp_path, text, curve=curve_of(tmp_path, noise=0.002))
    ended = wovenfab("fit", path, "-o", "out", cwd=tmp_path)
    assert "The curves are followed within" in ended.stdout
    assert "By its profile shear.stiffness is" in ended.stdout
    result = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert result["converged"]
    for name, value in TRUTH.items():
        assert result["parameters"][name]["low"] <= value <= result["parameters"][name]["high"]
    fitted = read_case(tmp_path / "out" / "case.yaml")
    assert fitted.effects["shear"]["stiffness"] == result["parameters"]["shear.stiffness"]["value"]
    assert "data:image/svg+xml;base64," in (tmp_path / "out" / "fit.html").read_text()
    assert (tmp_path / "out" / "fit.png").stat().st_size > 10_000
    refused = wovenfab("fit", "x.yaml", cwd=tmp_path)
    assert refused.returncode == 2 and "there is no such file" in refused.stderr


@pytest.mark.slow
def test_a_parameter_that_buys_nothing_loses_by_the_criterion(tmp_path: Path) -> None:
    near = FIT.replace("60 N/m", "80 N/m").replace("2e5 N/m", "1.5e5 N/m")
    place(tmp_path, near, curve=curve_of(tmp_path, noise=0.002))
    (tmp_path / "more.yaml").write_text(near + "  bending.stiffness: {bounds: [0.5 N*m, 8 N*m]}\n")
    (tmp_path / "less.yaml").write_text(
        near.replace("  stretch.stiffness: {start: 1.5e5 N/m}\n", "")
    )
    files = "fit.yaml", "more.yaml", "less.yaml"
    assert "fit has the smallest BIC" in wovenfab("fit", *files, "-o", "out", cwd=tmp_path).stdout
    bic = {
        name: json.loads((tmp_path / "out" / name / "fit.json").read_text())["bic"]
        for name in ("fit", "more", "less")
    }
    assert bic["fit"] < bic["more"] < bic["fit"] + 6 < bic["less"]


@pytest.mark.slow
def test_a_run_is_drawn_over_a_measured_curve_with_its_distance(tmp_path: Path) -> None:
    place(tmp_path, curve=curve_of(tmp_path))
    doubled = {**TRUTH, "bending.stiffness": 2.0}
    wrong = [f"effects.{name}={2 * value!r}" for name, value in doubled.items()]
    for name, changes in (("same", [f"effects.{n}={v!r}" for n, v in TRUTH.items()]), ("w", wrong)):
        options = [part for change in changes for part in ("--set", change)]
        wovenfab("run", "case.yaml", "-o", name, *options, cwd=tmp_path)
    report = "report", "same", "w", "--lab"
    said = wovenfab(*report, "curve.csv", cwd=tmp_path)
    assert "same: 0.00 % of the largest force from curve.csv" in said.stdout
    twice = float(said.stdout.split("w: ")[1].split(" %")[0])
    force = np.loadtxt(tmp_path / "curve.csv", delimiter=",", skiprows=1)[:, 1]
    assert twice == pytest.approx(100 * np.sqrt(np.mean(force**2)) / force.max(), rel=0.01)
    assert (tmp_path / "lab.png").stat().st_size > 10_000
    page = (tmp_path / "comparison.html").read_text()
    assert "Measured curve" in page and "0.00 % of the largest force from curve.csv" in page
    (tmp_path / "other.csv").write_text("u_mm,F_N\n0,0\n30,1\n60,2\n30,1\n0,0\n")
    other = wovenfab(*report, "other.csv", cwd=tmp_path)
    assert "same: no distance: other.csv has 2 branches of loading" in other.stdout
