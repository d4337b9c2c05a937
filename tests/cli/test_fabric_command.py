"""A test is run with a fabric, goes on by itself, and its page says what the fabric is."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.case.test_case_fabric import FABRIC, TEST
from wovenfab.case import read_case
from wovenfab.cli.run import run_case
from wovenfab.record.history import read_history
from wovenfab.report.pages import write_run_page

FAST = ["discretisation={degree: 2, mesh_size: 50 mm}", "output.pictures=false"]


def test_a_test_with_a_fabric_runs_and_goes_on_without_their_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    test, fabric, results = Path("strip.yaml"), Path("glass.yaml"), Path("results/strip-glass")
    test.write_text(TEST.replace("steps: 4", "steps: 4, duration: 4 s"))
    fabric.write_text(FABRIC)
    case = read_case(test, FAST, fabric)
    assert run_case(test, None, FAST, fabric=fabric, until="2 s") == 0
    test.unlink()
    fabric.unlink()
    assert read_case(results / "case.yaml") == case
    fabric_renamed = "fabric.name=Another name"  # which is no physics
    assert run_case(results / "case.yaml", results, [fabric_renamed], resume=True) == 0
    assert read_history(results)["time_s"][-1] == 4.0
    page = write_run_page(results).read_text(encoding="utf-8")
    for text in ("A strip: Another name", "a table", "stretch, 50 kN/m"):
        assert text in page
