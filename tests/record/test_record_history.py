from dataclasses import replace
from math import inf, nan, pi
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from wovenfab.record.history import (
    ERRORS,
    HISTORY,
    REACTIONS,
    HistoryRows,
    HistoryWriter,
    index_of_peak,
    peak_force,
    read_history,
)
from wovenfab.stepping.step import Step

FIRST = Step(
    number=0,
    time=0.0,
    displacement=0.0,
    reactions={"left": (0.0, 0.0), "right": (0.0, 0.0)},
    stored={"stretch": 0.5, "bending": 0.25},
    dissipated={"slip_friction": 0.0},
    work=0.0,
    iterations=0,
    cutbacks=0,
    milestone=None,
)
SECOND = replace(
    FIRST,
    number=1,
    time=1 / 3,
    displacement=1e-3 * pi,
    reactions={"left": (-2 / 7, 0.1), "right": (2 / 7, -0.1)},
    stored={"bending": 1.25, "stretch": 1.5},
    dissipated={"slip_friction": 0.125},
    work=4.0,
    iterations=5,
    negatives=2,
    force=np.float64(2 / 7),
    force_transverse=-1e-17,
)


def start(directory: Path, errors: bool = False) -> HistoryWriter:
    names = ["stretch", "bending"], ["slip_friction"], ["left", "right"]
    return HistoryWriter(directory, HistoryRows(*names, errors))


@pytest.fixture
def both(tmp_path: Path) -> Path:
    """A directory with the history of both steps."""
    with start(tmp_path) as history:
        history.append(FIRST)
        history.append(SECOND)
    return tmp_path


def test_the_columns_are_the_promised_ones(tmp_path: Path) -> None:
    start(tmp_path).close()
    assert (tmp_path / "history.csv").read_text() == (
        "step,time_s,displacement_m,force_N,force_transverse_N,energy_J,energy_stretch_J,"
        "energy_bending_J,dissipated_J,dissipated_slip_friction_J,work_J,imbalance_J,"
        "newton_iterations,negative_eigenvalues\n"
    )
    assert (tmp_path / "reactions.csv").read_text() == (
        "step,time_s,left_x_N,left_y_N,right_x_N,right_y_N\n"
    )


def test_dissipated_energy_has_its_column_without_dissipative_effects(tmp_path: Path) -> None:
    with HistoryWriter(tmp_path, HistoryRows(["stretch"], [], [])) as history:
        history.append(replace(FIRST, stored={"stretch": 1.0}, dissipated={}, reactions={}))
    assert read_history(tmp_path)["dissipated_J"].tolist() == [0.0]


def test_numbers_come_back_to_the_last_bit(both: Path) -> None:
    table, reactions = read_history(both), read_history(both, REACTIONS)
    assert table["time_s"][1] == SECOND.time
    assert table["displacement_m"][1] == SECOND.displacement
    assert table["force_N"][1] == SECOND.force
    assert table["force_transverse_N"][1] == SECOND.force_transverse
    assert table["energy_bending_J"][1] == 1.25
    assert table["newton_iterations"].tolist() == [0, 5]
    assert table["negative_eigenvalues"].tolist() == [0, 2]
    assert [reactions[f"{edge}_{xy}_N"][1] for edge in ("left", "right") for xy in "xy"] == [
        *SECOND.reactions["left"],
        *SECOND.reactions["right"],
    ]


def test_totals_and_imbalance_follow_from_the_rows(both: Path) -> None:
    table = read_history(both)
    assert table["energy_J"].tolist() == [0.75, 2.75]
    assert table["dissipated_J"].tolist() == [0.0, 0.125]
    assert table["imbalance_J"].tolist() == [0.0, 4.0 - 2.0 - 0.125]


def test_a_row_is_on_disk_before_the_next_one(tmp_path: Path) -> None:
    with start(tmp_path) as history:
        history.append(FIRST)
        for name in (HISTORY, REACTIONS):
            assert len(read_history(tmp_path, name)["step"]) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"displacement": nan}, "not finite"),
        ({"work": inf}, "not finite"),
        ({"force": nan}, "not finite"),
        ({"stored": {"stretch": 1.0, "bending": -inf}}, "not finite"),
        ({"reactions": {"left": (0.0, nan), "right": (0.0, 0.0)}}, "not finite"),
        ({"stored": {"stretch": 1.0}}, "but the history has"),
        ({"dissipated": {}}, "but the history has"),
        ({"reactions": {"top": (0.0, 0.0)}}, "but the history has"),
        ({"time": FIRST.time}, "comes after"),
    ],
)
def test_what_is_refused_reaches_no_file(tmp_path: Path, change: dict, message: str) -> None:
    with start(tmp_path) as history:
        history.append(FIRST)
        with pytest.raises(ValueError, match=message):
            history.append(replace(SECOND, **change))
        history.append(SECOND)
    for name in (HISTORY, REACTIONS):
        assert read_history(tmp_path, name)["step"].tolist() == [0, 1]


def test_errors_of_steps_have_columns_where_they_are_announced(tmp_path: Path) -> None:
    with start(tmp_path, errors=True) as history:
        history.append(replace(FIRST, force_error=0.5, dissipated_error=-0.25))
    table = read_history(tmp_path)
    assert [float(table[name][0]) for name in ERRORS] == [0.5, -0.25]


@pytest.mark.parametrize(
    ("forces", "peak"),
    [([0.0, 2.0, 1.0], 2.0), ([0.0, 2.0, -3.0], -3.0), ([0.0, -2.0, 2.0], -2.0)],
)
def test_the_peak_is_the_recorded_force_of_largest_size_with_its_sign(
    forces: list[float], peak: float
) -> None:
    assert peak_force(forces) == peak_force(np.array(forces)) == peak
    assert forces[index_of_peak(forces)] == peak


def test_a_row_that_a_killed_run_left_unfinished_is_dropped(both: Path) -> None:
    path = both / "history.csv"
    path.write_text(path.read_text()[:-7])
    assert read_history(both)["step"].tolist() == [0]


def test_a_history_without_rows_has_empty_columns(tmp_path: Path) -> None:
    start(tmp_path).close()
    assert read_history(tmp_path)["force_N"].shape == (0,)


@pytest.mark.mpi
def test_all_ranks_call_and_one_writes(shared_path: Path) -> None:
    with start(shared_path) as history:
        history.append(FIRST)
        with pytest.raises(ValueError, match="not finite"):
            history.append(replace(SECOND, work=nan))
        history.append(SECOND)
    MPI.COMM_WORLD.Barrier()
    assert read_history(shared_path)["step"].tolist() == [0, 1]
