"""HDF5 files that are complete after every step: series of fields with XDMF, and checkpoints.

The last two checkpoints are kept. Their arrays have one row a cell of the mesh, in an order that
does not depend on the ranks, so that another number of ranks can go on.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from os import SEEK_END
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import h5py
import numpy as np
from numpy.typing import NDArray

from wovenfab.record.reading import UnreadableResultsError, damaged
from wovenfab.record.results import (
    CHECKPOINT,
    EARLIER_CHECKPOINT,
    NothingToResumeError,
    is_link,
    write_whole,
)

#: Names, without suffix, of the files with the fields of a run, its modes and its errors.
FIELDS, MODE, ERROR = "fields", "mode", "error"
DATA = f"{FIELDS}.h5"
#: Name of the file with the mesh, in the folder of a series.
MESH = "mesh.h5"
#: Number of times up to which the file that joins them is written at each, and the share by which
#: it may then be behind.
JOINED_EACH, BEHIND = 64, 1 / 8
#: What h5py raises for damaged files, and how far deflate can shrink data.
_HDF5_ERRORS = (OSError, LookupError, ValueError, TypeError, RuntimeError, MemoryError)
_DEFLATED = 1100
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
    """Cells and fields on their points over time.

    Each time is a file of its own in a folder, written whole: neither a killed run nor a full
    disk can damage the times before. ``name.h5`` joins them by links, as groups of ``/steps``, and
    lists them as ``/numbers`` and ``/times``. It is written anew after a growing number of times,
    so that what is written in all grows with the number of times; ``finish`` brings it up to date.
    """

    def __init__(
        self,
        directory: Path,
        name: str,
        cells: Cells,
        points: NDArray[np.float64],
        units: Mapping[str, str],
        moving: bool = False,
        until: int = -1,
    ) -> None:
        """Write the mesh, or go on with an earlier series.

        Args:
            directory: The results directory.
            name: Name of the two files, without suffix, and of the folder.
            cells: How the points are joined.
            points: Points at rest (m), shape (n, 2).
            units: Name and SI unit of each field.
            moving: Whether each time has points of its own, as the field ``points``; if not,
                all share ``/mesh/points``.
            until: Last step of an earlier series that is kept; negative for none.
        """
        self._data, self._text = directory / f"{name}.h5", directory / f"{name}.xdmf"
        self._cells, self._count, self._moving = cells, len(points), moving
        self._units, self._folder = dict(units), directory / name
        self._vectors: dict[str, bool] = {}
        self._steps: list[int] = []
        self._times: list[float] = []  # s
        self._joined = 0
        earlier = kept_times(self._folder, until)

        def fill(file: h5py.File) -> None:
            mesh = file.create_group("mesh")
            mesh.create_dataset("points", data=_padded(points), **_PACK).attrs["unit"] = "m"
            mesh.create_dataset(cells.name, data=cells.connectivity, **_PACK)

        if self._folder.is_symlink():
            raise UnreadableResultsError(is_link(self._folder))
        self._folder.mkdir(exist_ok=True)
        write_whole(self._folder / MESH, hdf5_image(fill))
        for path in _files_in(self._folder):
            if int(path.stem) > until:
                path.unlink()
        for one in earlier:
            self._add(*one)
        self._join()

    def add(self, step: int, time: float, fields: Mapping[str, NDArray[np.float64]]) -> None:
        """Write one time (s): first the data, then the XDMF that refers to them.

        Every field is given on the points, shape (n,) or (n, 2); moving points among them.

        Raises:
            ValueError: The time does not increase, or a field changed its shape.
            OSError: The files cannot be written.
        """
        if self._times and time <= self._times[-1]:
            raise ValueError(f"time {time} s comes after {self._times[-1]} s in the fields")
        vectors = {name: values.ndim == 2 for name, values in fields.items()}
        same = not self._times or vectors == self._vectors
        if not same or any(len(values) != self._count for values in fields.values()):
            raise ValueError(f"the fields of step {step} do not have the shapes of the series")

        def fill(file: h5py.File) -> None:
            for name, values in fields.items():
                data = _padded(values) if vectors[name] else values
                file.create_dataset(name, data=data, **_PACK).attrs["unit"] = self._units[name]
            file.attrs.update(step=step, time=time)

        write_whole(self._folder / file_of(step), hdf5_image(fill))
        self._add(step, time, vectors)
        if len(self._times) <= JOINED_EACH or len(self._times) > (1 + BEHIND) * self._joined:
            self._join()

    def finish(self) -> None:
        """Let the file that joins all times have the last ones, too."""
        if self._joined < len(self._times):
            self._join()

    def _add(self, step: int, time: float, vectors: dict[str, bool]) -> None:
        self._append(self._frame(time, step, vectors))
        self._steps.append(step)
        self._times.append(time)
        self._vectors = vectors

    def _join(self) -> None:
        """Write the file that has the mesh, and all times as links.

        It lists the times, so that a reader need not open all files at once.
        """

        def fill(file: h5py.File) -> None:
            folder = self._folder.name
            file["mesh"] = h5py.ExternalLink(f"{folder}/{MESH}", "/mesh")
            file["numbers"] = np.array(self._steps, dtype=np.int64)
            file.create_dataset("times", data=np.array(self._times)).attrs["unit"] = "s"
            steps = file.create_group("steps")
            for step in self._steps:
                steps[f"{step:06d}"] = h5py.ExternalLink(f"{folder}/{file_of(step)}", "/")

        write_whole(self._data, hdf5_image(fill))
        self._joined = len(self._times)

    def _frame(self, time: float, step: int, vectors: Mapping[str, bool]) -> str:
        """Return the XDMF text of one time.

        Each frame has topology, geometry and all attributes itself, without references:
        ParaView's first reader crashes on the form with ``xi:include``, and the other two
        split the fields over blocks when each has a collection of its own. ``vectors`` says
        of each field of the step whether it has three components.
        """
        data = file_of(step)
        grid = ET.Element("Grid", Name="sheet", GridType="Uniform")
        ET.SubElement(grid, "Time", Value=repr(time))
        cells = {"TopologyType": self._cells.kind, "NumberOfElements": str(self._cells.count)}
        topology = ET.SubElement(grid, "Topology", cells)
        self._item(
            topology, f"{MESH}:/mesh/{self._cells.name}", self._cells.connectivity.shape, "Int"
        )
        geometry = ET.SubElement(grid, "Geometry", GeometryType="XYZ")
        place = f"{data}:" if self._moving else f"{MESH}:/mesh"
        self._item(geometry, f"{place}/points", (self._count, 3))
        for name in (name for name in vectors if name != "points"):
            kind = "Vector" if vectors[name] else "Scalar"
            shape = (self._count, 3) if vectors[name] else (self._count,)
            about = {"Name": name, "AttributeType": kind, "Center": "Node"}
            self._item(ET.SubElement(grid, "Attribute", about), f"{data}:/{name}", shape)
        ET.indent(grid, level=_LEVEL)
        return 2 * _LEVEL * " " + ET.tostring(grid, encoding="unicode") + "\n"

    def _item(
        self, parent: ET.Element, where: str, shape: tuple[int, ...], kind: str = "Float"
    ) -> None:
        size = " ".join(map(str, shape))
        item = ET.SubElement(
            parent, "DataItem", Dimensions=size, NumberType=kind, Precision="8", Format="HDF"
        )
        item.text = f"{self._folder.name}/{where}"

    def _append(self, frame: str) -> None:
        """Add a frame at the end of the XDMF, without rewriting the thousands before it."""
        if not self._times:
            write_whole(self._text, _HEAD + frame + _TAIL)
            return
        with self._text.open("r+b", buffering=0) as file:  # one write: readers find it whole
            end = file.seek(-len(_TAIL.encode()), SEEK_END)
            try:
                file.write((frame + _TAIL).encode())
            except OSError:  # as of a full disk
                file.seek(end)
                file.write(_TAIL.encode())
                file.truncate()
                raise


def hdf5_image(fill: Callable[[h5py.File], None]) -> bytes:
    """Return the content of an HDF5 file, made in memory: HDF5 itself never writes to a disk.

    Args:
        fill: Fills the open file.
    """
    with h5py.File("image", "w", driver="core", backing_store=False) as file:
        fill(file)
        file.flush()
        image: bytes = file.id.get_file_image()
        return image


def _files_in(folder: Path) -> list[Path]:
    """Return the files of the times of a series, ascending; none if there is no folder."""
    return sorted((p for p in folder.glob("*.h5") if p.stem.isdecimal()), key=lambda p: int(p.stem))


def times_after(folder: Path, last: int) -> list[tuple[int, float]]:
    """Return number and time (s) of the steps of a series after one.

    Raises:
        UnreadableResultsError: A file is damaged.
    """
    files = [path for path in _files_in(folder) if int(path.stem) > last]
    return [(int(path.stem), _contents(path)[0]) for path in files]


def kept_times(folder: Path, until: int) -> list[tuple[int, float, dict[str, bool]]]:
    """Return the steps of an earlier series up to one: number, time (s), which fields are vectors.

    Raises:
        NothingToResumeError: A file of theirs is damaged.
    """
    files = [path for path in _files_in(folder) if int(path.stem) <= until]
    try:
        return [(int(path.stem), *_contents(path)) for path in files]
    except UnreadableResultsError as error:
        raise NothingToResumeError(f"the run cannot go on: {error}") from None


def _contents(path: Path) -> tuple[float, dict[str, bool]]:
    """Return the time (s) of a file, and which of its fields are vectors."""
    with opened(path) as file:
        time = float(file.attrs["time"])
        return time, {name: data.ndim == 2 for name, data in file.items()}


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """Open an HDF5 file for reading.

    Raises:
        UnreadableResultsError: It is missing or damaged, or lacks what is asked of it inside.
    """
    if not path.exists():
        raise damaged(path, "the file is missing")
    if not path.is_file():
        raise damaged(path, "this is no ordinary file")
    try:
        with h5py.File(path, "r", **UNLOCKED) as file:
            yield file
    except UnreadableResultsError:
        raise
    except (*_HDF5_ERRORS, AttributeError) as error:
        reason = " ".join(str(error).split())
        raise damaged(path, f"this is no such HDF5 file ({reason})") from None


def values_of(file: h5py.File, name: str) -> NDArray[Any]:
    """Return the numbers of a data set, all finite.

    Raises:
        UnreadableResultsError: There are no such numbers.
    """
    data = file[name]
    path = Path(file.filename)
    if not isinstance(data, h5py.Dataset) or data.dtype.kind not in "iuf":
        raise damaged(path, f"{name} has no numbers")
    # HDF5 can take numbers from any file of the machine: an export would pass them on
    here = Path(data.file.filename).resolve().is_relative_to(path.resolve().parent)
    if not here or data.external or data.is_virtual:
        raise damaged(path, f"{name} is in a file elsewhere")
    # a damaged head may claim any size: deflate shrinks a thousandfold at most
    if data.nbytes > _DEFLATED * data.id.get_storage_size() + _DEFLATED:
        raise damaged(path, f"{name} is not whole")
    values: NDArray[Any] = data[()]
    if not np.isfinite(values).all():
        raise damaged(path, f"{name} has values that are not finite")
    return values


def file_of(step: int) -> str:
    """Return the name of the file of a step, in the folder of a series."""
    return f"{step:06d}.h5"


def _padded(planar: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return planar vectors with a third component of zero, shape (n, 3)."""
    return np.column_stack([planar, np.zeros(len(planar))])


