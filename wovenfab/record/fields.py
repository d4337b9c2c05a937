"""Fields over time, from all ranks into one pair of files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.parallel import agree, on_root
from wovenfab.record import field_file
from wovenfab.record.blocks import Blocks

if TYPE_CHECKING:
    from mpi4py import MPI


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
