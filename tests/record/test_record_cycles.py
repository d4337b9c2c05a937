import numpy as np
import pytest
from numpy.typing import NDArray

from wovenfab.record.cycles import cycles

PERIOD, AMPLITUDE, STIFFNESS, VISCOSITY = 2.0, 0.04, 3e3, 50.0
#: Work of the damper over A/2 (1 - cos(2 pi t/T)).
LOSS = VISCOSITY * (AMPLITUDE * np.pi) ** 2 / (2 * PERIOD)
TWO = [(0.0, PERIOD), (PERIOD, 2 * PERIOD)]


def spring_and_damper(time: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    phase = 2 * np.pi * time / PERIOD
    u = AMPLITUDE / 2 * (1 - np.cos(phase))
    rate = AMPLITUDE * np.pi / PERIOD * np.sin(phase)
    lost = LOSS * (phase / (2 * np.pi) - np.sin(2 * phase) / (4 * np.pi))
    force = STIFFNESS * u + VISCOSITY * rate
    return {"time_s": time, "displacement_m": u, "force_N": force, "dissipated_J": lost}


def test_the_loop_area_is_the_dissipated_energy_of_each_cycle() -> None:
    found = cycles(spring_and_damper(np.linspace(0, 2 * PERIOD, 801)), TWO)
    assert [cycle.complete for cycle in found] == [True, True]
    for cycle in found:
        assert cycle.dissipated == pytest.approx(LOSS, rel=1e-12)
        assert cycle.loop_area == pytest.approx(LOSS, rel=1e-3)
        assert cycle.peak_displacement == pytest.approx(AMPLITUDE, rel=1e-12)


def test_the_peak_force_is_the_one_of_largest_size() -> None:
    history = spring_and_damper(np.linspace(0, PERIOD, 401))
    history["force_N"] = -history["force_N"]
    peak = cycles(history, TWO[:1])[0].peak_force
    assert peak == pytest.approx(history["force_N"].min())
    assert peak < -STIFFNESS * AMPLITUDE


def test_boundaries_between_two_steps_share_the_loss_out() -> None:
    found = cycles(spring_and_damper(np.linspace(0, 2 * PERIOD, 1009)), TWO)
    assert found[0].dissipated == pytest.approx(LOSS, rel=1e-3)
    assert found[0].loop_area == pytest.approx(LOSS, rel=2e-3)
    assert sum(cycle.dissipated for cycle in found) == pytest.approx(2 * LOSS, rel=1e-12)


def test_a_cycle_that_the_run_did_not_finish_says_so() -> None:
    history = spring_and_damper(np.linspace(0, 1.5 * PERIOD, 601))
    found = cycles(history, [*TWO, (2 * PERIOD, 3 * PERIOD)])
    assert [cycle.complete for cycle in found] == [True, False]
    assert found[1].end == 2 * PERIOD
    assert found[1].dissipated == pytest.approx(LOSS / 2, rel=1e-9)


def test_a_run_that_ends_a_rounding_error_early_has_finished_its_cycle() -> None:
    history = spring_and_damper(np.linspace(0, PERIOD * (1 - 1e-15), 101))
    assert [c.complete for c in cycles(history, TWO)] == [True]


def test_what_comes_before_and_between_cycles_belongs_to_none() -> None:
    history = spring_and_damper(np.linspace(0, 3 * PERIOD, 1201))
    (found,) = cycles(history, [(PERIOD, 2 * PERIOD)])
    assert (found.start, found.end) == (PERIOD, 2 * PERIOD)
    assert found.dissipated == pytest.approx(LOSS, rel=1e-9)


def test_a_run_without_a_step_has_no_cycles() -> None:
    assert cycles(spring_and_damper(np.zeros(1)), TWO[:1]) == []
