"""The narrowest place of a sheet and its flattest cell are where they are."""

from __future__ import annotations

import numpy as np
import pytest

from tests.outlines import SHAPES, aligned
from wovenfab.sheet.narrow import flattest_cell, narrowest
from wovenfab.sheet.sheet import Outline, Ring, rectangle_outline

Points = list[tuple[float, float]]


def ring(points: Points) -> Ring:
    return Ring(np.array(points, dtype=float), (None,) * len(points))


def turned(outline: Outline, angle: float, shift: float, size: float) -> Outline:
    """Return an outline that is scaled, turned and shifted."""
    c, s = np.cos(angle), np.sin(angle)
    turn = size * np.array([[c, s], [-s, c]])
    return Outline(tuple(Ring(r.points @ turn + shift, r.names) for r in outline.rings))


def notch(width: float) -> Outline:
    """Return a rectangle with a notch of a width in the middle of its bottom."""
    a, b = 0.45 - width / 2, 0.45 + width / 2
    slot: Points = [(a, 0), (a, 0.1), (b, 0.1), (b, 0)]
    return Outline((ring([(0, 0), *slot, (0.9, 0), (0.9, 0.3), (0, 0.3)]),))


def spike(width: float) -> Outline:
    """Return a rectangle with a spike on its top, whose base has a width."""
    tip: Points = [(0.45 + width / 2, 0.3), (0.45, 0.5), (0.45 - width / 2, 0.3)]
    return Outline((ring([(0, 0), (0.9, 0), (0.9, 0.3), *tip, (0, 0.3)]),))


def gap(width: float) -> Outline:
    """Return a rectangle with a hole at a distance from its bottom."""
    hole = ring([(0.4, width), (0.4, 0.2), (0.5, 0.1)])
    return Outline((*rectangle_outline(0.9, 0.3).rings, hole))


@pytest.mark.parametrize("width", [1e-9, 1e-7, 1e-3, 0.02])
@pytest.mark.parametrize(
    ("shape", "share", "place"),
    [
        (notch, 1.0, (0.45, (0.0, 0.1))),
        (spike, 0.5, (0.45, (0.39, 0.41))),
        (gap, 1.0, (0.4, (0.0, 0.02))),
    ],
)
@pytest.mark.parametrize("turn", [(0.0, 0.0, 1.0), (0.7, 0.3, 100.0)])
def test_the_narrowest_place_is_found(shape, share, place, width, turn) -> None:  # type: ignore[no-untyped-def]
    outline = shape(width)
    found = narrowest(turned(outline, *turn))
    angle, shift, size = turn
    assert found is not None
    assert found.width == pytest.approx(size * share * width, rel=0.01 if turn[0] == 0 else 0.05)
    c, s = np.cos(angle), np.sin(angle)
    x, y = np.linalg.solve(size * np.array([[c, s], [-s, c]]).T, found.point - shift)
    low, high = place[1]
    assert abs(x - place[0]) <= width and low - 1e-9 <= y <= high + 1e-9
    assert found.is_too_narrow == (width < 1e-5)


@pytest.mark.parametrize(
    ("outline", "width"),
    [
        (rectangle_outline(0.9, 0.3), 0.3),
        (rectangle_outline(0.9, 1e-6), 1e-6),
        (SHAPES["hole"], 0.09),
        (SHAPES["re-entrant corners"], 0.3),
    ],
)
def test_the_width_of_plain_shapes(outline: Outline, width: float) -> None:
    found = narrowest(outline)
    assert found is not None and found.width == pytest.approx(width, rel=0.01)


@pytest.mark.parametrize("size", [1.0, 100.0])
@pytest.mark.parametrize("depth", [1e-9, -1e-9, 1e-7])
@pytest.mark.parametrize("wide", [1e-9, 1e-4, 0.2])
def test_a_side_that_is_too_short_is_a_narrow_place(wide: float, depth: float, size: float) -> None:
    """A notch or a step of 1e-9 m, whose parts do not face each other."""
    ends: Points = [(0.45 - wide / 2, 0), (0.45 + wide / 2, 0)]
    step: Points = [ends[0], (ends[0][0], depth), (ends[1][0], depth), ends[1]]
    notch: Points = [ends[0], (0.45, depth), ends[1]]
    for points in (step, notch) if wide < 1e-6 else (step,):
        outline = Outline((ring([(0, 0), *points, (0.9, 0), (0.9, 0.3), (0, 0.3)]),))
        found = narrowest(turned(outline, 0.4, 0.0, size))
        assert found is not None and found.is_too_narrow
        assert found.width <= size * 1.2e-7
        c, s = np.cos(0.4), np.sin(0.4)
        x, y = np.linalg.solve(size * np.array([[c, s], [-s, c]]).T, found.point)
        assert abs(x - 0.45) <= wide and abs(y) <= 2 * abs(depth)


def test_the_flattest_cell_is_that_of_the_spike() -> None:
    sheet = aligned(spike(1e-5), (45, -45), 0.05)
    cell = flattest_cell(sheet.mesh)
    assert cell.is_too_flat and abs(cell.point[0] - 0.45) < 1e-4 and 0.3 < cell.point[1] < 0.5
    plain = flattest_cell(aligned(rectangle_outline(0.9, 0.3), (45, -45), 0.05).mesh)
    assert not plain.is_too_flat
