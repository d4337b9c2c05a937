"""Meshes nobody would choose, as files that a user could give."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians, tan
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

EDGES = ("bottom", "right", "top", "left")


@dataclass(frozen=True)
class Grid:
    """A mesh of a rectangle.

    Attributes:
        points: Shape (n, 2), m.
        cells: Corners of the triangles, shape (m, 3).
        edges: End points of the segments on each named edge, shape (k, 2).
    """

    points: NDArray[np.float64]
    cells: NDArray[np.int64]
    edges: dict[str, NDArray[np.int64]]

    @property
    def least_angle(self) -> float:
        """Smallest angle of all triangles, degrees."""
        corners = self.points[self.cells]
        angles = []
        for i in range(3):
            a, b = (corners[:, (i + k) % 3] - corners[:, i] for k in (1, 2))
            cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
            angles.append(np.arctan2(np.abs(cross), (a * b).sum(axis=1)))
        return float(np.degrees(np.min(angles)))


def crossed(length: float, width: float, size: float, angle: float = 45.0) -> Grid:
    """Return squares cut into four triangles, the centre drawn to the lower side.

    Args:
        length: Extent in x, m.
        width: Extent in y, m.
        size: Side of the squares, m.
        angle: Angle at the lower corners of each square, degrees: 45 for the centre.
    """
    nx, ny = round(length / size), round(width / size)
    x, y = np.meshgrid(np.linspace(0, length, nx + 1), np.linspace(0, width, ny + 1))
    corners = np.column_stack([x.ravel(), y.ravel()])
    number = np.arange(len(corners)).reshape(ny + 1, nx + 1)
    low, right, high, up = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    height = width / ny * tan(radians(angle)) / 2
    centres = (corners[low] + corners[right]).reshape(-1, 2) / 2 + [0, height]
    middle = len(corners) + np.arange(len(centres)).reshape(ny, nx)
    sides = ((low, right), (right, high), (high, up), (up, low))
    cells = np.vstack([np.column_stack([a.ravel(), b.ravel(), middle.ravel()]) for a, b in sides])
    ends = (number[0], number[:, -1], number[-1], number[:, 0])
    edges = {n: np.column_stack([e[:-1], e[1:]]) for n, e in zip(EDGES, ends, strict=True)}
    return Grid(np.vstack([corners, centres]), cells, edges)


def write(grid: Grid, path: Path, seed: int | None = None) -> Path:
    """Write a grid as a gmsh mesh (version 2.2); return the path.

    Args:
        grid: The mesh.
        path: A ``.msh`` file.
        seed: Shuffles the numbers of nodes and elements, and the corners of each triangle;
            None keeps all in order.
    """
    random = np.random.default_rng(seed)
    n = len(grid.points)
    label = np.arange(1, n + 1) if seed is None else random.choice(9 * n, n, replace=False) + 1
    elements = [(1, i + 1, pair) for i, e in enumerate(EDGES) for pair in grid.edges[e]]
    turned = grid.cells if seed is None else [np.roll(c, random.integers(3)) for c in grid.cells]
    elements += [(2, len(EDGES) + 1, cell) for cell in turned]
    order = np.arange(len(elements)) if seed is None else random.permutation(len(elements))
    nodes = np.arange(n) if seed is None else random.permutation(n)
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(EDGES) + 1)]
    lines += [f'1 {i + 1} "{name}"' for i, name in enumerate(EDGES)]
    lines += [f'2 {len(EDGES) + 1} "sheet"', "$EndPhysicalNames", "$Nodes", str(n)]
    places = [(float(x), float(y)) for x, y in grid.points]
    lines += [f"{label[i]} {places[i][0]!r} {places[i][1]!r} 0" for i in nodes]
    lines += ["$EndNodes", "$Elements", str(len(elements))]
    for number, at in enumerate(order, start=1):
        kind, tag, corners = elements[at]
        lines.append(f"{number} {kind} 2 {tag} {tag} " + " ".join(str(label[c]) for c in corners))
    path.write_text("\n".join([*lines, "$EndElements", ""]), encoding="ascii")
    return path
