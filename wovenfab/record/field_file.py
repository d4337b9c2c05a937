"""The XDMF text that makes every reader of ParaView see the fields together.

A series in HDF5 and XDMF as one process writes it, complete after every step.
"""

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

#: What is around the frames, and how deep they are in it.
HEAD = """<?xml version="1.0"?>
<Xdmf Version="3.0">
  <Domain>
    <Grid Name="fields" GridType="Collection" CollectionType="Temporal">
"""
TAIL = """    </Grid>
  </Domain>
</Xdmf>
"""
LEVEL = 3


@dataclass(frozen=True)
class Frame:
    """One time of the series: its time (s) and the HDF5 group of its fields."""

    time: float
    group: str


@dataclass(frozen=True)
class Layout:
    """What the HDF5 file of a series holds.

    Attributes:
        data: Name of the HDF5 file.
        kind: ``Triangle``, or ``Mixed`` where each cell begins with its kind and size.
        cells: Number of cells.
        connectivity: Data set of the cells' points, and its shape.
        points: Number of points.
        moving: Whether each frame has points of its own beside its fields; if not, all
            share ``/mesh/points``.
    """

    data: str
    kind: str
    cells: int
    connectivity: tuple[str, tuple[int, ...]]
    points: int
    moving: bool


def frame_text(layout: Layout, vectors: Mapping[str, bool], frame: Frame) -> str:
    """Return the text of one frame, which stands between ``HEAD`` and ``TAIL`` with others.

    Each frame names topology, geometry and all attributes itself, without references:
    ParaView's first reader crashes on the form with ``xi:include``, and the other two split
    the fields over blocks when each has a collection of its own.

    Args:
        layout: What is in the HDF5 file.
        vectors: For each field whether it is a vector (three components) or a scalar.
        frame: The time.
    """
    grid = ET.Element("Grid", Name="sheet", GridType="Uniform")
    ET.SubElement(grid, "Time", Value=repr(frame.time))
    topology = ET.SubElement(
        grid, "Topology", TopologyType=layout.kind, NumberOfElements=str(layout.cells)
    )
    where, shape = layout.connectivity
    _item(topology, f"{layout.data}:{where}", shape, "Int")
    geometry = ET.SubElement(grid, "Geometry", GeometryType="XYZ")
    place = frame.group if layout.moving else "/mesh"
    _item(geometry, f"{layout.data}:{place}/points", (layout.points, 3), "Float")
    for name, vector in vectors.items():
        kind = "Vector" if vector else "Scalar"
        attribute = ET.SubElement(grid, "Attribute", Name=name, AttributeType=kind, Center="Node")
        size = (layout.points, 3) if vector else (layout.points,)
        _item(attribute, f"{layout.data}:{frame.group}/{name}", size, "Float")
    ET.indent(grid, level=LEVEL)
    return 2 * LEVEL * " " + ET.tostring(grid, encoding="unicode") + "\n"


def _item(parent: ET.Element, where: str, shape: tuple[int, ...], kind: str) -> None:
    dimensions = " ".join(map(str, shape))
    item = ET.SubElement(
        parent, "DataItem", Dimensions=dimensions, NumberType=kind, Precision="8", Format="HDF"
    )
    item.text = where


#: Name of the files, without suffix, of the fields of a run and of modes.
FIELDS, MODE, ERROR = "fields", "mode", "error"
DATA = f"{FIELDS}.h5"

#: No file lock: a run must go on while somebody looks at its results.
UNLOCKED: dict[str, Any] = {"locking": False}
#: The padding with zeros and the smooth fields shrink at little cost.
_PACK: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
#: XDMF's number of a polyline among other cells.
_POLYLINE = 2


@dataclass(frozen=True)
class Cells:
    """How points are joined.

    Attributes:
        kind: XDMF's name.
        name: Name of the data set.
        count: Number of cells.
        connectivity: Points of the cells as XDMF has them.
    """

    kind: str
    name: str
    count: int
    connectivity: NDArray[np.int64]


def triangles(corners: NDArray[np.int64]) -> Cells:
    """Return triangles, given by their points, shape (m, 3)."""
    return Cells("Triangle", "triangles", len(corners), corners)


def polylines(sizes: Sequence[int]) -> Cells:
    """Return polylines through consecutive points, so many each."""
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
            moving: Whether each time has points of its own, by the name ``points``.
        """
        self._path = directory / name
        connectivity = (f"/mesh/{cells.name}", cells.connectivity.shape)
        self._layout = Layout(
            f"{name}.h5", cells.kind, cells.count, connectivity, len(points), moving
        )
        self._units = dict(units)
        self._vectors: dict[str, bool] = {}
        self._last: float | None = None  # time, s
        with h5py.File(self._path.with_suffix(".h5"), "w", **UNLOCKED) as file:
            mesh = file.create_group("mesh")
            mesh.create_dataset("points", data=_padded(points), **_PACK).attrs["unit"] = "m"
            mesh.create_dataset(cells.name, data=cells.connectivity, **_PACK)
            file.create_group("steps")

    def add(self, step: int, time: float, fields: Mapping[str, NDArray[np.float64]]) -> None:
        """Write one time: first the data, then the XDMF that names them.

        Args:
            step: Number of the step.
            time: Time (s), later than the last one.
            fields: Every field on the points, shape (n,) or (n, 2); where they move, the
                points among them.

        Raises:
            ValueError: The time does not grow, or a field changed its shape.
            OSError: The files cannot be written.
        """
        if self._last is not None and time <= self._last:
            raise ValueError(f"time {time} s comes after {self._last} s in the fields")
        vectors = {name: values.ndim == 2 for name, values in fields.items()}
        same = self._last is None or vectors == self._vectors
        if not same or any(len(values) != self._layout.points for values in fields.values()):
            raise ValueError(f"the fields of step {step} do not have the shapes of the series")
        frame = Frame(time, f"/steps/{step:06d}")
        with h5py.File(self._path.with_suffix(".h5"), "r+", **UNLOCKED) as file:
            group = file.create_group(frame.group)
            for name, values in fields.items():
                data = _padded(values) if vectors[name] else values
                group.create_dataset(name, data=data, **_PACK).attrs["unit"] = self._units[name]
            group.attrs.update(step=step, time=time)  # last: marks the step as complete
        shown = {name: vector for name, vector in vectors.items() if name != "points"}
        self._name(frame_text(self._layout, shown, frame))
        self._vectors, self._last = vectors, time

    def _name(self, frame: str) -> None:
        """Add the text of a frame to the XDMF, at its end: long runs have thousands."""
        path = self._path.with_suffix(".xdmf")
        if self._last is None:
            write_whole(path, HEAD + frame + TAIL)
            return
        with path.open("r+b", buffering=0) as file:  # one write, so that readers find it whole
            file.seek(-len(TAIL.encode()), SEEK_END)
            file.write((frame + TAIL).encode())


def _padded(planar: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return planar vectors with a third component of zero, shape (n, 3)."""
    return np.column_stack([planar, np.zeros(len(planar))])
