"""Points in cells: the lattice that fields are stored on, and values at any point of the sheet.

A value at a point, or a mean over a zone, is a weighted sum of the values on the lattices of
cells. Such sums are the rows of a sparse matrix, made once.

Placements may jump across sides of cells, so that a point there has more than one value. It
belongs to the cell on the side of larger x; where the side runs along x, of larger y. Where the
sheet ends there, it belongs to the cell on the other side. This does not depend on the ranks.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import sparse

from wovenfab.sheet.tolerance import SAME_DIRECTION, SAME_PLACE

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]
#: Key of a point that is in no cell; those of other points are smaller.
NOWHERE = np.iinfo(np.int64).max
#: Signs of x and y of the sides that a point may belong to, the first one that there is.
SIDES = ((1, 1), (1, -1), (-1, 1), (-1, -1))
#: Sides of a quarter of the polygon that stands for a circle.
ARC = 128


@dataclass(frozen=True)
class OutputNodes:
    """Equidistant points of the reference triangle (0,0), (1,0), (0,1) and their triangles.

    Each cell has points of its own, so that a field may jump between cells.

    Attributes:
        degree: Number of intervals on a side, the degree of the fields.
    """

    degree: int

    def __post_init__(self) -> None:
        """Refuse a lattice without intervals."""
        if self.degree < 1:
            raise ValueError(f"a lattice needs a degree of at least 1, not {self.degree}")

    @cached_property
    def points(self) -> Array:
        """Reference points, shape ((p+1)(p+2)/2, 2), row by row from the x axis."""
        return np.array(self._nodes) / self.degree

    @cached_property
    def triangles(self) -> Numbers:
        """Points of each sub-triangle, shape (p², 3), all oriented as the reference."""
        number = {node: n for n, node in enumerate(self._nodes)}
        corners = []
        for i, j in self._nodes:
            if i + j < self.degree:
                corners.append([number[i, j], number[i + 1, j], number[i, j + 1]])
            if i + j < self.degree - 1:
                corners.append([number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]])
        return np.array(corners, dtype=np.int64)

    @property
    def _nodes(self) -> list[tuple[int, int]]:
        """Integer coordinates of the points."""
        p = self.degree
        return [(i, j) for j in range(p + 1) for i in range(p + 1 - j)]

    def connectivity(self, cells: int) -> Numbers:
        """Return the triangles of ``cells`` consecutive lattices, shape (cells p², 3)."""
        first = len(self.points) * np.arange(cells, dtype=np.int64)
        return (first[:, None, None] + self.triangles[None]).reshape(-1, 3)

    def basis(self, points: Array) -> Array:
        """Return the Lagrange polynomials of the lattice at reference points, shape (n, nodes)."""
        at_points, at_nodes = (_monomials(x, self.degree) for x in (points, self.points))
        return np.asarray(np.linalg.solve(at_nodes.T, at_points.T).T, dtype=np.float64)

    def at_points(self, cells: Numbers, local: Array, count: int) -> sparse.csr_array:
        """Return the matrix that takes values on lattices to points.

        Args:
            cells: Cell of each point, shape (n,); negative for none, whose row is empty.
            local: Its reference coordinates, shape (n, 2).
            count: Number of cells.

        Returns:
            Shape (n, count nodes).
        """
        (found,) = np.nonzero(cells >= 0)
        return self._matrix(found, cells[found], self.basis(local[found]), (len(cells), count))

    def over_zones(self, corners: Array, zones: list[shapely.Polygon]) -> sparse.csr_array:
        """Return the matrix that integrates values on lattices over convex zones (m²).

        Args:
            corners: Of all cells, shape (cells, 3, 2), m.
            zones: The zones.
        """
        rows, owners, weights = [], [], []
        tree = shapely.STRtree(shapely.polygons(corners))
        gauss, size = _collapsed(self.degree)
        for row, zone in enumerate(zones):
            for cell in tree.query(zone, predicate="intersects"):
                part = shapely.intersection(tree.geometries[cell], zone)
                ring = shapely.get_coordinates(part.exterior)[:-1] if part.area else []
                start, inverse = corners[cell, 0], _inverse(corners[cell])
                for second, third in pairwise(ring[1:]):
                    sides = np.array([second - ring[0], third - ring[0]])
                    local = (ring[0] + gauss @ sides - start) @ inverse
                    area = abs(np.linalg.det(sides))
                    rows.append(row)
                    owners.append(int(cell))
                    weights.append(area * size @ self.basis(local))
        values = np.reshape(weights, (-1, len(self.points)))
        where = np.array(owners, dtype=np.int64)
        return self._matrix(np.array(rows, np.int64), where, values, (len(zones), len(corners)))

    def _matrix(
        self, rows: Numbers, cells: Numbers, weights: Array, shape: tuple[int, int]
    ) -> sparse.csr_array:
        nodes = len(self.points)
        columns = nodes * cells[:, None] + np.arange(nodes)
        entries = (weights.ravel(), (np.repeat(rows, nodes), columns.ravel()))
        return sparse.csr_array(entries, shape=(shape[0], shape[1] * nodes))


def locate(
    corners: Array, points: Array, numbers: NDArray[Any] | None = None
) -> tuple[Numbers, Array, Numbers]:
    """Return where points lie; of several cells as the side of larger x demands.

    Args:
        corners: Of all cells, shape (cells, 3, 2), m.
        points: Shape (n, 2), m.
        numbers: Number of each cell that does not depend on the ranks; consecutive if None.

    Returns:
        The cell of each point, shape (n,), -1 for none; its coordinates there, shape (n, 2); a
        key, which is smallest on the rank that has the right one of several cells.
    """
    numbers = np.arange(len(corners)) if numbers is None else numbers
    slack = SAME_PLACE * max(float(np.abs(array).max(initial=0.0)) for array in (corners, points))
    which, cells = shapely.STRtree(shapely.polygons(corners)).query(
        shapely.points(points), predicate="dwithin", distance=slack
    )
    inverse = _inverse(corners[cells])
    local = np.einsum("nd,ndk->nk", points[which] - corners[cells, 0], inverse)
    share = np.column_stack([1 - local.sum(axis=1), local])
    inwards = np.dstack([-inverse.sum(axis=2), inverse])  # gradient of each share
    size = np.linalg.norm(inwards, axis=1)
    on, (x, y) = share < slack * size, np.moveaxis(inwards, 1, 0) / size
    fits = [
        (~on | (np.where(np.abs(x) > SAME_DIRECTION, right * x, up * y) > 0)).all(axis=1)
        for right, up in SIDES
    ]
    turn = np.argmax([*fits, np.ones(len(which), dtype=bool)], axis=0)
    key = turn * (np.int64(1) << 48) + numbers[cells]
    order = np.lexsort((key, which))
    _, first = np.unique(which[order], return_index=True)
    best = order[first]
    found, at = np.full(len(points), -1, dtype=np.int64), np.zeros((len(points), 2))
    keys = np.full(len(points), NOWHERE)
    found[which[best]], at[which[best]], keys[which[best]] = cells[best], local[best], key[best]
    return found, at, keys


def circle(centre: tuple[float, float], radius: float) -> shapely.Polygon:
    """Return a circle (m) as a polygon of the same area."""
    sides = 4 * ARC
    equal = np.sqrt(2 * np.pi / sides / np.sin(2 * np.pi / sides))
    return shapely.Point(centre).buffer(radius * equal, quad_segs=ARC)


def _inverse(corners: Array) -> Array:
    """Return what takes a vector (m, from the right) to reference coordinates of its cell."""
    sides = corners[..., 1:, :] - corners[..., :1, :]
    return np.asarray(np.linalg.inv(sides), dtype=np.float64)


def _monomials(points: Array, degree: int) -> Array:
    """Return all monomials up to a degree at points, shape (n, (degree+1)(degree+2)/2)."""
    x, y = points.T
    return np.stack([x**i * y**j for j in range(degree + 1) for i in range(degree + 1 - j)], axis=1)


def _collapsed(degree: int) -> tuple[Array, Array]:
    """Return points and weights of a quadrature on the reference triangle."""
    nodes, weights = np.polynomial.legendre.leggauss(degree // 2 + 1 + degree % 2)
    x = (nodes + 1) / 2
    s, t = np.meshgrid(x, x, indexing="ij")
    sizes = np.outer(weights * (1 - x), weights) / 4
    return np.column_stack([s.ravel(), ((1 - s) * t).ravel()]), np.asarray(sizes.ravel())
