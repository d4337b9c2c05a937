"""Fields over time: written from all ranks into one pair of files, and read back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from wovenfab.parallel import agree, on_root
from wovenfab.record.field_file import FIELDS, UNLOCKED, FieldFile, triangles

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
        return np.array(self._nodes) / self.degree

    @cached_property
    def triangles(self) -> NDArray[np.int64]:
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
        """Exchange the global numbers of each rank's cells, one a block; collective.

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
        from mpi4py import MPI

        count = self._counts[self._comm.rank]
        widths = set(self._comm.allgather(rows.size // count if count else None)) - {None}
        if len(widths) > 1:
            raise ValueError("the ranks hand over blocks of different sizes")
        width = widths.pop() if widths else 0
        # counting whole blocks keeps MPI's 32-bit counts from overflowing
        block = MPI.Datatype.fromcode(rows.dtype.char).Create_contiguous(width).Commit()
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

    Every rank gives the blocks of its own cells. The file is ordered by cell and does not
    depend on the number of ranks.
    """

    def __init__(
        self,
        directory: str | Path,
        comm: MPI.Comm,
        lattice: Lattice,
        points: NDArray[np.float64],
        cells: NDArray[Any],
        units: Mapping[str, str],
        name: str = FIELDS,
        until: int = -1,
    ) -> None:
        """Write the mesh, or go on with an earlier series; collective.

        Args:
            directory: The results directory.
            comm: The ranks that call.
            lattice: The lattice that each cell has, the same on all ranks.
            points: Local points (m), shape (n, 2): those of the lattice, cell by cell.
            cells: Global number of each cell, shape (cells,); owned cells only, no ghosts.
            units: Name and SI unit of each field that will be written ("1" for none).
            name: Name of the files without suffix.
            until: Last step of an earlier series that is kept; negative for none.

        Raises:
            ValueError: The arrays do not fit together or are not finite; on every rank.
        """
        self._comm, self._units, self._count = comm, dict(units), len(points)
        points = np.asarray(points, dtype=np.float64)
        agree(comm, _mesh_problem(points, len(lattice.points) * len(cells)))
        self._blocks = Blocks(comm, cells)
        everything = self._blocks.gather(points)

        def start() -> None:
            assert everything is not None
            mesh = triangles(lattice.connectivity(self._blocks.total))
            self._file = FieldFile(
                Path(directory), name, mesh, everything, self._units, until=until
            )

        on_root(comm, start)

    def write(self, step: int, time: float, data: Mapping[str, NDArray[np.float64]]) -> None:
        """Add one time to the series; collective. The files are then complete and closed.

        The times (s) increase; ``data`` has every announced field on the local points, shape
        (n,) or (n, 2).

        Raises:
            ValueError: A field is missing, unknown, of a wrong shape or not finite, or the
                time does not increase; on every rank, and nothing is written.
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


def _mesh_problem(points: NDArray[np.float64], count: int) -> ValueError | None:
    if points.shape != (count, 2):
        return ValueError(f"points must have shape ({count}, 2), not {points.shape}")
    if not np.isfinite(points).all():
        return ValueError("the mesh has points that are not finite")
    return None


@dataclass(frozen=True)
class StoredFields:
    """The series of fields of a run, as far as it was written.

    Attributes:
        path: The HDF5 file.
        steps: Numbers of the stored steps, shape (times,).
        times: Their times (s), ascending, shape (times,).
        units: Name and SI unit of each field.
    """

    path: Path
    steps: NDArray[np.int64]
    times: NDArray[np.float64]
    units: dict[str, str]

    def points(self) -> NDArray[np.float64]:
        """Return the reference points (m), shape (n, 2); each cell has its own."""
        return _planar(self._load("mesh/points"))

    def triangles(self) -> NDArray[np.int64]:
        """Return the points of each triangle, shape (m, 3)."""
        corners: NDArray[np.int64] = self._load("mesh/triangles")
        return corners

    def field(self, name: str, index: int) -> NDArray[np.float64]:
        """Return a field at ``times[index]`` on the points in SI units, shape (n,) or (n, 2)."""
        return _planar(self._load(f"steps/{self.steps[index]:06d}/{name}"))

    def _load(self, where: str) -> Any:
        with h5py.File(self.path, "r", **UNLOCKED) as file:
            return file[where][()]


def read_fields(directory: str | Path, name: str = FIELDS) -> StoredFields:
    """Return the series ``name`` of a results directory; data are loaded when asked for.

    Raises:
        FileNotFoundError: The run wrote no fields.
    """
    path = Path(directory) / f"{name}.h5"
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist: the run wrote no fields")
    with h5py.File(path, "r", **UNLOCKED) as file:
        steps, times = file["numbers"][()], file["times"][()]
        fields = file[f"steps/{steps[0]:06d}"].items() if len(steps) else ()
        units = {name: str(data.attrs["unit"]) for name, data in fields}
    return StoredFields(path, steps, times, units)


def _planar(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Drop the third component, with which vectors are padded for ParaView."""
    return rows[:, :2] if rows.ndim == 2 else rows
