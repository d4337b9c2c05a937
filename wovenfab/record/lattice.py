"""The lattice of points on which fields are written, finer than the cells by the degree."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Lattice:
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
    def points(self) -> NDArray[np.float64]:
        """Reference points, shape ((p+1)(p+2)/2, 2), row by row from the x axis."""
        p = self.degree
        return np.array([[i, j] for j in range(p + 1) for i in range(p + 1 - j)]) / p

    @cached_property
    def triangles(self) -> NDArray[np.int64]:
        """Points of each sub-triangle, shape (p², 3), all with the sense of the reference."""
        p = self.degree
        number = {
            ij: n for n, ij in enumerate((i, j) for j in range(p + 1) for i in range(p + 1 - j))
        }
        found = []
        for j in range(p):
            for i in range(p - j):
                found.append([number[i, j], number[i + 1, j], number[i, j + 1]])
                if i + j < p - 1:
                    found.append([number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]])
        return np.array(found, dtype=np.int64)

    def connectivity(self, cells: int) -> NDArray[np.int64]:
        """Return the triangles of ``cells`` consecutive lattices, shape (cells p², 3)."""
        first = len(self.points) * np.arange(cells, dtype=np.int64)
        return (first[:, None, None] + self.triangles[None]).reshape(-1, 3)
