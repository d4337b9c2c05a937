"""Meshes that shrink towards points and edges fit together, on any outline."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.sheet.test_aligned import HOLDS, tee, with_hole
from wovenfab.sheet.aligned import graded, singular_points
from wovenfab.sheet.fibre_lines import special_lines
from wovenfab.sheet.fibre_mesh import fibre_mesh
from wovenfab.sheet.fibre_spacing import spaced
from wovenfab.sheet.grading import RATIO, shrunk
from wovenfab.sheet.outline import Outline, rectangle_outline
from wovenfab.sheet.sheet import directions

OUTLINES = {"rectangle": rectangle_outline(0.9, 0.3), "tee": tee(), "hole": with_hole()}


def areas(points: NDArray[np.float64], cells: NDArray[np.int64]) -> NDArray[np.float64]:
    one, two = (points[cells[:, i]] - points[cells[:, 0]] for i in (1, 2))
    return np.asarray(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2


@pytest.mark.parametrize("name", OUTLINES)
@pytest.mark.parametrize("angles", [(45, -45), (30, -60)])
def test_a_graded_mesh_covers_the_sheet_without_gaps(
    name: str, angles: tuple[float, float]
) -> None:
    outline: Outline = OUTLINES[name]
    fibres = directions((np.radians(angles[0]), np.radians(angles[1])))
    lines = [special_lines(outline, fibres[a], HOLDS) for a in (0, 1)]
    offsets = spaced(outline, fibres, (lines[0].offsets, lines[1].offsets), 0.1)
    coarse = fibre_mesh(outline, fibres, offsets)
    points, cells = graded(*coarse, outline, (HOLDS, HOLDS), (3, 1))
    assert (areas(points, cells) > 0).all()
    assert areas(points, cells).sum() == pytest.approx(outline.polygon.area)
    sides = Counter(
        tuple(sorted(map(int, s))) for c in cells for s in zip(c, np.roll(c, 1), strict=True)
    )
    alone = [s for s, count in sides.items() if count == 1]
    length = sum(float(np.linalg.norm(points[a] - points[b])) for a, b in alone)
    assert set(sides.values()) == {1, 2}
    assert length == pytest.approx(outline.polygon.length)
    corners = singular_points(outline, (HOLDS, HOLDS))
    lengths = {s: float(np.linalg.norm(points[s[0]] - points[s[1]])) for s in sides}
    before = np.linalg.norm(coarse[0][coarse[1]] - coarse[0][np.roll(coarse[1], 1, 1)], axis=2)
    for corner in corners:
        number = int(np.linalg.norm(points - corner, axis=1).argmin())
        there = min(length for side, length in lengths.items() if number in side)
        assert there < 1.01 * RATIO**3 * before.max()


def test_a_layer_around_a_point_repeats_its_cells_in_small() -> None:
    points = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
    found, cells = shrunk(points, np.array([[0, 1, 2]]), np.array([True, False, False]))
    assert len(cells) == 3
    assert areas(found, cells).min() == pytest.approx(RATIO**2 / 2)
    found, cells = shrunk(points, np.array([[0, 1, 2]]), np.array([True, True, False]))
    assert len(cells) == 3  # a strip of two cells along the side, and the rest
    assert areas(found, cells).max() == pytest.approx((1 - RATIO) ** 2 / 2)
