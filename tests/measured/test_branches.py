"""Loading and unloading are told apart by the way back from the last extreme."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from wovenfab.measured.curve import Measured

Array = NDArray[np.float64]


def zigzag(turns: list[float], rows: int) -> Array:
    """Return straight ways from turn to turn with so many rows each."""
    ways = [np.linspace(a, b, rows)[1:] for a, b in pairwise(turns)]
    return np.concatenate([[turns[0]], *ways])


def ends(way: Array) -> list[float]:
    curve = Measured(Path(), way, way)
    return [float(way[rows[-1]]) for rows in curve.branches()]


@pytest.mark.parametrize("rows", [2, 3, 60, 99, 101, 150, 1000, 20000])
@pytest.mark.parametrize("sign", [1, -1])
def test_branches_do_not_depend_on_how_dense_the_rows_are(rows: int, sign: int) -> None:
    turns = [0.0, 10.0, 2.0, 20.0, -5.0]
    assert ends(sign * zigzag(turns, rows)) == pytest.approx([sign * t for t in turns[1:]])


@pytest.mark.parametrize("noise", [0.0, 1e-3, 4e-3])
def test_five_dense_noisy_cycles_have_ten_branches(noise: float) -> None:
    way = zigzag([0.0, 20.0] * 5 + [0.0], 10_000)
    scatter = np.random.default_rng(0).standard_normal(way.size)
    found = ends(way + 20 * noise * scatter)
    assert len(found) == 10
    np.testing.assert_allclose(found, [20.0, 0.0] * 5, atol=0.1 + 20 * 5 * noise)


def test_small_cycles_before_large_ones_are_seen() -> None:
    phase = np.linspace(0, 2 * np.pi, 13)[:-1]
    cycle = (1 - np.cos(phase)) / 2  # twelve rows a cycle
    way = np.concatenate([amplitude * cycle for amplitude in (5, 10, 20, 40)] + [[0.0]])
    assert ends(way)[::2] == pytest.approx([5, 10, 20, 40])
    assert len(ends(way)) == 8


def test_a_hold_and_a_toe_are_no_branches() -> None:
    way = np.concatenate([np.zeros(50), np.linspace(0, 10, 100), np.full(80, 10.0)])
    scatter = 1e-3 * np.random.default_rng(1).standard_normal(way.size)
    assert len(ends(way + scatter)) == 1


def test_every_row_belongs_to_a_branch() -> None:
    way = zigzag([0.0, 3.0, 1.0, 4.0], 40)
    branches = Measured(Path(), way, way).branches()
    assert [int(rows[0]) for rows in branches[1:]] == [int(rows[-1]) for rows in branches[:-1]]
    assert branches[0][0] == 0 and branches[-1][-1] == way.size - 1


@pytest.mark.parametrize(
    ("u", "force", "is_reversed"),
    [
        ([0, 1, 2], [0, 1, 3], False),
        ([0, 1, 2], [0, -1, -3], True),
        ([0, -1, -2], [0, -1, -3], False),
        ([0, -1, -2], [0, 1, 3], True),
        ([0, 1, 2], [-5, -4.9, -4.6], False),  # an offset of the load cell
        ([0, 1, 2, 1, 0], [0, 2, 3, -1, -2], False),
    ],
)
def test_a_force_against_the_displacement_is_noticed(
    u: list[float], force: list[float], is_reversed: bool
) -> None:
    assert Measured(Path(), np.array(u, float), np.array(force, float)).is_reversed is is_reversed
