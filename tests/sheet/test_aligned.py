"""Meshes along the fibres: every shape is covered, and no fibre that is cut along is crossed."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import shapely
from mpi4py import MPI
from numpy.typing import NDArray

from tests.outlines import (
    EDGES,
    HOLDS,
    SHAPES,
    Angles,
    aligned,
    fibres_at,
    lines_and_mesh,
    tee,
    with_hole,
)
from wovenfab.compat import corners_of
from wovenfab.sheet.aligned import aligned_sheet, grading_of, singular_points
from wovenfab.sheet.fibre_mesh import (
    across,
    curves_along_fibres,
    divided,
    evenly,
    fibre_mesh,
    quality,
    special_lines,
)
from wovenfab.sheet.sheet import Outline, Ring, outline_of


def quality_of_worst(points: NDArray[np.float64], cells: NDArray[np.int64]) -> float:
    """Return the least height of a cell over its longest side."""
    return min(abs(quality(*points[cell])) for cell in cells)


ANGLES = [(45, -45), (30, -60), (52, -38), (7, 97), (0, 90), (20, -30)]


@pytest.mark.parametrize("angles", ANGLES, ids=str)
@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES.keys())
def test_cells_fill_the_sheet_between_the_lines(shape: Outline, angles: Angles) -> None:
    fibres = fibres_at(angles)
    _, offsets, (points, cells) = lines_and_mesh(shape, fibres, 0.06)
    corners = points[cells]
    areas = [shapely.Polygon(c).area for c in corners]
    assert sum(areas) == pytest.approx(shape.polygon.area, rel=1e-9)
    assert min(quality(*c) for c in corners) > 0
    for direction, positions in zip(fibres, offsets, strict=True):
        # The strip between two neighbouring lines that each end of a cell's extent lies in.
        extent = corners @ across(direction)
        low = np.searchsorted(positions, extent.min(axis=1) + 1e-8, side="right")
        high = np.searchsorted(positions, extent.max(axis=1) - 1e-8, side="left")
        assert np.all(low == high)


def test_lines_are_spaced_to_leave_no_slivers() -> None:
    shape, fibres = SHAPES["rectangle"], fibres_at((52, -38))
    lines, moved, spaced = lines_and_mesh(shape, fibres, 0.05)
    even = fibre_mesh(shape, fibres, [evenly(family.offsets, 0.05) for family in lines])
    worst, best = (min(quality(*points[c]) for c in cells) for points, cells in (even, spaced))
    assert best > 10 * worst
    assert best > 0.05
    for positions, family in zip(moved, lines, strict=True):
        assert np.isin(family.offsets, positions).all()


#: Angle between a fibre and a side of a hole with 48, rad.
NEARLY_ALONG = [1e-2, -1e-2, 1e-3, 1e-5]


@pytest.mark.parametrize("angle", NEARLY_ALONG)
def test_cells_at_a_curve_are_not_as_flat_as_the_angle_of_a_side_to_a_fibre(angle: float) -> None:
    side = 6.5 * 360 / 48 + 90  # one of them
    for other in (-83.1, -75.3, -60.2):
        shape, fibres = with_hole(48), fibres_at((side + np.degrees(angle), side + other))
        before = quality_of_worst(*lines_and_mesh(shape, fibres, 0.05)[2])
        sheet = aligned_sheet(MPI.COMM_SELF, shape, fibres, (HOLDS, HOLDS), 0.05 * np.sqrt(2))
        after = quality_of_worst(sheet.mesh.geometry.x[:, :2], corners_of(sheet.mesh))
        assert before < abs(angle) / 4
        assert after > 0.005


@pytest.mark.parametrize("angle", NEARLY_ALONG)
def test_vertices_of_a_curve_move_less_than_its_chords_are_away_from_it(angle: float) -> None:
    shape, fibres = with_hole(48), fibres_at((6.5 * 360 / 48 + 90 + np.degrees(angle), 20.3))
    moved = curves_along_fibres(shape, fibres)
    shifts = [
        np.linalg.norm(a.points - b.points, axis=1)
        for a, b in zip(moved.rings, shape.rings, strict=True)
    ]
    assert shifts[0] == pytest.approx(0, abs=0)  # corners stay
    side = 2 * 0.05 * np.sin(np.pi / 48)
    assert np.sort(shifts[1])[-2:] == pytest.approx(side * abs(np.sin(angle)), rel=1e-3)
    assert shifts[1].max() < 0.05 * (1 - np.cos(np.pi / 48))
    assert (shifts[1] > 0).sum() == 2  # on either side of the hole, one
    across_it = np.diff(moved.rings[1].points, axis=0) @ across(fibres[0])
    assert (np.abs(across_it) < 1e-15).sum() == 2


def test_curves_that_nearly_touch_are_left_as_they_are() -> None:
    """A vertex that moves outwards would be beyond the edge beside it."""
    hole, fibres = with_hole(48).rings[1], fibres_at((6.5 * 360 / 48 + 90.5, 20.3))
    moved = curves_along_fibres(with_hole(48), fibres).rings[1]
    number = int(np.linalg.norm(moved.points - hole.points, axis=1).argmax())
    tip = (hole.points[number] + moved.points[number]) / 2
    away = tip - [0.4, 0.14]
    base = tip + 100 * away
    notch = shapely.Polygon([tip, base + across(away), base - across(away)])
    cut = shapely.box(0, 0, 0.9, 0.3).difference(notch)
    outside = np.array(shapely.geometry.polygon.orient(cut).exterior.coords)[:-1]
    start = Outline((Ring(outside, (None,) * len(outside)), hole))
    assert start.polygon.is_valid
    assert curves_along_fibres(start, fibres) is start


def test_special_fibres_start_where_a_clamp_ends() -> None:
    jumps = special_lines(SHAPES["rectangle"], fibres_at((45, -45))[0], HOLDS).jumps
    ends = sorted(tuple(map(float, np.round(np.sort(p, axis=0).ravel(), 9))) for p in jumps)
    assert ends == [(0.0, 0.0, 0.3, 0.3), (0.6, 0.0, 0.9, 0.3)]


def test_a_hole_has_a_special_fibre_on_either_side_that_runs_through_the_sheet() -> None:
    jumps = special_lines(with_hole(), fibres_at((0, 90))[0], {}).jumps
    assert {round(float(p[0, 1]), 9) for p in jumps} == {0.09, 0.19}
    # Left and right of the point where it touches.
    assert sum(np.linalg.norm(p[1] - p[0]) for p in jumps) == pytest.approx(2 * 0.9)


def test_a_special_fibre_of_a_re_entrant_corner_ends_at_the_edge_of_the_sheet() -> None:
    fibre, corner = fibres_at((30, -60))[1], np.array([0.6, 0.3])
    jumps = special_lines(tee(), fibre, {}).jumps
    (ends,) = [p for p in jumps if abs(across(fibre) @ (p[0] - corner)) < 1e-9]
    bottom, top = sorted(ends, key=lambda p: p[1])
    assert bottom == pytest.approx(corner + 0.3 / np.sqrt(0.75) * fibre)
    assert top == pytest.approx(corner - 0.2 / np.sqrt(0.75) * fibre)


def test_strain_is_singular_at_the_ends_of_clamps_and_at_re_entrant_corners() -> None:
    points = {tuple(map(float, p)) for p in singular_points(tee(), (HOLDS, HOLDS))}
    assert points == {(0, 0), (0.9, 0), (0.9, 0.3), (0.6, 0.3), (0.3, 0.3), (0, 0.3)}


@pytest.mark.parametrize("turn", range(0, 180, 15))
def test_a_square_is_divided_along_the_same_diagonal_in_every_unit_and_place(turn: int) -> None:
    """Both are as good: neither rounding nor the corner that comes first must decide."""
    angle = np.radians(turn)
    ahead, aside = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    ring = np.array([0 * ahead, ahead, ahead + aside, aside])
    draw, found = np.random.default_rng(1), set()
    for unit, first in product((1.0, 1 / 3, 0.0254, 1e3), range(4)):
        triangles = divided(unit * (np.roll(ring, -first, axis=0) + draw.uniform(-5, 5, 2)))
        found.add(frozenset(frozenset((i + first) % 4 for i in t) for t in triangles))
    assert len(found) == 1


def test_a_polygon_is_divided_at_its_best() -> None:
    ring = np.array([(0, 0), (1, 0), (2, 0), (2, 1), (0, 1)], dtype=float)  # a straight angle
    triangles = [ring[list(t)] for t in divided(ring)]
    assert sum(shapely.Polygon(t).area for t in triangles) == pytest.approx(2)
    assert min(quality(*t) for t in triangles) == pytest.approx(0.5)


def test_the_outline_of_a_mesh_is_found_again_with_its_names() -> None:
    points = np.array([(0, 0), (0.5, 0), (1, 0), (1, 1), (0, 1)], dtype=float)
    triangles = np.array([(0, 1, 4), (1, 3, 4), (3, 1, 2)])  # the last one is clockwise
    named = {"bottom": np.array([(0, 1), (1, 2)]), "top": np.array([(4, 3)])}
    (ring,) = outline_of(points, triangles, named).rings
    assert len(ring.points) == 4  # the middle of the bottom is no corner
    assert sorted(map(str, ring.names)) == ["None", "None", "bottom", "top"]
    assert ring.names[int(np.flatnonzero((ring.points == [0, 0]).all(axis=1))[0])] == "bottom"


def test_the_outline_of_a_fine_polygon_keeps_all_its_corners() -> None:
    """Of 1000 sides, which turn by 0.36 degrees each: a curve is not a straight line."""
    angles = 2 * np.pi * np.arange(1000) / 1000
    rim = np.column_stack([np.cos(angles), np.sin(angles)])
    points = np.vstack([rim, [0.0, 0.0]])
    triangles = np.array([(i, (i + 1) % 1000, 1000) for i in range(1000)])
    (ring,) = outline_of(points, triangles, {}).rings
    assert len(ring.points) == 1000


@pytest.mark.parametrize("corner_size", [None, 0.01])
def test_edges_are_named_on_coarse_and_on_graded_meshes(corner_size: float | None) -> None:
    grading = grading_of(0.1, corner_size) if corner_size else None
    sheet = aligned(SHAPES["rectangle"], (45, -45), 0.1, grading=grading)
    x = sheet.mesh.geometry.x
    sheet.mesh.topology.create_connectivity(1, 0)
    facets = sheet.mesh.topology.connectivity(1, 0)
    for name, (axis, place, length) in EDGES.items():
        ends = np.array([x[facets.links(f)] for f in sheet.edge_facets(name)])
        assert np.allclose(ends[:, :, axis], place)
        assert np.ptp(ends, axis=1).max(axis=1).sum() == pytest.approx(length)
    smallest = min(sheet.mesh.h(2, np.arange(sheet.mesh.topology.index_map(2).size_local)))
    assert smallest < 0.012 if corner_size else smallest > 0.05
