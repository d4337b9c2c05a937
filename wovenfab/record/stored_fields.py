"""Fields read back from a results directory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from wovenfab.record.field_file import FIELDS, UNLOCKED


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
        """Return the reference points (m), shape (n, 2); a cell's points are its own."""
        return _planar(self._load("mesh/points"))

    def triangles(self) -> NDArray[np.int64]:
        """Return the points of each triangle, shape (m, 3)."""
        triangles: NDArray[np.int64] = self._load("mesh/triangles")
        return triangles

    def field(self, name: str, index: int) -> NDArray[np.float64]:
        """Return a field on the points, in SI units.

        Args:
            name: One of ``units``.
            index: Which of the stored times; -1 is the last.

        Returns:
            Shape (n,) for a scalar, (n, 2) for a vector.
        """
        return _planar(self._load(f"steps/{self.steps[index]:06d}/{name}"))

    def _load(self, where: str) -> Any:
        with h5py.File(self.path, "r", **UNLOCKED) as file:
            return file[where][()]


def read_fields(directory: str | Path, name: str = FIELDS) -> StoredFields:
    """Return the fields of a results directory; the data are loaded when asked for.

    Args:
        directory: The results directory.
        name: Name of the files without suffix.

    Raises:
        FileNotFoundError: The run wrote no fields.
    """
    path = Path(directory) / f"{name}.h5"
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist: the run wrote no fields")
    with h5py.File(path, "r", **UNLOCKED) as file:
        complete = (group for group in file["steps"].values() if "time" in group.attrs)
        groups = sorted(complete, key=lambda group: float(group.attrs["time"]))
        steps = np.array([group.attrs["step"] for group in groups], dtype=np.int64)
        times = np.array([group.attrs["time"] for group in groups], dtype=np.float64)
        fields = groups[0].items() if groups else ()
        units = {name: str(data.attrs["unit"]) for name, data in fields}
    return StoredFields(path, steps, times, units)


def _planar(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Drop the third component, with which vectors are padded for ParaView."""
    return rows[:, :2] if rows.ndim == 2 else rows
