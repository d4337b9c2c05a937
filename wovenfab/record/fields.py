"""The lattice of points on which fields are written, finer than the cells by the degree.

Blocks of rows, one a cell, gathered from all ranks in an order that is not the ranks'.

Fields over time, from all ranks into one pair of files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.parallel import agree, on_root
from wovenfab.record import field_file

if TYPE_CHECKING:
    from mpi4py import MPI


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


class Blocks:
    """Gathers rows to rank 0, sorted by cell, so that files do not depend on the ranks.

    Attributes:
        total: Number of blocks on all ranks.
    """

    def __init__(self, comm: MPI.Comm, cells: NDArray[Any]) -> None:
        """Learn the order; collective.

        Args:
            comm: The ranks that hold the blocks.
            cells: Number of each local block's cell in the whole mesh, shape (blocks,).

        Raises:
            ValueError: Two blocks have the same cell (a ghost, say); on every rank.
        """
        self._comm = comm
        parts = comm.allgather(np.asarray(cells, dtype=np.int64))
        together = np.concatenate(parts)
        if len(np.unique(together)) < len(together):
            raise ValueError("a cell is given twice: hand over owned cells only")
        self.total = len(together)
        self._counts = [len(part) for part in parts]
        self._order = np.argsort(together)

    def gather(self, rows: NDArray[Any]) -> NDArray[Any] | None:
        """Return all rows on rank 0, ordered by cell, None elsewhere; collective.

        Args:
            rows: Local rows, shape (rows,) or (rows, columns): the same number for each
                block, and of one type and number of columns on all ranks.

        Raises:
            ValueError: The ranks have blocks of different sizes; on every rank.
        """
        from mpi4py.util.dtlib import from_numpy_dtype

        count = self._counts[self._comm.rank]
        widths = set(self._comm.allgather(rows.size // count if count else None)) - {None}
        if len(widths) > 1:
            raise ValueError("the ranks hand over blocks of different sizes")
        width = widths.pop() if widths else 0
        # counting whole blocks keeps MPI's 32-bit counts from overflowing
        block = from_numpy_dtype(rows.dtype).Create_contiguous(width).Commit()
        received = np.empty((self.total if self._comm.rank == 0 else 0, width), rows.dtype)
        starts = list(accumulate(self._counts, initial=0))[:-1]
        try:
            self._comm.Gatherv(
                [np.ascontiguousarray(rows), count, block],
                [received, self._counts, starts, block],
                root=0,
            )
        finally:
            block.Free()
        if self._comm.rank != 0:
            return None
        return received[self._order].reshape(-1, *rows.shape[1:])


class FieldSeries:
    """Writes fields on a fixed triangle mesh, step by step; rank 0 writes, all call.

    Every rank hands over the blocks of its own cells; the file is ordered by cell, whatever
    the number of ranks.
    """

    def __init__(
        self,
        directory: str | Path,
        comm: MPI.Comm,
        points: NDArray[np.float64],
        triangles: NDArray[Any],
        cells: NDArray[Any],
        units: Mapping[str, str],
        name: str = field_file.FIELDS,
    ) -> None:
        """Write the mesh; collective.

        Args:
            directory: The results directory.
            comm: The ranks that call.
            points: Local points (m), shape (n, 2): a block of equal size for each cell.
            triangles: Local points of each triangle, shape (m, 3), a block for each cell.
            cells: Number of each block's cell in the whole mesh, shape (blocks,); cells
                that the rank owns, no ghosts.
            units: Name and SI unit of each field that will be written ("1" for none).
            name: Name of the files without suffix.

        Raises:
            ValueError: The arrays do not fit together or are not finite; on every rank.
        """
        self._comm = comm
        self._units = dict(units)
        self._count = len(points)
        points = np.asarray(points, dtype=np.float64)
        triangles = np.asarray(triangles, dtype=np.int64)
        agree(comm, _mesh_problem(points, triangles, len(cells)))
        self._blocks = Blocks(comm, cells)
        size = len(points) // max(len(cells), 1)
        own = size * np.repeat(np.arange(len(cells)), len(triangles) // max(len(cells), 1))
        inside = triangles - own[:, None]
        astray = bool(((inside < 0) | (inside >= size)).any())
        agree(comm, ValueError("a triangle leaves its cell's block of points") if astray else None)
        all_points, all_inside = (self._blocks.gather(points), self._blocks.gather(inside))

        def start() -> None:
            assert all_points is not None
            assert all_inside is not None
            blocks = max(self._blocks.total, 1)
            first = np.arange(blocks) * (len(all_points) // blocks)
            shift = np.repeat(first, len(all_inside) // blocks)
            cells = field_file.triangles(all_inside + shift[:, None])
            self._file = field_file.FieldFile(Path(directory), name, cells, all_points, self._units)

        on_root(comm, start)

    def write(self, step: int, time: float, data: Mapping[str, NDArray[np.float64]]) -> None:
        """Add one time to the series; collective. The files are then complete and closed.

        Args:
            step: Number of the step, as in the history.
            time: Time (s), later than the last one written.
            data: Every announced field on the local points, shape (n,) or (n, 2).

        Raises:
            ValueError: A field is missing, unknown, of a wrong shape or not finite, or the
                time does not grow; on every rank, and nothing is written.
        """
        local = {name: np.asarray(values, dtype=np.float64) for name, values in data.items()}
        agree(self._comm, self._problem(step, time, local))
        gathered = {name: self._blocks.gather(local[name]) for name in self._units}
        fields = {name: values for name, values in gathered.items() if values is not None}
        on_root(self._comm, lambda: self._file.add(step, float(time), fields))

    def _problem(
        self, step: int, time: float, fields: Mapping[str, NDArray[np.float64]]
    ) -> ValueError | None:
        """Return what is wrong with the data of this rank."""
        if set(fields) != set(self._units):
            return ValueError(f"fields {sorted(fields)} given, {sorted(self._units)} announced")
        if not np.isfinite(time):
            return ValueError(f"the time of step {step} is not finite")
        for name, values in fields.items():
            if values.shape not in ((self._count,), (self._count, 2)):
                return ValueError(f"field {name} has shape {values.shape}, {self._count} points")
            if not np.isfinite(values).all():
                return ValueError(f"field {name} of step {step} has values that are not finite")
        return None


def _mesh_problem(
    points: NDArray[np.float64], triangles: NDArray[np.int64], blocks: int
) -> ValueError | None:
    if points.ndim != 2 or points.shape[1] != 2:
        return ValueError(f"points must have shape (n, 2), not {points.shape}")
    if triangles.ndim != 2 or triangles.shape[1] != 3:
        return ValueError(f"triangles must have shape (m, 3), not {triangles.shape}")
    for what, rows in (("points", len(points)), ("triangles", len(triangles))):
        if rows % blocks if blocks else rows:
            return ValueError(f"{rows} {what} cannot be shared out to {blocks} cells")
    if not np.isfinite(points).all():
        return ValueError("the mesh has points that are not finite")
    return None