#: Array of the program so far: times (s), values (m or N), whether they are forces, and values of
#: the second program (m); shape (4, n).
PROGRAM = "program"
#: Version of what checkpoints hold; another one cannot be read.
VERSION = 8


@dataclass(frozen=True)
class Checkpoint:
    """The state of a run after a step.

    Attributes:
        step: Number of the step.
        time: s.
        values: Plain values, which stand for arrays by their names.
        arrays: Rows of all cells by name, on rank 0 alone; and the program so far.
    """

    step: int
    time: float
    values: Mapping[str, Any]
    arrays: Mapping[str, NDArray[np.float64]] = field(repr=False)


def write_checkpoint(directory: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint; the last one stays as the one before. On one rank.

    Raises:
        OSError: It cannot be written; the earlier ones are still there.
    """
    state = json.dumps(
        {"step": checkpoint.step, "time": checkpoint.time, "values": checkpoint.values}
    )

    def fill(file: h5py.File) -> None:
        for name, rows in checkpoint.arrays.items():
            file.create_dataset(name, data=rows)
        file.attrs["version"] = VERSION
        file.attrs["digest"] = _digest(state, checkpoint.arrays)
        file["state"] = state

    new, last = directory / f"{CHECKPOINT}.new", directory / CHECKPOINT
    write_whole(new, hdf5_image(fill))
    if last.exists():
        last.replace(directory / EARLIER_CHECKPOINT)
    new.replace(last)


def _digest(state: str, arrays: Mapping[str, NDArray[np.float64]]) -> str:
    """Return a digest of what a checkpoint holds."""
    made = hashlib.sha256(state.encode())
    for name in sorted(arrays):
        rows = np.ascontiguousarray(arrays[name])
        made.update(f"{name} {rows.dtype} {rows.shape}".encode())
        made.update(rows.data)
    return made.hexdigest()


#: What a run keeps of itself beside its state.
_RUN = {"parts", "outcome", "losses", "errors"}


def _checkpoint(state: str, arrays: Mapping[str, NDArray[np.float64]]) -> Checkpoint | None:
    """Return the checkpoint with a state as it is stored; None if it lacks something."""
    try:
        checkpoint = Checkpoint(**json.loads(state), arrays=arrays)
        program = arrays[PROGRAM]
        run = checkpoint.values.get("run", _RUN)  # the states of studies have none
        plain = isinstance(checkpoint.step, int) and isinstance(checkpoint.time, float | int)
        parts = "stepper" in checkpoint.values and {*run} >= _RUN
        return checkpoint if plain and parts and len(program) == 4 else None
    except (TypeError, LookupError, ValueError, AttributeError, RecursionError):
        return None


def newest_checkpoint(directory: Path) -> Checkpoint:
    """Return the newest whole checkpoint of a results directory; on one rank.

    Raises:
        NothingToResumeError: There is none, or another version wrote it.
    """
    there = False
    for name in (f"{CHECKPOINT}.new", CHECKPOINT, EARLIER_CHECKPOINT):
        if not (directory / name).exists():
            continue
        there = True
        try:
            with opened(directory / name) as file:
                version = int(file.attrs["version"])
                if version != VERSION:
                    raise NothingToResumeError(
                        f"{directory / name} was written by another version of wovenfab (state "
                        f"{version}, here {VERSION}); go on with that version, or begin anew with "
                        "--overwrite"
                    )
                text = file["state"][()].decode("utf-8")
                arrays = {n: values_of(file, n) for n in file if n != "state"}
                # those of a version before have no digest
                if file.attrs.get("digest") not in (None, _digest(text, arrays)):
                    raise damaged(directory / name, "its contents are not those written")
        except UnreadableResultsError:  # the one before may be whole
            continue
        if (checkpoint := _checkpoint(text, arrays)) is not None:
            return checkpoint
    why = "does not exist" if not directory.is_dir() else "holds no checkpoint"
    if there:
        why = "holds no whole checkpoint: what there is, is damaged"
    raise NothingToResumeError(
        f"there is nothing to go on from: {directory} {why}; run the case from its beginning"
    )
