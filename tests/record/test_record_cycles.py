from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from wovenfab.record.summary import cycles, read_cycles, window, write_cycles

PERIOD, AMPLITUDE, STIFFNESS, VISCOSITY = 2.0, 0.04, 3e3, 50.0
SLIDER, DRIFT = 7.0, 1e-3
#: Work of the damper over A/2 (1 - cos(2 pi t/T)).
LOSS = VISCOSITY * (AMPLITUDE * np.pi) ** 2 / (2 * PERIOD)
TWO = [(0.0, PERIOD), (PERIOD, 2 * PERIOD)]


def spring_and_damper(periods: float, rows: int) -> dict[str, NDArray[np.float64]]:
    time = np.linspace(0, periods * PERIOD, rows)
    phase = 2 * np.pi * time / PERIOD
    u = AMPLITUDE / 2 * (1 - np.cos(phase))
    rate = AMPLITUDE * np.pi / PERIOD * np.sin(phase)
    lost = LOSS * (phase / (2 * np.pi) - np.sin(2 * phase) / (4 * np.pi))
    force = STIFFNESS * u + VISCOSITY * rate
    return {
        "time_s": time,
        "displacement_m": u,
        "force_N": force,
        "energy_J": STIFFNESS / 2 * u**2,
        "work_J": STIFFNESS / 2 * u**2 + lost,
        "dissipated_J": lost,
        "imbalance_J": DRIFT * time,
    }


def spring_and_slider() -> dict[str, NDArray[np.float64]]:
    """Out and back at constant speed, from +f to -f, with a row on either side of each turn."""
    u = np.array([0, AMPLITUDE, AMPLITUDE, 0.0])
    friction = SLIDER * np.array([1, 1, -1, -1])
    time = np.array([0, 1, 1 + 1e-12, 2])
    return {
        "time_s": time,
        "displacement_m": u,
        "force_N": STIFFNESS * u + friction,
        "energy_J": STIFFNESS / 2 * u**2,
        "work_J": STIFFNESS / 2 * u**2 + SLIDER * AMPLITUDE * np.array([0, 1, 1, 2]),
        "dissipated_J": SLIDER * AMPLITUDE * np.array([0, 1, 1, 2]),
        "imbalance_J": 0 * time,
    }


def test_the_loop_area_is_the_dissipated_energy_of_each_cycle() -> None:
    found = cycles(spring_and_damper(2, 801), TWO)
    assert [cycle.complete for cycle in found] == [True, True]
    for cycle in found:
        assert cycle.dissipated == pytest.approx(LOSS, rel=1e-12)
        assert cycle.loop_area == pytest.approx(LOSS, rel=1e-12)
        assert cycle.peak_displacement == pytest.approx(AMPLITUDE, rel=1e-12)


def test_the_peak_force_is_the_one_of_largest_size() -> None:
    history = spring_and_damper(1, 401)
    history["force_N"] = -history["force_N"]
    peak = cycles(history, TWO[:1])[0].peak_force
    assert peak == pytest.approx(history["force_N"].min())
    assert peak < -STIFFNESS * AMPLITUDE


def test_boundaries_between_two_steps_share_the_loss_out() -> None:
    found = cycles(spring_and_damper(2, 1009), TWO)
    assert found[0].dissipated == pytest.approx(LOSS, rel=1e-3)
    assert found[0].loop_area == pytest.approx(LOSS, rel=2e-3)
    assert sum(cycle.dissipated for cycle in found) == pytest.approx(2 * LOSS, rel=1e-12)


def test_a_cycle_that_the_run_did_not_finish_says_so() -> None:
    history = spring_and_damper(1.5, 601)
    found = cycles(history, [*TWO, (2 * PERIOD, 3 * PERIOD)])
    assert [cycle.complete for cycle in found] == [True, False]
    assert found[1].end == 2 * PERIOD
    assert found[1].dissipated == pytest.approx(LOSS / 2, rel=1e-9)


