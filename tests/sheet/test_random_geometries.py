"""Fifty random geometries get meshes along the fibres with the right area and edges."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from numpy.random import Generator
from numpy.typing import NDArray

from tests.outlines import HOLDS, aligned, edge_lengths, fibres_at
from wovenfab.compat import corners_of
from wovenfab.sheet.aligned import BONDED
from wovenfab.sheet.fibre_mesh import curves_along_fibres
from wovenfab.sheet.geometry_file import GeometryFile, outline_from_file

OCC = 'SetFactory("OpenCASCADE");\n'
NAMED = 'Physical Surface("s") = {{{}}};\nPhysical Curve("left") = {{{}}};\n'
NAMED += 'Physical Curve("right") = {{{}}};\n'


def in_geo(points: NDArray[np.float64]) -> str:
    """Return points for gmsh, numbered from 1."""
    return "".join(f"Point({i}) = {{{x}, {y}, 0, 0.05}};\n" for i, (x, y) in enumerate(points, 1))


def polygon(
    points: Sequence[tuple[float, float]] | NDArray[np.float64],
    g: Generator,
    left: int,
    right: int,
) -> str:
    """Return a polygon, often turned, with two named sides."""
    turn = g.uniform(0, 2 * np.pi) * (g.random() < 0.6)
    c, s = np.cos(turn), np.sin(turn)
    n = len(points)
    lines = "".join(f"Line({i}) = {{{i}, {i % n + 1}}};\n" for i in range(1, n + 1))
    surface = f"Curve Loop(1) = {{1:{n}}};\nPlane Surface(1) = {{1}};\n"
    return (
        in_geo(points @ np.array([[c, s], [-s, c]]))
        + lines
        + surface
        + NAMED.format(1, left, right)
    )


def around(radii: NDArray[np.float64], x_scale: float = 1.0) -> NDArray[np.float64]:
    """Return points at equal angles around the origin."""
    t = np.arange(len(radii)) * 2 * np.pi / len(radii)
    return np.stack([x_scale * radii * np.cos(t), radii * np.sin(t)], axis=1)


def sharp_tips(g: Generator) -> str:
    n, outer = int(g.integers(4, 12)), g.uniform(0.1, 0.3)
    inner = outer * g.uniform(0.05, 0.6)
    radii = np.where(np.arange(2 * n) % 2, inner, outer * g.uniform(0.7, 1, 2 * n))
    return polygon(around(radii), g, 1, n + 1)


def small_edges(g: Generator) -> str:
    n = int(g.integers(30, 80))
    rough = g.uniform(-1, 1, n) * g.choice([0, 1e-4, 2e-3])
    radii = 0.2 * (1 + 0.2 * np.sin(6 * np.pi * np.arange(n) / n)) + rough
    return polygon(around(radii, 1.5), g, 1, n // 2)


def splines(g: Generator) -> str:
    n, kind = int(g.integers(6, 16)), g.choice(["Spline", "BSpline"])
    curves = f"{kind}(1) = {{1:{n // 2}}};\n{kind}(2) = {{{n // 2}:{n}, 1}};\n"
    surface = "Curve Loop(1) = {1, 2};\nPlane Surface(1) = {1};\n" + NAMED.format(1, 1, 2)
    return in_geo(around(0.2 * g.uniform(0.5, 1.3, n))) + curves + surface


def cut_ellipse(g: Generator) -> str:
    a = g.uniform(0.05, 0.3)
    b, cuts = a * g.uniform(0.2, 1), int(g.integers(1, 4))
    text = OCC + f"Disk(1) = {{0, 0, 0, {a}, {b}}};\n"
    for i in range(10, 10 + cuts):
        turn = g.uniform(0, 2 * np.pi)
        away = g.uniform(0.3, 0.99) * np.hypot(a * np.cos(turn), b * np.sin(turn))
        text += f"Rectangle({i}) = {{{away}, {-3 * a}, 0, {3 * a}, {6 * a}}};\n"
        text += f"Rotate {{{{0, 0, 1}}, {{0, 0, 0}}, {turn}}} {{ Surface{{{i}}}; }}\n"
    text += f"BooleanDifference(100) = {{ Surface{{1}}; Delete; }}{{ Surface{{10:{9 + cuts}}}; "
    return (
        text + "Delete; };\nb() = Boundary{ Surface{100}; };\n" + NAMED.format(100, "b(0)", "b(1)")
    )


def holes(g: Generator) -> str:
    length, width, n = g.uniform(0.3, 0.9), g.uniform(0.1, 0.3), int(g.integers(1, 4))
    gap = g.choice([1e-4, 2e-3, 1e-2])  # between a hole and an edge
    text = OCC + f"Rectangle(1) = {{0, 0, 0, {length}, {width}}};\n"
    for i in range(n):
        r = min(g.uniform(0.05, 0.25) * width, 0.4 * length / n)
        x, y = length * (i + 0.5) / n, g.choice([r + gap, width / 2])
        text += f"Disk({10 + i}) = {{{x}, {y}, 0, {r}, {r * g.uniform(0.3, 1)}}};\n"
    text += f"BooleanDifference(100) = {{ Surface{{1}}; Delete; }}{{ Surface{{10:{9 + n}}}; "
    at = "Curve In BoundingBox{{{0}-1e-6, -1e-6, -1e-6, {0}+1e-6, 1, 1e-6}}"
    return text + "Delete; };\n" + NAMED.format(100, at.format(0), at.format(length))


def ell(g: Generator) -> str:
    x, y = g.uniform(0.2, 0.5, 2)
    a, b = g.uniform(0.1, 0.8, 2) * (x, y)
    return polygon(np.array([(0, 0), (x, 0), (x, b), (a, b), (a, y), (0, y)]), g, 5, 2)


def slots(g: Generator) -> str:
    length, width, n = g.uniform(0.3, 0.9), g.uniform(0.1, 0.3), int(g.integers(1, 6))
    half = g.choice([2e-4, 1e-3, 5e-3]) / 2
    points = [(0.0, 0.0)]
    for i in range(n):
        x, deep = length * (i + 0.5) / n, width * g.uniform(0.1, 0.9)
        tip = x + g.uniform(-0.1, 0.1) * deep
        end = [(tip - half, deep)] + [(tip + half, deep)] * (g.random() < 0.7)
        points += [(x - half, 0.0), *end, (x + half, 0.0)]
    points += [(length, 0.0), (length, width), (0.0, width)]
    return polygon(np.array(points), g, len(points), len(points) - 2)


KINDS: tuple[Callable[[Generator], str], ...] = (
    sharp_tips, small_edges, splines, cut_ellipse, holes, ell, slots,
)  # fmt: skip


@pytest.mark.parametrize(
    "seed", [*range(8), *(pytest.param(s, marks=pytest.mark.slow) for s in range(8, 50))]
)
def test_a_random_geometry_is_meshed_with_its_area_and_edges(seed: int, tmp_path: Path) -> None:
    g = np.random.default_rng(seed)
    path = tmp_path / "sheet.geo"
    path.write_text(KINDS[seed % len(KINDS)](g))
    first = g.choice([45.0, 0.0, 30.0, g.uniform(0, 180)])
    angles = (first, first + g.choice([90.0, g.uniform(40, 140)]))
    size = [None, 0.03, 0.1, 0.3][int(g.integers(4))]
    outline, size = outline_from_file(MPI.COMM_SELF, GeometryFile(path), size)
    on = aligned(outline, angles, size, grading=BONDED if seed % 2 else None)
    corners = on.mesh.geometry.x[corners_of(on.mesh)][..., :2]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2
    assert areas.min() > 0
    shape = curves_along_fibres(outline, fibres_at(angles))
    assert areas.sum() == pytest.approx(shape.polygon.area, rel=1e-9)
    changed = shape.polygon.symmetric_difference(outline.polygon).area
    assert changed < 1e-3 * outline.polygon.area
    named = dict.fromkeys(HOLDS, 0.0)
    for start, end, name in shape.segments():
        if name is not None:
            named[name] += float(np.linalg.norm(end - start))
    assert edge_lengths(on) == pytest.approx(named, rel=1e-9)
