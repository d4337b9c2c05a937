"""Fields over time: written from all ranks into one pair of files, and read back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from math import isqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.parallel import agree, on_root
from wovenfab.record.field_file import (
    FIELDS,
    MESH,
    FieldFile,
    file_of,
    opened,
    times_after,
    triangles,
    values_of,
)
from wovenfab.record.reading import damaged
from wovenfab.record.results import LINES, rows_of, write_csv
from wovenfab.sheet.output_nodes import OutputNodes, locate
from wovenfab.sheet.probes import Line, Yarn

if TYPE_CHECKING:
    from mpi4py import MPI


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
        lattice: OutputNodes,
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

    def finish(self) -> None:
        """Let the file that joins all times have the last ones, too; collective."""
        on_root(self._comm, lambda: self._file.finish())

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
        return _planar(self._mesh[0])

    def triangles(self) -> NDArray[np.int64]:
        """Return the points of each triangle, shape (m, 3)."""
        return self._mesh[1]

    def field(self, name: str, index: int) -> NDArray[np.float64]:
        """Return a field at ``times[index]`` on the points in SI units, shape (n,) or (n, 2).

        Raises:
            UnreadableResultsError: Its file is damaged.
        """
        path = self._folder / file_of(int(self.steps[index]))
        with opened(path) as file:
            values = values_of(file, name)
        if values.shape not in ((len(self._mesh[0]),), (len(self._mesh[0]), 3)):
            raise damaged(path, f"{name} has not one value a point of the mesh")
        return _planar(values)

    @property
    def _folder(self) -> Path:
        return self.path.with_suffix("")

    @cached_property
    def _mesh(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Points, shape (n, 3), and triangles, shape (m, 3)."""
        path = self._folder / MESH
        with opened(path) as file:
            points, corners = (values_of(file, f"mesh/{n}") for n in ("points", "triangles"))
        if points.ndim != 2 or points.shape[1] != 3 or corners.ndim != 2 or corners.shape[1] != 3:
            raise damaged(path, "this is no mesh of triangles")
        if not len(corners) or corners.min() < 0 or corners.max() >= len(points):
            raise damaged(path, "a triangle has a corner that is not there")
        return points.astype(np.float64), corners.astype(np.int64)

    @cached_property
    def lattice(self) -> OutputNodes:
        """The lattice that each cell has."""
        points, triangles = map(len, self._mesh)
        # a cell has (p+1)(p+2)/2 points and p^2 triangles, a ratio that no two degrees share
        for p in range(1, isqrt(triangles) + 1):
            if 2 * p * p * points == (p + 1) * (p + 2) * triangles:
                return OutputNodes(p)
        raise damaged(self._folder / MESH, "points and triangles do not make cells")

    def corners(self) -> NDArray[np.float64]:
        """Return the corners (m) of the cells, shape (cells, 3, 2)."""
        x, y = self.lattice.points.T
        (ends,) = np.nonzero((x == 1) | (y == 1) | (x + y == 0))
        return self.points().reshape(-1, len(x), 2)[:, ends]

    def at(self, points: NDArray[np.float64]) -> Callable[[str, int], NDArray[np.float64]]:
        """Return a function that gives a field, as ``field`` does, at any points of the sheet.

        Where a field jumps, it has the value on the side of larger x; see
        :mod:`wovenfab.sheet.output_nodes`. Points that are not on the sheet have the value NaN.

        Args:
            points: Reference positions, shape (n, 2), m.
        """
        corners = self.corners()
        cells, local, _ = locate(corners, points)
        matrix = self.lattice.at_points(cells, local, len(corners))

        def field(name: str, index: int) -> NDArray[np.float64]:
            if name == "beta":  # the length of a vector is no polynomial
                relative = field("relative_displacement", index)
                return np.asarray(np.linalg.norm(relative, axis=1))
            values = np.asarray(matrix @ self.field(name, index))
            values[cells < 0] = np.nan
            return values

        return field

    def columns(
        self, index: int, field: Callable[[str, int], NDArray[np.float64]] | None = None
    ) -> dict[str, NDArray[np.float64]]:
        """Return all fields at ``times[index]`` as columns of a table, units in their names.

        Args:
            index: Which time.
            field: What ``at`` has returned; at the stored points if None.
        """
        found: dict[str, NDArray[np.float64]] = {}
        for name, si in self.units.items():
            unit = "" if si == "1" else "_" + si.replace("1/", "per_")
            values = (field or self.field)(name, index)
            parts = {"": values} if values.ndim == 1 else {"_x": values[:, 0], "_y": values[:, 1]}
            found |= {f"{name}{part}{unit}": column for part, column in parts.items()}
        return found


def read_fields(directory: str | Path, name: str = FIELDS) -> StoredFields:
    """Return the series ``name`` of a results directory; data are loaded when asked for.

    Times that a run which goes on, or was killed, has not listed yet are found in the folder.

    Raises:
        FileNotFoundError: The run wrote no fields.
        UnreadableResultsError: A file of theirs is damaged.
    """
    path = Path(directory) / f"{name}.h5"
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist: the run wrote no fields")
    with opened(path) as file:
        steps, times = values_of(file, "numbers"), values_of(file, "times")
        if steps.dtype.kind != "i" or steps.ndim != 1 or times.shape != steps.shape:
            raise damaged(path, "this is no list of times")
    folder = path.with_suffix("")
    later = times_after(folder, int(steps[-1]) if len(steps) else -1)
    steps = np.array([*steps, *(step for step, _ in later)], dtype=np.int64)
    times = np.array([*times, *(time for _, time in later)], dtype=np.float64)
    if not (np.diff(steps) > 0).all() or not (np.diff(times) > 0).all() or (steps < 0).any():
        raise damaged(path, "its times do not increase")
    units: dict[str, str] = {}
    if len(steps):
        with opened(folder / file_of(int(steps[0]))) as file:
            units = {name: str(data.attrs["unit"]) for name, data in file.items()}
    return StoredFields(path, steps, times, units)


def _planar(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Drop the third component, with which vectors are padded for ParaView."""
    return rows[:, :2] if rows.ndim == 2 else rows


def write_lines(
    directory: Path, lines: Mapping[str, Line | Yarn], fibres: NDArray[np.float64]
) -> None:
    """Write ``lines.csv``: all stored fields along lines at all stored times; on one rank.

    Args:
        directory: The results directory.
        lines: Lines by name.
        fibres: Direction of each family at rest, shape (2, 2).
    """
    stored = read_fields(directory)
    parts: list[tuple[dict[str, Any], dict[str, Any], Any]] = []
    for name, line in lines.items():
        start, end = line.ends if isinstance(line, Line) else line.ends(fibres, stored.corners())
        share = np.linspace(0.0, 1.0, line.points)
        way = np.subtract(end, start)
        points = start + share[:, None] * way
        place = {
            "distance_m": share * np.linalg.norm(way),
            "x_m": points[:, 0],
            "y_m": points[:, 1],
        }
        parts.append(({"line": [name] * len(share)}, place, stored.at(points)))
    tables: list[dict[str, Any]] = [
        name | {"step": [step] * len(place["x_m"]), "time_s": [time] * len(place["x_m"])}
        | place | stored.columns(index, at)
        for index, (step, time) in enumerate(zip(stored.steps, stored.times, strict=True))
        for name, place, at in parts
    ]  # fmt: skip
    rows = [row for table in tables for row in rows_of(table)]
    write_csv(directory / LINES, rows)
