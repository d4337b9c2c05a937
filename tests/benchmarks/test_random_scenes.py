"""Scenes drawn at random: they are valid, differ, and are the same for the same seed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.random_page import KINDS, costs, figures
from benchmarks.random_scenes import ACCURACY, Row, compared, scene, table
from wovenfab.case import read_case
from wovenfab.study.accuracy import SHORTER, finer_case
from wovenfab.study.runner import Ended


def test_scenes_are_valid_and_of_all_kinds(tmp_path: Path) -> None:
    titles = [read_case(scene(number, 1, tmp_path)).title for number in range(1, 61)]
    assert len(set(titles)) > 12
    for kind in ("hole", "dogbone", "rectangle", "coupling", "slip_friction", "spin", "ramp"):
        assert any(kind in title for title in titles)


def test_a_scene_depends_on_its_number_and_the_seed_alone(tmp_path: Path) -> None:
    texts = [scene(*of, tmp_path).read_text() for of in ((7, 1), (8, 1), (7, 2), (7, 1))]
    assert texts[0] == texts[3]
    assert len(set(texts)) == 3


@pytest.mark.parametrize(("degree", "other", "mesh_size"), [(4, 5, 0.012), (5, 4, 0.008)])
def test_the_reference_has_finer_cells_of_another_degree_and_more_steps(
    degree: int, other: int, mesh_size: float, tmp_path: Path
) -> None:
    chosen = {
        "accuracy": None,
        "discretisation": {"degree": degree, "mesh_size": "20 mm"},
        "program": {"type": "ramp", "to": "3 mm", "steps": 20, "velocity": "1 mm/s"},
    }
    resolved = tmp_path / "case.yaml"
    resolved.write_text(read_case(scene(1, 1, tmp_path), chosen).to_yaml())
    finer = finer_case(read_case(resolved))
    assert finer.discretisation.degree == other
    assert finer.discretisation.mesh_size == pytest.approx(mesh_size)
    assert finer.program[0].steps == 20 * SHORTER


def test_the_reference_of_an_elastic_sheet_keeps_its_steps_which_have_no_error(
    tmp_path: Path,
) -> None:
    elastic = {"accuracy": None, "discretisation": {"degree": 3, "mesh_size": "20 mm"}}
    case = read_case(scene(2, 1, tmp_path), elastic)
    finer = finer_case(case)
    assert not case.needs.history
    assert (finer.program, finer.time) == (case.program, case.time)
    assert finer.discretisation.degree == 4


def test_rows_tell_reached_accuracy_from_honesty(tmp_path: Path) -> None:
    good = Row(1, "", 1, 1, 5.0, 3.0, 0.6 * ACCURACY, 0.7 * ACCURACY, "")
    slow = replace(good, scene=2, seconds=500.0)
    liar = replace(good, scene=3, true=0.8 * ACCURACY)
    wrong = replace(good, scene=4, true=1.1 * ACCURACY)
    unknown = replace(good, scene=5, true=None)
    words = table([good, slow, liar, wrong, unknown])
    assert good.is_good and good.is_honest and not slow.is_good and not liar.is_honest
    assert not wrong.is_good and unknown.is_good
    without = Ended(3, "", "", 1.0, "no end")
    assert compared(good, tmp_path, without).is_good
    assert not compared(replace(good, reason="it fell short"), tmp_path, without).is_good
    assert replace(unknown, stated=np.nextafter(ACCURACY, 1)).is_good  # by rounding alone
    assert "3 of 5 within 1 % and 60 s" in words
    assert "stated one: 3, 4 of 4 with a reference." in words


def test_rows_that_fell_short_are_compared_too_and_failed_runs_and_references_are_not() -> None:
    ran = Row(1, "", 900, 20, 5.0, 3.0, 0.02, None, "")
    assert ran.lacks_reference and replace(ran, reason="it fell short").lacks_reference
    assert not replace(ran, true=0.01).lacks_reference
    assert not replace(ran, unknowns=0, stated=None, reason="no end within 300 s").lacks_reference


@pytest.mark.parametrize("reason", ["", "it fell short"])
def test_the_true_error_is_the_largest_against_the_reference(reason: str, tmp_path: Path) -> None:
    made = Row(1, "", 900, 20, 5.0, 3.0, 0.02, None, reason)
    where = {"peak_force_at_m": 0.1}
    for name, force, loss in (("run", 101.0, 1.94), ("reference", 100.0, 2.0)):
        (tmp_path / name).mkdir()
        figures = {"peak_force_N": force, "dissipated_J": loss, **where}
        (tmp_path / name / "summary.json").write_text(json.dumps(figures))
    failed = compared(made, tmp_path, Ended(3, "", "", 1.0, "step 4 failed"))
    assert failed.true is None and not failed.lacks_reference
    assert failed.reason.startswith(reason) and failed.reason.endswith("step 4 failed")
    right = compared(made, tmp_path, Ended(0, "", "", 1.0))
    assert right.true == pytest.approx(0.03) and right.reason == reason


def test_figures_are_missed_by_rows_that_are_late_dishonest_or_mostly_search() -> None:
    good = Row(1, "", 1, 1, 5.0, 2.0, 0.6 * ACCURACY, 0.6 * ACCURACY, "")
    late, liar = replace(good, seconds=61.0, pilot=1.0), replace(good, true=0.9 * ACCURACY)
    short, searched = replace(good, reason="short", pilot=61.0), replace(good, pilot=4.0)

    def missed(row: Row, foreseen: int = 1) -> list[str]:
        return [figure.name for figure in figures([row], [], foreseen) if not figure.kept]

    assert missed(good) == []
    assert missed(late) == ["1 % within 60 s"]
    assert missed(liar) == ["1 %, honest"]
    assert missed(searched) == ["share of the search in the time"]
    assert missed(good, 0) == ["time that check expects within a factor of 3"]
    assert "longest search that fell short" in missed(short)
    assert any("0.3 %" in figure.name for figure in figures([good], [good], 1))


def test_what_an_accuracy_costs_counts_what_reached_it_in_time_by_kind() -> None:
    accuracy, wanted = 0.003, 300.0
    good = Row(1, "", 1, 1, 100.0, 3.0, 0.9 * accuracy, None, "")
    rows = [good, replace(good, seconds=301.0), replace(good, stated=2 * accuracy)]
    kinds = [KINDS[0], KINDS[0], KINDS[4]]
    assert costs(rows, kinds, accuracy, wanted) == [
        ["0.3 %", KINDS[0], "200 s", "281 s", "300 s", "1 of 2"],
        ["0.3 %", KINDS[4], "100 s", "100 s", "300 s", "0 of 1"],
        ["0.3 %", "all", "100 s", "261 s", "300 s", "1 of 3"],
    ]
