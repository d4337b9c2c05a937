"""A series of fields in HDF5 and XDMF as one process writes it, complete after every step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import SEEK_END
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import h5py
import numpy as np
from numpy.typing import NDArray

from wovenfab.record.results import write_whole

#: Names, without suffix, of the files with the fields of a run, its modes and its errors.
FIELDS, MODE, ERROR = "fields", "mode", "error"
DATA = f"{FIELDS}.h5"
#: No file lock: a run must go on while somebody looks at its results.
UNLOCKED: dict[str, Any] = {"locking": False}

#: The XDMF text around the frames, and the depth of the frames in it.
_HEAD = """<?xml version="1.0"?>
<Xdmf Version="3.0">
  <Domain>
    <Grid Name="fields" GridType="Collection" CollectionType="Temporal">
"""
_TAIL = """    </Grid>
  </Domain>
</Xdmf>
"""
_LEVEL = 3
#: Zero padding and smooth fields shrink at little cost.
_PACK: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
#: XDMF's number of a polyline among other cells.
_POLYLINE = 2


@dataclass(frozen=True)
class Cells:
    """The cells that join the points.

    Attributes:
        kind: XDMF's name: ``Triangle``, or ``Mixed`` where each cell begins with its kind
            and size.
        name: Name of the data set.
        count: Number of cells.
        connectivity: Points of the cells in XDMF's form.
    """

    kind: str
    name: str
    count: int
    connectivity: NDArray[np.int64]


def triangles(corners: NDArray[np.int64]) -> Cells:
    """Return triangles, given by their points, shape (m, 3)."""
    return Cells("Triangle", "triangles", len(corners), corners)


def polylines(sizes: Sequence[int]) -> Cells:
    """Return polylines through consecutive points, given by their numbers of points."""
    starts = np.cumsum([0, *sizes])
    parts = [[_POLYLINE, n, *range(s, s + n)] for s, n in zip(starts[:-1], sizes, strict=True)]
    return Cells("Mixed", "lines", len(parts), np.concatenate([[], *parts]).astype(np.int64))


class FieldFile:
    """Cells and fields on their points over time; the files are closed between the writes."""

    def __init__(
        self,
        directory: Path,
        name: str,
        cells: Cells,
        points: NDArray[np.float64],
        units: Mapping[str, str],
        moving: bool = False,
    ) -> None:
        """Write the mesh.

        Args:
            directory: The results directory.
            name: Name of the two files, without suffix.
            cells: How the points are joined.
            points: Points at rest (m), shape (n, 2).
            units: Name and SI unit of each field.
            moving: Whether each time has points of its own, as the field ``points``; if not,
                all share ``/mesh/points``.
        """
        self._data, self._text = directory / f"{name}.h5", directory / f"{name}.xdmf"
        self._cells, self._count, self._moving = cells, len(points), moving
        self._units = dict(units)
        self._vectors: dict[str, bool] = {}
        self._last: float | None = None  # time, s
        with h5py.File(self._data, "w", **UNLOCKED) as file:
            mesh = file.create_group("mesh")
            mesh.create_dataset("points", data=_padded(points), **_PACK).attrs["unit"] = "m"
            mesh.create_dataset(cells.name, data=cells.connectivity, **_PACK)
            file.create_group("steps")

    def add(self, step: int, time: float, fields: Mapping[str, NDArray[np.float64]]) -> None:
        """Write one time (s): first the data, then the XDMF that refers to them.

        Every field is given on the points, shape (n,) or (n, 2); moving points among them.

        Raises:
            ValueError: The time does not increase, or a field changed its shape.
            OSError: The files cannot be written.
        """
        if self._last is not None and time <= self._last:
            raise ValueError(f"time {time} s comes after {self._last} s in the fields")
        vectors = {name: values.ndim == 2 for name, values in fields.items()}
        same = self._last is None or vectors == self._vectors
        if not same or any(len(values) != self._count for values in fields.values()):
            raise ValueError(f"the fields of step {step} do not have the shapes of the series")
        where = f"/steps/{step:06d}"
        with h5py.File(self._data, "r+", **UNLOCKED) as file:
            group = file.create_group(where)
            for name, values in fields.items():
                data = _padded(values) if vectors[name] else values
                group.create_dataset(name, data=data, **_PACK).attrs["unit"] = self._units[name]
            group.attrs.update(step=step, time=time)  # last: marks the step as complete
        self._append(self._frame(time, where, vectors))
        self._vectors, self._last = vectors, time

    def _frame(self, time: float, group: str, vectors: Mapping[str, bool]) -> str:
        """Return the XDMF text of one time.

        Each frame has topology, geometry and all attributes itself, without references:
        ParaView's first reader crashes on the form with ``xi:include``, and the other two
        split the fields over blocks when each has a collection of its own. ``vectors`` says
        of each field in the HDF5 group whether it has three components.
        """
        grid = ET.Element("Grid", Name="sheet", GridType="Uniform")
        ET.SubElement(grid, "Time", Value=repr(time))
        cells = {"TopologyType": self._cells.kind, "NumberOfElements": str(self._cells.count)}
        topology = ET.SubElement(grid, "Topology", cells)
        self._item(topology, f"/mesh/{self._cells.name}", self._cells.connectivity.shape, "Int")
        geometry = ET.SubElement(grid, "Geometry", GeometryType="XYZ")
        place = group if self._moving else "/mesh"
        self._item(geometry, f"{place}/points", (self._count, 3))
        for name in (name for name in vectors if name != "points"):
            kind = "Vector" if vectors[name] else "Scalar"
            shape = (self._count, 3) if vectors[name] else (self._count,)
            about = {"Name": name, "AttributeType": kind, "Center": "Node"}
            self._item(ET.SubElement(grid, "Attribute", about), f"{group}/{name}", shape)
        ET.indent(grid, level=_LEVEL)
        return 2 * _LEVEL * " " + ET.tostring(grid, encoding="unicode") + "\n"

    def _item(
        self, parent: ET.Element, where: str, shape: tuple[int, ...], kind: str = "Float"
    ) -> None:
        size = " ".join(map(str, shape))
        item = ET.SubElement(
            parent, "DataItem", Dimensions=size, NumberType=kind, Precision="8", Format="HDF"
        )
        item.text = f"{self._data.name}:{where}"

    def _append(self, frame: str) -> None:
        """Add a frame at the end of the XDMF, without rewriting the thousands before it."""
        if self._last is None:
            write_whole(self._text, _HEAD + frame + _TAIL)
            return
        with self._text.open("r+b", buffering=0) as file:  # one write: readers find it whole
            file.seek(-len(_TAIL.encode()), SEEK_END)
            file.write((frame + _TAIL).encode())


def _padded(planar: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return planar vectors with a third component of zero, shape (n, 3)."""
    return np.column_stack([planar, np.zeros(len(planar))])
