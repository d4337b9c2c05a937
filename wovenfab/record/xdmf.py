"""The XDMF text that makes every reader of ParaView see the fields together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree as ET

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
