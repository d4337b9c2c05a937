"""Meshes that shrink towards points and edges fit together, on any outline."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from tests.outlines import HOLDS, SHAPES, Angles, fibres_at, lines_and_mesh
from wovenfab.case import read_case
from wovenfab.case.objects import sheet_of, simulation_of
from wovenfab.sheet.aligned import (
    BONDED,
    RATIO,
    STICKING,
    Grading,
    Layers,
    graded,
    grading_of,
    shrunk,
    singular_points,
)

CONFIGS = Path(__file__).parents[2] / "configs"


def areas(points: NDArray[np.float64], cells: NDArray[np.int64]) -> NDArray[np.float64]:
    one, two = (points[cells[:, i]] - points[cells[:, 0]] for i in (1, 2))
    return np.asarray(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2


@pytest.mark.parametrize("name", ["rectangle", "re-entrant corners", "hole"])
@pytest.mark.parametrize("angles", [(45, -45), (30, -60)])
@pytest.mark.parametrize("how", [BONDED, STICKING, grading_of(0.1, 0.1 * RATIO**3)])
def test_a_graded_mesh_has_no_gaps(name: str, angles: Angles, how: Grading) -> None:
    outline = SHAPES[name]
    lines, _, coarse = lines_and_mesh(outline, fibres_at(angles), 0.1)
    points, cells = graded(*coarse, outline, (HOLDS, HOLDS), lines, how)
    assert (areas(points, cells) > 0).all()
    assert areas(points, cells).sum() == pytest.approx(outline.polygon.area)
    sides = Counter(
        tuple(sorted(map(int, s))) for c in cells for s in zip(c, np.roll(c, 1), strict=True)
    )
    lengths = {s: float(np.linalg.norm(points[s[0]] - points[s[1]])) for s in sides}
    assert set(sides.values()) == {1, 2}
    boundary = sum(lengths[s] for s, count in sides.items() if count == 1)
    assert boundary == pytest.approx(outline.polygon.length)
    before = np.linalg.norm(coarse[0][coarse[1]] - coarse[0][np.roll(coarse[1], 1, 1)], axis=2)
    for corner in singular_points(outline, (HOLDS, HOLDS)):
        number = int(np.linalg.norm(points - corner, axis=1).argmin())
        there = min(length for side, length in lengths.items() if number in side)
        assert there < 1.01 * how.points.ratio**how.points.count * before.max()


@pytest.mark.parametrize("how", [BONDED, STICKING])
def test_rings_at_narrow_corners_are_no_smaller_than_elsewhere(how: Grading) -> None:
    """A fibre 1.4 degrees from an edge leaves a corner cell that is small and flat already."""
    outline = SHAPES["rectangle"]
    lines, _, coarse = lines_and_mesh(outline, fibres_at((-1.4, -91.4)), 0.1)
    alone = Grading(how.points, Layers(0), Layers(0))
    points, cells = graded(*coarse, outline, (HOLDS, HOLDS), lines, alone)

    def sides_at_corners(points: NDArray[np.float64], cells: NDArray[np.int64]) -> list[float]:
        """Return the longest side of each cell with a singular point as corner, m."""
        corners = singular_points(outline, (HOLDS, HOLDS))
        at = (np.linalg.norm(points[:, None] - corners, axis=2) < 1e-9).any(axis=1)
        beside = points[cells[at[cells].any(axis=1)]]
        sides = np.linalg.norm(beside - np.roll(beside, 1, axis=1), axis=2)
        return list(map(float, sides.max(axis=1)))

    before = np.linalg.norm(coarse[0][coarse[1]] - coarse[0][np.roll(coarse[1], 1, 1)], axis=2)
    wanted = how.points.ratio**how.points.count * before.max()
    smallest = min(sides_at_corners(*coarse))
    assert smallest < 0.1 * before.max()
    assert min(sides_at_corners(points, cells)) > 0.99 * min(wanted / 2, smallest)


def test_a_layer_around_a_point_repeats_its_cells_in_small() -> None:
    points = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
    nodes, cells = shrunk(points, np.array([[0, 1, 2]]), np.array([True, False, False]))
    assert len(cells) == 3
    assert areas(nodes, cells).min() == pytest.approx(RATIO**2 / 2)
    nodes, cells = shrunk(points, np.array([[0, 1, 2]]), np.array([True, True, False]))
    assert len(cells) == 3  # a strip of two cells along the side, and the rest
    assert areas(nodes, cells).max() == pytest.approx((1 - RATIO) ** 2 / 2)


@pytest.mark.parametrize("angles", [(45, -45), (30, -60)])
def test_cells_are_thin_along_both_sides_of_special_fibres(angles: Angles) -> None:
    outline, fibres = SHAPES["rectangle"], fibres_at(angles)
    lines, _, coarse = lines_and_mesh(outline, fibres, 0.1)
    alone = Grading(Layers(0), BONDED.lines, Layers(0))
    fine = graded(*coarse, outline, (HOLDS, HOLDS), lines, alone)
    assert sum(len(family.jumps) for family in lines) == 4
    for family, fibre in zip(lines, fibres, strict=True):
        for ends in family.jumps:
            before, after = (_beside(*mesh, ends, fibre) for mesh in (coarse, fine))
            assert len(after) >= len(before) > 0
            assert after.max() == pytest.approx(BONDED.lines.ratio * before.max())


def _beside(
    points: NDArray[np.float64],
    cells: NDArray[np.int64],
    ends: NDArray[np.float64],
    fibre: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the thickness (m) across a fibre of the cells with a side on it."""
    away = (points - ends[0]) @ np.array([-fibre[1], fibre[0]])
    ahead = (points - ends[0]) @ fibre
    length = float((ends[1] - ends[0]) @ fibre)
    on = (np.abs(away) < 1e-9) & (ahead > -1e-9) & (ahead < length + 1e-9)
    return np.abs(away)[cells[on[cells].sum(axis=1) == 2]].max(axis=1)


def test_a_layer_leaves_cells_away_from_its_set_as_and_where_they_were() -> None:
    """Their order is that of the mesh before, whatever is cut between them."""
    outline = SHAPES["hole"]
    _, _, (points, cells) = lines_and_mesh(outline, fibres_at((45, -45)), 0.1)
    on = points[:, 0] < points[:, 0].min() + 1e-9
    after, found = shrunk(points, cells, on)
    assert (after[: len(points)] == points).all() and len(found) > len(cells)
    whole = cells[~on[cells].any(axis=1)]
    kept = [tuple(cell) for cell in found if tuple(cell) in set(map(tuple, whole))]
    assert kept == list(map(tuple, whole))


def peak_force(corner_size: str) -> float:
    """Return the force (N) that pulls a bonded sheet by 10 mm, by a coarse mesh."""
    mesh = f"{{degree: 2, mesh: fibres, mesh_size: 150 mm, corner_size: {corner_size}}}"
    changes = (f"discretisation={mesh}", "program=[{type: ramp, to: 10 mm, steps: 1}]")
    case = read_case(CONFIGS / "bonded-1x3.yaml", changes)
    with simulation_of(case, sheet_of(case, MPI.COMM_SELF)) as simulation:
        return list(simulation.steps())[-1].reactions["right"][0]


def test_cells_become_no_smaller_than_positions_allow_whatever_is_asked_for() -> None:
    assert peak_force("1e-10 m") == pytest.approx(peak_force("0.01 mm"), rel=1e-3)
