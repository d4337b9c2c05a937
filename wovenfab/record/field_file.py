"""``fields.h5`` and ``fields.xdmf`` as one process writes them, complete after every step."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from wovenfab.record.results import write_whole
from wovenfab.record.xdmf import Frame, xdmf

#: Name of the files, without suffix, of the fields of a run and of modes.
FIELDS, MODE = "fields", "mode"
DATA = f"{FIELDS}.h5"

#: No file lock: a run must go on while somebody looks at its results.
UNLOCKED: dict[str, Any] = {"locking": False}
#: The padding with zeros and the smooth fields shrink at little cost.
_PACK: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}


class FieldFile:
    """A mesh and fields on its points over time; the files are closed between the writes."""

    def __init__(
        self,
        directory: Path,
        points: NDArray[np.float64],
        triangles: NDArray[np.int64],
        units: Mapping[str, str],
        name: str = FIELDS,
    ) -> None:
        """Write the mesh.

        Args:
            directory: The results directory.
            points: Points (m), shape (n, 2).
            triangles: Points of each triangle, shape (m, 3).
            units: Name and SI unit of each field.
            name: Name of the files without suffix.
        """
        self._data, self._xdmf = directory / f"{name}.h5", directory / f"{name}.xdmf"
        self._points, self._triangles = len(points), len(triangles)
        self._units = dict(units)
        self._vectors: dict[str, bool] = {}
        self._frames: list[Frame] = []
        with h5py.File(self._data, "w", **UNLOCKED) as file:
            mesh = file.create_group("mesh")
            mesh.create_dataset("points", data=_padded(points), **_PACK).attrs["unit"] = "m"
            mesh.create_dataset("triangles", data=triangles, **_PACK)
            file.create_group("steps")

    def add(self, step: int, time: float, fields: Mapping[str, NDArray[np.float64]]) -> None:
        """Write one time: first the data, then the XDMF that names them.

        Args:
            step: Number of the step.
            time: Time (s), later than the last one.
            fields: Every field on the points, shape (n,) or (n, 2).

        Raises:
            ValueError: The time does not grow, or a field changed its shape.
            OSError: The files cannot be written.
        """
        if self._frames and time <= self._frames[-1].time:
            raise ValueError(f"time {time} s comes after {self._frames[-1].time} s in the fields")
        vectors = {name: values.ndim == 2 for name, values in fields.items()}
        same = not self._frames or vectors == self._vectors
        if not same or any(len(values) != self._points for values in fields.values()):
            raise ValueError(f"the fields of step {step} do not have the shapes of the series")
        frame = Frame(time, f"/steps/{step:06d}")
        with h5py.File(self._data, "r+", **UNLOCKED) as file:
            group = file.create_group(frame.group)
            for name, values in fields.items():
                data = _padded(values) if vectors[name] else values
                group.create_dataset(name, data=data, **_PACK).attrs["unit"] = self._units[name]
            group.attrs.update(step=step, time=time)  # last: marks the step as complete
        self._vectors = vectors
        self._frames.append(frame)
        text = xdmf(self._data.name, self._points, self._triangles, vectors, self._frames)
        write_whole(self._xdmf, text)


def _padded(planar: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return planar vectors with a third component of zero, shape (n, 3)."""
    return np.column_stack([planar, np.zeros(len(planar))])