def test_a_run_that_ends_a_rounding_error_early_has_finished_its_cycle() -> None:
    history = spring_and_damper(1 - 1e-15, 101)
    assert [c.complete for c in cycles(history, TWO)] == [True]


def test_what_comes_before_and_between_cycles_belongs_to_none() -> None:
    history = spring_and_damper(3, 1201)
    (found,) = cycles(history, [(PERIOD, 2 * PERIOD)])
    assert (found.start, found.end) == (PERIOD, 2 * PERIOD)
    assert found.dissipated == pytest.approx(LOSS, rel=1e-9)


def test_a_window_takes_the_rows_around_it_alone() -> None:
    """So that the figures of many cycles cost no more than the rows of all of them."""
    history = spring_and_damper(3, 1201)
    times = history["time_s"]
    for start, end in ((times[7], times[400]), (0.3, 4.21), (times[9] + 1e-12, 9.0), (0.0, 0.7)):
        part = window(history, start, end)
        assert part["time_s"][0] == start and part["time_s"][-1] == min(end, times[-1])
        for name, values in history.items():
            expected = np.interp(part["time_s"], times, values)
            np.testing.assert_allclose(part[name], expected, rtol=1e-14)


def test_a_run_without_a_step_has_no_cycles() -> None:
    assert cycles(spring_and_damper(0, 1), TWO[:1]) == []


def test_the_figures_of_a_spring_beside_a_damper() -> None:
    history = spring_and_damper(2, 4001)
    for number, cycle in enumerate(cycles(history, TWO)):
        stored = STIFFNESS / 2 * AMPLITUDE**2
        assert cycle.peak_time == pytest.approx((number + 0.5) * PERIOD)
        assert cycle.secant_stiffness == pytest.approx(STIFFNESS)  # no speed at either end
        assert cycle.residual_force == pytest.approx(0, abs=1e-9)
        assert cycle.stored_at_peak == pytest.approx(stored)
        assert cycle.loss_ratio == pytest.approx(LOSS / stored, rel=1e-5)
        assert cycle.imbalance == pytest.approx(DRIFT * PERIOD)


def test_the_figures_of_a_spring_beside_a_slider() -> None:
    (cycle,) = cycles(spring_and_slider(), [(0, 2)])
    assert cycle.residual_force == pytest.approx(-SLIDER)
    assert cycle.secant_stiffness == pytest.approx(STIFFNESS)
    assert cycle.loop_area == pytest.approx(2 * SLIDER * AMPLITUDE)
    assert cycle.loss_ratio == pytest.approx(4 * SLIDER / (STIFFNESS * AMPLITUDE))


def test_the_reversal_is_farthest_from_where_the_cycle_began() -> None:
    history = spring_and_damper(1, 401)
    history["displacement_m"] = 2 * AMPLITUDE - history["displacement_m"]
    (cycle,) = cycles(history, [(0, PERIOD)])
    assert cycle.peak_displacement == pytest.approx(AMPLITUDE)
    assert cycle.secant_stiffness == pytest.approx(-STIFFNESS)


def test_what_means_nothing_is_none() -> None:
    history = spring_and_damper(0.75, 301)
    assert cycles(history, [(0, PERIOD)])[0].loss_ratio is None  # half a loop has no area
    still = history | {"displacement_m": 0 * history["time_s"], "energy_J": 0 * history["time_s"]}
    (cycle,) = cycles(still, [(0, 0.75 * PERIOD)])
    assert (cycle.loss_ratio, cycle.secant_stiffness) == (None, None)


def test_the_table_has_plain_numbers_whatever_they_were_computed_with(tmp_path: Path) -> None:
    travel = np.float64(2.0)
    write_cycles(tmp_path, spring_and_damper(2, 801), TWO, None, travel)
    rows, found = read_cycles(tmp_path), cycles(spring_and_damper(2, 801), TWO, 2.0)
    for row, cycle in zip(rows, found, strict=True):
        assert float(row["secant_stiffness_N_per_m"]) == cycle.secant_stiffness
