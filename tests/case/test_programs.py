"""The programs of laboratories: repeats, trapezoids, sweeps, thinned tables; their ready cases."""

from __future__ import annotations

import time
from itertools import pairwise
from math import pi
from pathlib import Path

import numpy as np
import pytest

import wovenfab
from wovenfab.case import CaseError, read_case
from wovenfab.case.program import program_of_case
from wovenfab.case.samples import thinned
from wovenfab.cli.check import check_case

CONFIGS = Path(__file__).parents[2] / "configs"
READY = sorted((CONFIGS / "programs").glob("*.yaml"))
BIAS = CONFIGS / "bias-1x3.yaml"
COARSE = {"discretisation": {"degree": 2, "mesh_size": "150 mm"}, "time.steps_per_cycle": 4}


@pytest.mark.parametrize("path", READY, ids=lambda path: path.stem)
def test_ready_programs_are_valid_and_begin(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert check_case(path, []) == 0
    told = capsys.readouterr().out
    assert "the case is valid" in told and "warning" not in told
    steps = wovenfab.steps(read_case(path, COARSE))
    assert [next(steps).number for _ in range(3)] == [0, 1, 2]


def test_cycles_repeat_at_each_frequency_or_velocity() -> None:
    text = "program={type: cycles, amplitudes: '20, 40 mm', repeat: 2, %s}"
    case = read_case(BIAS, [text % "frequency: '1, 2 Hz'"])
    turns = [(a, t) for t in (1.0, 0.5) for _ in (1, 2) for a in (0.02, 0.04)]
    assert list(case.program[0].turns()) == turns  # type: ignore[union-attr]
    assert len(program_of_case(case).cycles) == 8
    assert case.planned_steps == len(program_of_case(case).milestones) - 1 == 8 * 80
    case = read_case(BIAS, [text % "max_velocity: '0.1, 0.5 m/s'"])
    periods = [end - start for start, end in program_of_case(case).cycles]
    expected = [pi * a / v for v in (0.1, 0.5) for _ in (1, 2) for a in (0.02, 0.04)]
    assert periods == pytest.approx(expected)


def test_a_trapezoid_is_ramp_hold_ramp_and_rest_and_a_cycle() -> None:
    case = read_case(CONFIGS / "programs" / "trapezoid.yaml")
    program = program_of_case(case)
    way = [(0.4, 0.04), (2.4, 0.04), (2.8, 0.0), (3.8, 0.0), (4.2, 0.04), (7.6, 0.0)]
    assert [program.value(t) for t, _ in way] == pytest.approx([u for _, u in way])
    assert program.cycles == [(0.0, pytest.approx(3.8)), (pytest.approx(3.8), pytest.approx(7.6))]
    assert case.planned_steps == len(program.milestones) - 1 == 160


def test_a_trapezoid_of_a_force_is_refused_with_the_way_to_do_it() -> None:
    path = CONFIGS / "programs" / "trapezoid.yaml"
    with pytest.raises(CaseError, match=r"a trapezoid goes to a displacement, not to a force\. W"):
        read_case(path, ["program.to=40 N"])
    # a duration, which a force has elsewhere, is not told to be an unknown key
    with pytest.raises(CaseError) as refused:
        read_case(path, ["program={type: trapezoid, to: 40 N, duration: 4 s, hold: 2 s}"])
    assert len(refused.value.problems) == 1
    assert "not to a force. Write two ramps with a duration" in str(refused.value)


def fewest_rows(rows: list[tuple[float, float]], tolerance: float) -> int:
    """Return the number of pieces of the best path through rows alone."""
    best = [0] + [len(rows)] * (len(rows) - 1)
    for i, (t, u) in enumerate(rows):
        low, high = -np.inf, np.inf
        for j in range(i + 1, len(rows)):
            since, moved = rows[j][0] - t, rows[j][1] - u
            if low <= moved / since <= high:
                best[j] = min(best[j], best[i] + 1)
            low, high = (
                max(low, (moved - tolerance) / since),
                min(high, (moved + tolerance) / since),
            )
    return best[-1]


@pytest.mark.parametrize("seed", range(40))
def test_thinned_rows_stay_close_and_no_path_through_rows_is_shorter(seed: int) -> None:
    random = np.random.default_rng(seed)
    times = np.cumsum(random.uniform(0.1, 1, 50))
    rows = list(zip(times.tolist(), np.cumsum(random.uniform(0, 1, 50)).tolist(), strict=True))
    corners = thinned(rows, 0.3)
    assert corners[0] == rows[0] and corners[-1] == rows[-1]
    assert all(a[0] < b[0] for a, b in pairwise(corners))
    at = np.union1d(times, [t for t, _ in corners])
    distance = np.interp(at, *np.transpose(rows)) - np.interp(at, *np.transpose(corners))
    assert np.abs(distance).max() <= 0.3 * (1 + 1e-9)
    assert len(corners) - 1 <= fewest_rows(rows, 0.3)


def test_ten_thousand_rows_are_thinned_in_no_time_and_reversals_are_kept() -> None:
    times = np.linspace(0, 100, 10_001)
    rows = list(zip(times.tolist(), (1 - np.cos(times)).tolist(), strict=True))
    start = time.perf_counter()
    corners = thinned(rows, 0.01)
    assert time.perf_counter() - start < 2
    assert len(corners) < 300
    turns = [row for a, row, b in zip(rows, rows[1:], rows[2:], strict=False)
             if (row[1] - a[1]) * (b[1] - row[1]) < 0]  # fmt: skip
    assert len(turns) == 31 and set(turns) <= set(corners)


def test_a_thinned_table_says_what_is_left_and_its_pieces_are_divided() -> None:
    case = read_case(CONFIGS / "programs" / "measured.yaml")
    (words,) = case.remarks()
    left = len(case.program[0].samples.times)  # type: ignore[union-attr]
    assert words == f"measured.csv: {left} of 601 rows are left within 0.0001 m" and left < 20
    assert 100 <= case.planned_steps == len(program_of_case(case).milestones) - 1 < 120


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("sheet.length=320", "sheet.length: is 320 m meant?"),
        ("sheet.length=300 m", "is written '300 mm'"),
        ("effects.shear.stiffness=4e8 N/m", "shear.stiffness: is 4e+08 N/m meant? Usual are 0.01"),
        ("program.max_velocity=50 m/s", "max_velocity: is 50 m/s meant?"),
        ("program.amplitudes=[20 mm, 40 m]", "program.amplitudes.1: is 40 m meant?"),
    ],
)
def test_what_is_probably_not_meant_is_asked_back(change: str, told: str) -> None:
    (line,) = read_case(BIAS, [change]).remarks()
    assert line.startswith("warning: --set ") and told in line


@pytest.mark.parametrize(
    "change",
    [
        "sheet.length=320",
        "discretisation.mesh_size=5 mm",
        "discretisation.corner_size=1e-45 m",
        "program={type: cycles, amplitudes: 20 mm, frequency: 1 Hz, repeat: 20000}",
    ],
)
def test_check_answers_soon_whatever_the_numbers(change: str) -> None:
    check_case(BIAS, [])  # imports
    start = time.process_time()  # whatever else the machine does
    assert check_case(BIAS, [change]) == 0
    assert time.process_time() - start < 2
