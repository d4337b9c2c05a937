"""Drift, zero, preload and cycles of made records, whose true curve is known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from wovenfab.case import CaseError
from wovenfab.measured.correction import Correction, corrected, one_cycle
from wovenfab.measured.curve import Measured
from wovenfab.study.fit.response import compared, curve_of_history

Array = NDArray[np.float64]
REST = 12
#: Times that are not even: the drift is even in time, not in the number of rows.
TIME = np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 120))


def record(displacement: Array, force: Array, time: Array | None = None) -> Measured:
    return Measured(Path("record.csv"), displacement, force, time)


def true_curve() -> tuple[Array, Array]:
    """Return a loop between rests, without force in these."""
    loop = np.sin(np.linspace(0, np.pi, len(TIME) - 2 * REST))
    u = np.concatenate([np.zeros(REST), 0.02 * loop, np.zeros(REST)])
    return u, 400 * u


def test_an_even_drift_is_taken_away() -> None:
    u, force = true_curve()
    drifting = record(u, force + 0.7 - 0.013 * TIME, TIME)
    found = corrected(drifting, Correction(drift=REST))
    np.testing.assert_allclose(found.force, force, atol=1e-12)
    other = record(u, force - 0.2 + 0.05 * np.arange(len(u)))
    np.testing.assert_allclose(corrected(other, Correction(drift=REST)).force, force, atol=1e-12)


def test_the_mean_at_rest_becomes_zero() -> None:
    u, force = true_curve()
    scatter = np.random.default_rng(2).standard_normal((2, len(u)))
    noise = scatter - scatter[:, :REST].mean(axis=1, keepdims=True)
    found = corrected(
        record(u + 0.23 + 1e-5 * noise[0], force - 4.0 + 1e-2 * noise[1]), Correction(zero=REST)
    )
    np.testing.assert_allclose(found.displacement, u + 1e-5 * noise[0], atol=1e-13)
    np.testing.assert_allclose(found.force, force + 1e-2 * noise[1], atol=1e-12)


def test_displacement_counts_from_the_preload_within_a_row() -> None:
    u = np.linspace(0, 0.02, 41)
    slack = 0.0037
    found = corrected(record(u, 300 * np.maximum(u - slack, 0)), Correction(preload=0.6))
    np.testing.assert_allclose(found.force, 0.6 + 300 * found.displacement, atol=1e-12)
    assert found.displacement[0] < 0.02 / 40
    with pytest.raises(CaseError, match="does not reach the preload"):
        corrected(record(u, 300 * u), Correction(preload=7.0))


def test_corrections_are_made_in_their_order() -> None:
    u, force = true_curve()
    made = record(u + 5e-3, force + 0.3 + 0.01 * TIME, TIME)
    found = corrected(made, Correction(drift=REST, zero=REST, cycle=1))
    np.testing.assert_allclose(found.displacement, u, atol=1e-15)
    np.testing.assert_allclose(found.force, force, atol=1e-12)


def one_sided(cycles: int) -> Array:
    """Return cycles that go ever less back."""
    parts = [np.linspace(0.001 * i, 0.02, 30)[:-1] for i in range(cycles)]
    back = [np.linspace(0.02, 0.001 * (i + 1), 30)[:-1] for i in range(cycles)]
    ways = [part for pair in zip(parts, back, strict=True) for part in pair]
    return np.concatenate([*ways, [0.001 * cycles]])


def two_sided(cycles: int) -> Array:
    return np.asarray(0.1 + 0.02 * np.sin(np.linspace(0, 2 * np.pi * cycles, 80 * cycles + 1)))


@pytest.mark.parametrize("cycle", [1, 2, 5])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_cycle_to_one_side_is_its_loading_and_unloading(cycle: int, sign: int) -> None:
    u = sign * one_sided(5)
    found = one_cycle(record(u, np.arange(len(u)) * 1.0), cycle)
    assert found.force[0] == 58 * (cycle - 1) and found.force[-1] == 58 * cycle
    assert len(found.branches()) == 2 and found.cycle == cycle


@pytest.mark.parametrize("cycle", [1, 3, 5])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_cycle_to_both_sides_begins_and_ends_in_the_middle(cycle: int, sign: int) -> None:
    u = sign * two_sided(5)
    found = one_cycle(record(u, np.arange(len(u)) * 1.0), cycle)
    assert abs(found.force[0] - 80 * (cycle - 1)) <= 1 and abs(found.force[-1] - 80 * cycle) <= 1
    assert len(found.branches()) == 3


@pytest.mark.parametrize("u", [one_sided(3), two_sided(3), one_sided(3)[:-29]])
def test_cycles_that_are_not_there_are_told_with_their_number(u: Array) -> None:
    count = 3 if len(u) > 150 else 2
    with pytest.raises(CaseError, match=f"no cycle 4: the curve has {count}"):
        one_cycle(record(u, u), 4)


def test_a_rest_that_is_longer_than_the_record_is_refused() -> None:
    u = np.linspace(0, 1, 9)
    for correction in (Correction(drift=5), Correction(zero=10)):
        with pytest.raises(CaseError, match=r"record.csv.*The curve has 9"):
            corrected(record(u, u), correction)


@pytest.mark.parametrize("ways", [one_sided, two_sided])
def test_a_cycle_is_compared_with_the_last_one_of_the_program(
    ways: Callable[[int], Array],
) -> None:
    u = ways(5) - ways(5)[0]
    force = 300 * u + 0.5 * np.sign(np.gradient(u))  # the same in each cycle but for its number
    number = np.arange(len(u)) // (len(u) / 5)
    fifth = one_cycle(record(u, force + number), 5)
    program = slice(len(u) * 2 // 5, None)  # three cycles, of which the last has those forces
    last = force[program] + np.minimum(number[program] + 2, 4)
    found = compared(fifth, curve_of_history(u[program], last))
    assert found.misfit < 0.02 and found.beyond == 0
