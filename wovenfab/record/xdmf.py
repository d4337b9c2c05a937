"""The XDMF text that makes every reader of ParaView see the fields together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET


@dataclass(frozen=True)
class Frame:
    """One time of the series: its time (s) and the HDF5 group of its fields."""

    time: float
    group: str


def xdmf(
    data: str, points: int, triangles: int, vectors: Mapping[str, bool], frames: Sequence[Frame]
) -> str:
    """Return the XDMF of a series on one mesh.

    Each frame names topology, geometry and all attributes itself, without references:
    ParaView's first reader crashes on the form with ``xi:include``, and the other two split
    the fields over blocks when each has a collection of its own.

    Args:
        data: Name of the HDF5 file, which has ``/mesh/points`` and ``/mesh/triangles``.
        points: Number of points.
        triangles: Number of triangles.
        vectors: For each field whether it is a vector (three components) or a scalar.
        frames: The times, ascending.
    """
    root = ET.Element("Xdmf", Version="3.0")
    domain = ET.SubElement(root, "Domain")
    series = ET.SubElement(
        domain, "Grid", Name="fields", GridType="Collection", CollectionType="Temporal"
    )
    for frame in frames:
        grid = ET.SubElement(series, "Grid", Name="sheet", GridType="Uniform")
        ET.SubElement(grid, "Time", Value=repr(frame.time))
        topology = ET.SubElement(
            grid, "Topology", TopologyType="Triangle", NumberOfElements=str(triangles)
        )
        _item(topology, f"{data}:/mesh/triangles", (triangles, 3), "Int")
        geometry = ET.SubElement(grid, "Geometry", GeometryType="XYZ")
        _item(geometry, f"{data}:/mesh/points", (points, 3), "Float")
        for name, vector in vectors.items():
            kind = "Vector" if vector else "Scalar"
            attribute = ET.SubElement(
                grid, "Attribute", Name=name, AttributeType=kind, Center="Node"
            )
            shape = (points, 3) if vector else (points,)
            _item(attribute, f"{data}:{frame.group}/{name}", shape, "Float")
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _item(parent: ET.Element, where: str, shape: tuple[int, ...], kind: str) -> None:
    dimensions = " ".join(map(str, shape))
    item = ET.SubElement(
        parent, "DataItem", Dimensions=dimensions, NumberType=kind, Precision="8", Format="HDF"
    )
    item.text = where
