"""A run with an accuracy that cannot be reached: it says so before, and goes on with the best."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from wovenfab.case import read_case
from wovenfab.cli.run import run_case
from wovenfab.study.errors import choice

CASE = Path(__file__).parents[2] / "configs" / "elastic-1x3.yaml"
SMALL = "{type: ramp, to: 20 mm, steps: 4}"


@pytest.mark.slow
def test_a_run_tells_at_once_what_cannot_be_reached_and_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(choice, "PATIENCE", (20.0, 20.0))
    overrides = "accuracy=0.001 %", "discretisation=null", f"program={SMALL}"
    code = run_case(CASE, tmp_path, [*overrides, "output.pictures=false"], overwrite=True)
    said = capsys.readouterr().out
    warning = "warning: the accuracy of 0.001 % is not reached: the next finer elements have"
    assert code == 0
    assert said.index(warning) < said.index("stepping") < said.rindex(warning)
    summary = json.loads((tmp_path / "summary.json").read_text())
    told = summary["accuracy"]["figures"]["peak_force_N"]
    assert "unknowns" in summary["accuracy"]["shortfall"]
    assert 1e-5 < told["relative_error"] < 0.01
    assert told["error"] == pytest.approx(told["relative_error"] * summary["peak_force_N"])
    assert abs(summary["peak_force_N"] / 122.110 - 1) < 2 * told["relative_error"]
    case = read_case(tmp_path / "case.yaml")
    assert case.discretisation.degree == 5
    assert case.accuracy is None
