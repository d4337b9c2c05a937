"""The peak force: recorded under this name everywhere, and what steps miss of it."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from benchmarks.probe import CASE, sample
from wovenfab.case import read_case
from wovenfab.case.objects import sheet_of
from wovenfab.study.force_curve import ForceCurve
from wovenfab.study.response import response_of


def peak_bound_of(times: np.ndarray, forces: np.ndarray) -> float:
    return ForceCurve(times, forces).peak_bound()[1]


def test_the_peak_of_a_parabola_is_exact_whatever_the_steps() -> None:
    times = np.array([0.0, 0.1, 0.3, 0.5, 0.9, 1.6, 2.0, 2.1, 2.3])
    forces = 4 - (times - 1) ** 2
    assert peak_bound_of(times, forces) == pytest.approx(4, rel=1e-5)
    assert peak_bound_of(times, -forces) == pytest.approx(-4, rel=1e-5)


def test_at_the_first_or_last_step_nothing_lies_beyond() -> None:
    times = np.linspace(0, 1, 5)
    assert peak_bound_of(times, times**2) == 1
    assert peak_bound_of(times, (1 - times) ** 2) == 1
    assert peak_bound_of(times[:2], times[:2]) == 0.25


@pytest.mark.parametrize("kink", [0.0, 0.1])
def test_the_bound_is_close_to_a_peak_between_steps(kink: float) -> None:
    def force(t: np.ndarray) -> np.ndarray:
        late = np.maximum(t - 0.473, 0)
        return np.asarray(1 - np.cos(2 * np.pi * t) - 20 * kink * late)

    times = np.linspace(0, 1, 33)
    true = force(np.linspace(0, 1, 100_001)).max()
    sampled = force(times)
    assert abs(peak_bound_of(times, sampled) / true - 1) < 2e-3
    assert abs(peak_bound_of(times, -sampled) + true) < 2e-3 * true


@pytest.mark.parametrize("sign", [1, -1])
def test_the_time_of_a_peak_is_known_between_steps(sign: int) -> None:
    times = np.linspace(0, 1, 13)
    time, force = ForceCurve(times, sign * np.sin(3 * times)).peak_of_spline()
    assert time == pytest.approx(np.pi / 6, abs=1e-3)
    assert force == pytest.approx(1, abs=1e-4)


def test_where_the_velocity_jumps_the_step_itself_is_the_peak() -> None:
    times = np.arange(9.0)
    relaxing = np.concatenate([np.arange(5.0), 2 + 2 * np.exp(-np.arange(1.0, 5.0))])
    assert peak_bound_of(times, relaxing) == pytest.approx(4)
    dropping = np.concatenate([np.arange(5.0), np.full(4, 2.0)])
    assert peak_bound_of(times, dropping) == pytest.approx(4)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_jump_at_a_reversal_hides_nothing_and_moves_no_peak(sign: int) -> None:
    """The force rises to 3 N at 1 s and continues from 1 N; a step ends there."""
    times = np.linspace(0, 2, 17)
    forces = sign * np.where(times <= 1, 3 * np.sin(np.pi * times / 2), 2 - times)
    curve, through = ForceCurve(times, forces, [1.0]), ForceCurve(times, forces)
    assert curve.missed_peak() == 0
    assert curve.peak_of_spline() == pytest.approx((1, 3), abs=1e-3)
    assert through.peak_of_spline()[1] > 3.05
    assert through.missed_peak() > 1e-3
    between = np.linspace(0, 2, 101)
    apart = (between <= 1) | (between >= times[9])
    true = sign * np.where(between <= 1, 3 * np.sin(np.pi * between / 2), 2 - between)
    assert curve.spline(between[apart]) == pytest.approx(true[apart], abs=1e-3)


def test_a_peak_between_steps_is_seen_on_its_side_of_a_reversal() -> None:
    times = np.linspace(0, 2, 17)
    forces = np.where(times <= 1, 4 - 9 * (times - 0.55) ** 2, -1.0)
    assert ForceCurve(times, forces, [1.0]).peak_bound()[1] == pytest.approx(4, rel=1e-4)


def test_the_peak_force_of_a_push_and_a_pull_is_the_recorded_one_with_its_sign() -> None:
    push, pull = "{type: ramp, to: -20 mm, steps: 3}", "{type: ramp, to: 5 mm, steps: 3}"
    path = CASE.with_name("bonded-1x3.yaml")
    overrides = (
        f"program=[{push}, {pull}]",
        "discretisation={degree: 2, mesh_size: 150 mm}",
        "solver.stability=ignore",
    )
    case = read_case(path, overrides)
    response = response_of(case, sheet_of(case, MPI.COMM_SELF))
    peak = response.forces[3]
    assert peak == response.forces.min() < -response.forces.max() < 0
    assert response.figures["peak_force_N"] == peak
    assert sample(overrides, case=path).force == pytest.approx(peak)
