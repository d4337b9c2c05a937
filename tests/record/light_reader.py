"""Reads fields.xdmf as a reader must: resolves every reference and checks every dimension."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import h5py
import numpy as np

KINDS = {"Float": "f", "Int": "i"}
SHAPES = {"Scalar": 1, "Vector": 2}


class BrokenFileError(Exception):
    """The file does not say what a reader needs."""


def read(path: Path) -> list[dict[str, np.ndarray]]:
    """Return for each time its arrays by name, with ``time``, ``points`` and ``triangles``."""
    collections = ET.parse(path).getroot().findall("./Domain/Grid")
    _require(len(collections) == 1, "there is not exactly one grid in the domain")
    series = collections[0]
    _require(series.get("CollectionType") == "Temporal", "the grid is no temporal collection")
    frames = [_frame(path, grid) for grid in series]
    times = [float(frame["time"]) for frame in frames]
    _require(times == sorted(set(times)), "the times do not grow")
    return frames


def _frame(path: Path, grid: ET.Element) -> dict[str, np.ndarray]:
    _require(grid.tag == "Grid", f"{grid.tag} in place of a grid")
    _require(grid.get("GridType") == "Uniform", "a time is not a uniform grid")
    points = _data(path, _one(grid, "Geometry"))
    triangles = _data(path, _one(grid, "Topology"))
    _require(points.ndim == 2 and points.shape[1] == 3, "the geometry is not XYZ")
    number = int(_one(grid, "Topology").get("NumberOfElements", -1))
    _require(triangles.shape == (number, 3), "the number of triangles is another")
    _require(triangles.min() >= 0 and triangles.max() < len(points), "a triangle has no point")
    frame = {"time": np.float64(_one(grid, "Time").get("Value"))}
    frame |= {"points": points, "triangles": triangles}
    for attribute in grid.findall("Attribute"):
        name = str(attribute.get("Name"))
        values = _data(path, attribute)
        _require(name not in frame, f"{name} comes twice")
        _require(attribute.get("Center") == "Node", f"{name} is not at the points")
        _require(len(values) == len(points), f"{name} has not one value a point")
        _require(values.ndim == SHAPES[str(attribute.get("AttributeType"))], f"{name}: wrong type")
        frame[name] = values
    return frame


def _data(path: Path, parent: ET.Element) -> np.ndarray:
    item = _one(parent, "DataItem")
    _require(item.get("Format") == "HDF" and item.get("Reference") is None, "not plain HDF data")
    file, where = str(item.text).strip().split(":")
    with h5py.File(path.parent / file, "r") as data:
        _require(where in data, f"{where} is not in {file}")
        values = np.asarray(data[where])
    said = tuple(int(n) for n in str(item.get("Dimensions")).split())
    _require(values.shape == said, f"{where} has shape {values.shape}, said {said}")
    _require(values.dtype.kind == KINDS[str(item.get("NumberType"))], f"{where}: other numbers")
    _require(str(values.dtype.itemsize) == item.get("Precision"), f"{where}: other precision")
    _require(bool(np.isfinite(values).all()), f"{where} is not finite")
    return values


def _one(parent: ET.Element, tag: str) -> ET.Element:
    found = parent.findall(tag)
    _require(len(found) == 1, f"{len(found)} elements {tag} in a {parent.tag}")
    return found[0]


def _require(holds: bool, otherwise: str) -> None:
    if not holds:
        raise BrokenFileError(otherwise)
