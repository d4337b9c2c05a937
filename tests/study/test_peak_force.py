"""The peak force: recorded under this name everywhere, and interpolated between steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from mpi4py import MPI

from benchmarks.probe import CASE, sample
from wovenfab.case import read_case
from wovenfab.case.objects import sheet_of
from wovenfab.study.accuracy.measure import measure
from wovenfab.study.response import (
    interpolated_peak_force,
    peak_bound,
    peak_of_spline,
    response_of,
)

Largest = Callable[[np.ndarray, np.ndarray], float]


def smooth_peak_of(times: np.ndarray, forces: np.ndarray) -> float:
    return interpolated_peak_force(times, forces, [False] * len(times))


def peak_bound_of(times: np.ndarray, forces: np.ndarray) -> float:
    return peak_bound(times, forces)[1]


BOTH = pytest.mark.parametrize("largest", [peak_bound_of, smooth_peak_of])


@BOTH
def test_the_peak_of_a_parabola_is_exact_whatever_the_steps(largest: Largest) -> None:
    times = np.array([0.0, 0.1, 0.3, 0.5, 0.9, 1.6, 2.0, 2.1, 2.3])
    forces = 4 - (times - 1) ** 2
    assert largest(times, forces) == pytest.approx(4, rel=1e-5)
    assert largest(times, -forces) == pytest.approx(-4, rel=1e-5)


@BOTH
def test_at_the_first_or_last_step_nothing_lies_beyond(largest: Largest) -> None:
    times = np.linspace(0, 1, 5)
    assert largest(times, times**2) == 1
    assert largest(times, (1 - times) ** 2) == 1
    assert largest(times[:2], times[:2]) == 0.25


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
    time, force = peak_of_spline(times, sign * np.sin(3 * times))
    assert time == pytest.approx(np.pi / 6, abs=1e-3)
    assert force == pytest.approx(1, abs=1e-4)


def test_where_a_layer_is_not_resolved_the_peak_is_not_overshot() -> None:
    def force(t: np.ndarray) -> np.ndarray:  # friction that reverses within a step
        return np.asarray(10 * t * (2 - t) - np.tanh((t - 1) / 0.02))

    true = force(np.linspace(0.9, 1.1, 100_001)).max()
    errors = []
    for late in np.linspace(0, 0.05, 11):
        times = np.arange(0.6 + late, 1.4, 0.05)
        errors.append(smooth_peak_of(times, force(times)) / true - 1)
    assert max(errors) < 5e-3
    assert min(errors) > -1e-2


def test_long_steps_do_not_overshoot_a_round_top() -> None:
    times = np.linspace(0, 1, 11)
    for late in np.linspace(0, 0.1, 6):
        force = 1 - np.cos(2 * np.pi * (times - late))
        assert force.max() - 1e-9 < smooth_peak_of(times, force) < 2.01


@BOTH
def test_where_the_velocity_jumps_the_step_itself_is_the_peak(largest: Largest) -> None:
    times = np.arange(9.0)
    relaxing = np.concatenate([np.arange(5.0), 2 + 2 * np.exp(-np.arange(1.0, 5.0))])
    assert largest(times, relaxing) == pytest.approx(4)
    dropping = np.concatenate([np.arange(5.0), np.full(4, 2.0)])
    assert largest(times, dropping) == pytest.approx(4)


def test_at_a_kink_the_step_itself_is_the_peak() -> None:
    times = np.array([0.0, 0.5, 0.9, 1.6, 2.0])
    forces = 4 - (times - 1) ** 2
    assert interpolated_peak_force(times, forces, [False] * 5) == pytest.approx(4)
    assert interpolated_peak_force(times, -forces, [False] * 5) == pytest.approx(-4)
    assert interpolated_peak_force(times, forces, [True] * 5) == forces[2]
    assert interpolated_peak_force(times[:3], forces[:3], [False] * 3) == forces[2]


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
    values = measure(case).values
    assert "peak_force_N" not in values
    assert values["peak_force_interpolated_N"] == pytest.approx(peak, rel=0.05)
