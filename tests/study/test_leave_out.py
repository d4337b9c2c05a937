"""The law that made the curves of some tests predicts one that is left out; others do not."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.cli.test_commands import wovenfab
from wovenfab.case import CaseError, read_case
from wovenfab.study.fit.fit_file import Fit, experiments, read_fit
from wovenfab.study.fit.leave_out import predicted
from wovenfab.study.fit.objective import Objective
from wovenfab.study.fit.response import ResponseCurve, computed

Array = NDArray[np.float64]
#: Lengths of samples (m), each twice as long as it is wide, and scatter over the largest force.
LENGTHS, NOISE = (0.2, 0.3), 0.01
CASE = """\
sheet: {length: 0.2 m, width: 0.1 m, fibres: [45 deg, -45 deg]}
effects:
  stretch: {stiffness: 2e5 N/m}
  shear: {stiffness: 60 N/m}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 10 mm, steps: 4}
discretisation: {degree: 2, mesh_size: 50 mm}
"""
BENDING = {"effects.bending.stiffness": "0.2 N*m", "effects.shear.stiffness": "1e-2 N/m"}
LAWS = {"shear": "shear.stiffness: {start: 40 N/m}", "bending": "bending.stiffness:"}


def _sizes(length: float) -> dict[str, str]:
    share = length / LENGTHS[0]
    return {
        "sheet.length": f"{length} m",
        "sheet.width": f"{length / 2} m",
        "program.to": f"{10 * share} mm",
        "discretisation.mesh_size": f"{50 * share} mm",
    }


def _measured(folder: Path, length: float) -> None:
    """Write the curve of a sample, of 20 rows, with noise."""
    made = computed(read_case(folder / "case.yaml", {**_sizes(length), "program.steps": 20}), [])
    scatter = np.random.default_rng(round(1e3 * length)).standard_normal(made.force.size)
    force = made.force + NOISE * np.abs(made.force).max() * scatter
    rows = (f"{u!r},{f!r}" for u, f in zip(made.displacement.tolist(), force.tolist(), strict=True))
    (folder / f"{length}.csv").write_text("\n".join(["u_m,F_N", *rows]) + "\n")


def _fit_file(folder: Path, law: str) -> str:
    more = BENDING if law == "bending" else {}
    tests = [
        f"  - {{case: case.yaml, set: {json.dumps(_sizes(length) | more)}, "
        f"measured: {length}.csv, error: 1 %}}"
        for length in LENGTHS
    ]
    text = "\n".join(["refine: false", "tests:", *tests, "parameters:", f"  {LAWS[law]}", ""])
    (folder / f"{law}.yaml").write_text(text)
    return f"{law}.yaml"


@pytest.mark.slow
def test_the_law_that_made_the_curves_predicts_a_size_that_it_was_not_given(
    tmp_path: Path,
) -> None:
    """Bending has a length of its own: it follows each size as well, and predicts no other."""
    (tmp_path / "case.yaml").write_text(CASE)
    for length in LENGTHS:
        _measured(tmp_path, length)
    files = [_fit_file(tmp_path, law) for law in LAWS]
    said = wovenfab("fit", "--leave-out", "--jobs", "1", *files, "-o", "out", cwd=tmp_path)
    assert said.returncode == 0, said.stderr
    models = json.loads((tmp_path / "out" / "models.json").read_text())["models"]
    for law in LAWS:
        own = json.loads((tmp_path / "out" / law / "fit.json").read_text())["leave_out"]
        assert own == models[law]["leave_out"]
        for one in own["predictions"]:  # both laws follow what they were given
            assert one["misfit_of_others"] == pytest.approx(NOISE, rel=0.5)
    shares = {
        law: [t["misfit"] for p in models[law]["leave_out"]["predictions"] for t in p["tests"]]
        for law in LAWS
    }
    assert shares["shear"] == pytest.approx([NOISE, NOISE], rel=0.5)
    assert min(shares["bending"]) > 10 * NOISE
    assert models["shear"]["leave_out"]["misfit"] == pytest.approx(
        np.sqrt(np.mean(np.square(shares["shear"])))
    )
    for page in ("models.html", "shear/fit.html"):
        text = (tmp_path / "out" / page).read_text()
        assert "Misfit where a test was left out" in text and "could not be drawn" not in text


#: Of loops in closed form: a spring, and friction that turns at once, in one sample only.
TRUTH = {"shear.stiffness": 80.0, "spin_friction.strength": 0.05}
SLACK, SLIDING = 0.4e-3, 0.3


def _loop(length: float, values: Mapping[str, float]) -> ResponseCurve:
    u = 0.1 * length * np.sin(np.pi * np.linspace(0, 1, 41))
    way = np.where(np.arange(u.size) <= 20, 1.0, -1.0) * (length == SLIDING)
    way[0] = 0.0
    slopes = np.stack([u / length, way], axis=1)
    force = slopes @ [values[name] for name in TRUTH]
    return ResponseCurve(u, force, 0 * u, slopes, (0, 20, 40), 0.0)


@pytest.fixture
def loops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fit:
    """Return a fit to three samples on a machine with slack, the second of which has two tests."""

    def curves(
        objective: Objective, values: Mapping[str, float], scale: float
    ) -> list[ResponseCurve]:  # in place of runs
        return [_loop(test.case.sheet.length, values) for test in objective._fit.tests]

    monkeypatch.setattr(Objective, "_curves", curves)
    friction = "spin_friction: {law: coulomb, strength: 1 N/m}"
    (tmp_path / "case.yaml").write_text(CASE.replace("60 N/m}", f"60 N/m}}\n  {friction}"))
    tests = []
    for length in (0.2, SLIDING, 0.4):
        made = _loop(length, TRUTH)
        rows = zip((made.displacement + SLACK).tolist(), made.force.tolist(), strict=True)
        text = "\n".join(["u_m,F_N", *(f"{u!r},{f!r}" for u, f in rows)])
        (tmp_path / f"{length}.csv").write_text(text + "\n")
        sizes = json.dumps({"sheet.length": f"{length} m"})
        tests.append(f"  - {{case: case.yaml, set: {sizes}, measured: {length}.csv, error: 0.5 %}}")
    parameters = [
        "  shear.stiffness: {start: 60 N/m}",
        "  spin_friction.strength: {start: 0.04 N/m}",
        "  machine.displacement: {bounds: [-1 mm, 1 mm]}",
    ]
    lines = ["refine: false", "tests:", *tests, tests[1], "parameters:", *parameters, ""]
    (tmp_path / "fit.yaml").write_text("\n".join(lines))
    return read_fit(tmp_path / "fit.yaml", leave_out=True)


def test_a_left_out_test_is_compared_as_the_fit_to_it_compares_it(
    loops: Fit, tmp_path: Path
) -> None:
    """The same rows, without those that slack takes away or friction decides within a step."""
    one = predicted(loops, (0,), tmp_path)
    with Objective(loops, tmp_path) as objective:
        objective.choose_rows(one.values, 1.0)
        same = objective.evaluate(one.values).comparisons[0]
    (own,) = one.evaluation.comparisons
    np.testing.assert_array_equal(own.rows, same.rows)
    np.testing.assert_array_equal(own.computed, same.computed)
    assert one.misfits == (same.misfit,)
    assert own.rows.size == 41  # with the slack that the others tell, the program reaches all
    assert one.values["machine.displacement"] == pytest.approx(SLACK, rel=1e-3)
    assert one.misfits[0] < 1e-4


def test_tests_of_one_run_are_left_out_together(loops: Fit, tmp_path: Path) -> None:
    assert experiments(loops.tests) == ((0,), (1, 3), (2,))
    one = predicted(loops, (1, 3), tmp_path)
    assert one.names == ("0.3.csv", "0.3.csv")
    assert one.misfits[0] == one.misfits[1]


def test_a_parameter_that_the_others_do_not_determine_is_said(loops: Fit, tmp_path: Path) -> None:
    """Friction acts in the second sample alone: without that nothing tells it."""
    known = {
        tests: {i.name: i.determined for i in predicted(loops, tests, tmp_path).known.intervals}
        for tests in experiments(loops.tests)
    }
    assert known[0,]["spin_friction.strength"] and known[2,]["spin_friction.strength"]
    assert not known[1, 3]["spin_friction.strength"] and known[1, 3]["shear.stiffness"]
    one = predicted(loops, (1, 3), tmp_path)
    assert any("spin_friction.strength" in note for note in one.notes)
    # Where a search leaves such a value is chance, but it must not be what the left-out test tells.
    assert one.values["spin_friction.strength"] != pytest.approx(0.05, rel=0.05)
    assert one.misfits[0] > 1e-3


def test_a_file_with_one_experiment_is_refused(loops: Fit, tmp_path: Path) -> None:
    del loops
    lines = (tmp_path / "fit.yaml").read_text().splitlines()
    kept = [line for line in lines if "0.2.csv" not in line and "0.4.csv" not in line]
    (tmp_path / "one.yaml").write_text("\n".join(kept))
    assert len(read_fit(tmp_path / "one.yaml").tests) == 2
    with pytest.raises(CaseError) as caught:
        read_fit(tmp_path / "one.yaml", leave_out=True)
    (problem,) = caught.value.problems
    assert problem.file.endswith("one.yaml") and problem.line is not None and problem.remedy
