"""Opens fields.xdmf and yarns.xdmf in each XDMF reader of ParaView: ``pvpython check.py DIR``.

Each reader runs in a process of its own, because one that dislikes a file may crash. For
every time the fields must lie together on one block with the ranges of the HDF5 file; the
sheet is then warped by one field, coloured by another and drawn. The script that shows a run
in one step is started, too. Yarns and script are there after ``wovenfab report DIR``.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

SERIES = ("fields", "yarns")
SCRIPT = "open_in_paraview.py"
READERS = {  # name in ParaView's dialogue: name in its Python
    "XDMF Reader": ("XDMFReader", "FileNames"),
    "Xdmf3 Reader T": ("Xdmf3ReaderT", "FileName"),
    "Xdmf3 Reader S": ("Xdmf3ReaderS", "FileName"),
}


def main(directory: Path) -> int:
    """Try all readers and the script, say what came of each, and return the exit code."""
    good = True
    with tempfile.TemporaryDirectory() as folder, display() as screen:
        for series in SERIES:
            if series == "yarns" and not (directory / "yarns.h5").exists():
                print("no yarns.h5: wovenfab report writes it")
                continue
            expected = read_expected(directory / f"{series}.h5")
            held = ", ".join(expected["fields"])
            print(f"{directory}: {series} at {len(expected['times'])} times: {held}")
            (Path(folder) / "expected.json").write_text(json.dumps(expected))
            for name in READERS:
                path = str(directory / f"{series}.xdmf")
                good &= tried(name, [__file__, path, name, folder], screen)
        script, picture = directory / SCRIPT, Path(folder) / "shown.png"
        if script.exists():
            good &= tried(SCRIPT, [str(script), str(picture)], screen, words="")
            good &= tried("its picture", [__file__, str(picture)], screen)
    return 0 if good else 1


def tried(name: str, command: list[str], screen: str, words: str = "all as expected") -> bool:
    """Run ParaView's Python, print how it ended, and return whether it ended well."""
    ended = subprocess.run(
        ["pvpython", *command],
        env=os.environ | {"DISPLAY": screen},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    good = ended.returncode == 0 and ended.stdout.rstrip().endswith(words)
    print(f"{'ok    ' if good else 'FAILED'} {name}: {last_words(ended)}", flush=True)
    return good


@contextmanager
def display() -> Iterator[str]:
    """Run an X server, which Debian's ParaView needs to draw, and give its name.

    Not ``xvfb-run``: two of them may take the same number, and their server starts anew
    when ParaView's first connection ends, in which instant a second one is refused.
    """
    reading, writing = os.pipe()
    command = ["Xvfb", "-displayfd", str(writing), "-noreset", "-screen", "0", "1280x1024x24"]
    with subprocess.Popen(command, pass_fds=[writing], stderr=subprocess.DEVNULL) as server:
        os.close(writing)
        with os.fdopen(reading) as answer:
            number = answer.readline().strip()
        require(bool(number), "Xvfb did not start")
        try:
            yield f":{number}"
        finally:
            server.terminate()


def last_words(ended: subprocess.CompletedProcess[str]) -> str:
    """Return the one line that says how the reader ended."""
    lines = (ended.stdout if ended.returncode == 0 else ended.stderr).strip().splitlines()
    if ended.returncode in (0, 1):
        return lines[-1] if lines else "no word"
    errors = [line for line in lines if "ERR|" in line]  # a stack of the crash follows
    return f"crashed (code {ended.returncode}) {' '.join(errors[:1])}"


def read_expected(path: Path) -> dict[str, Any]:
    """Return times, sizes and the range of each component of each field at each time."""
    import h5py  # not beside ParaView, which brings an HDF5 of its own

    with h5py.File(path, "r") as file:
        steps = sorted(file["steps"].values(), key=lambda step: step.attrs["time"])
        return {
            "times": [float(step.attrs["time"]) for step in steps],
            "points": len(file["mesh/points"]),
            "cells": count_cells(file["mesh"]),
            "reference": ranges(file["mesh/points"][()]),
            "fields": sorted(set(steps[0]) - {"points"}),
            "ranges": [{name: ranges(step[name][()]) for name in step} for step in steps],
        }


def count_cells(mesh: Any) -> int:
    """Return the number of triangles, or of polylines: each is 2, its size, its points."""
    if "triangles" in mesh:
        return len(mesh["triangles"])
    lines, at, count = mesh["lines"][()], 0, 0
    while at < len(lines):
        at, count = at + 2 + lines[at + 1], count + 1
    return count


def ranges(values: np.ndarray) -> list[list[float]]:
    """Return smallest and largest value of each component."""
    columns = values.reshape(len(values), -1)
    return [[float(c.min()), float(c.max())] for c in columns.T]


def try_reader(path: str, name: str, folder: Path) -> None:
    """Open the file in one reader and compare everything; raises at the first difference."""
    from paraview import simple

    expected = json.loads((folder / "expected.json").read_text())
    kind, argument = READERS[name]
    reader = getattr(simple, kind)(**{argument: [path]})
    reader.UpdatePipelineInformation()
    times = np.atleast_1d(reader.TimestepValues)  # a bare number where there is one only
    same = len(times) == len(expected["times"]) and np.allclose(times, expected["times"])
    require(same, f"times {times.tolist()}")
    for time, wanted in zip(expected["times"], expected["ranges"], strict=True):
        compare(only_block(reader, time), expected, wanted)
    if any(name.startswith("displacement") for name in expected["fields"]):
        warp_and_colour(simple, reader, expected, str(folder / "picture.png"))
    print(f"{len(times)} times, {len(expected['fields'])} fields on one block; all as expected")


def compare(block: Any, expected: dict[str, Any], wanted: dict[str, Any]) -> None:
    """Require that one block has the mesh and all fields, with the ranges of the file."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    require(block.GetNumberOfPoints() == expected["points"], "another number of points")
    require(block.GetNumberOfCells() == expected["cells"], "another number of cells")
    if "points" in wanted:  # they move
        require(ranges(vtk_to_numpy(block.GetPoints().GetData())) == wanted["points"], "moved")
    for name in expected["fields"]:
        array = block.GetPointData().GetArray(name)
        require(array is not None, f"{name} is not on the block of the others")
        found = ranges(vtk_to_numpy(array))
        require(found == wanted[name], f"{name} has ranges {found}, not {wanted[name]}")


def warp_and_colour(simple: Any, reader: Any, expected: dict[str, Any], picture: str) -> None:
    """Warp by a displacement and colour by a scalar where it is largest, and look at both."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    vector = next(name for name in expected["fields"] if name.startswith("displacement"))
    index = int(np.argmax([np.abs(r[vector]).max() for r in expected["ranges"]]))
    time, wanted = expected["times"][index], expected["ranges"][index]
    scalar = max(
        (name for name in wanted if len(wanted[name]) == 1), key=lambda n: spread(wanted[n])
    )
    warp = simple.WarpByVector(Input=reader, Vectors=["POINTS", vector])
    block = only_block(warp, time)
    rest = vtk_to_numpy(only_block(reader, time).GetPoints().GetData())
    moved = vtk_to_numpy(block.GetPoints().GetData())
    shift = vtk_to_numpy(block.GetPointData().GetArray(vector))
    require(np.allclose(moved - rest, shift, atol=1e-6), "the warp is not the displacement")
    require(bool(np.abs(shift).max() > 0), "the sheet never moves: take another run")
    require(ranges(rest) == expected["reference"], "the mesh is another")
    view = simple.CreateView("RenderView")
    view.ViewTime = time
    view.ViewSize = [600, 300]
    display = simple.Show(warp, view)
    simple.ColorBy(display, ("POINTS", scalar))
    display.RescaleTransferFunctionToDataRange(True)
    simple.ResetCamera(view)
    simple.SaveScreenshot(picture, view)
    require(colours(picture) > 20, f"the picture coloured by {scalar} is blank")


def spread(components: list[list[float]]) -> float:
    """Return how much a scalar varies, against its size."""
    low, high = components[0]
    return (high - low) / max(abs(low), abs(high), 1e-300)


def only_block(source: Any, time: float) -> Any:
    """Return the data of a pipeline at a time, which must be one block."""
    from paraview import servermanager

    source.UpdatePipeline(time)
    blocks = list(leaves(servermanager.Fetch(source)))
    require(len(blocks) == 1, f"{len(blocks)} blocks at {time} s")
    return blocks[0]


def leaves(data: Any) -> Any:
    """Yield the blocks of a data set that have points."""
    if data is None:
        return
    if data.IsA("vtkMultiBlockDataSet") or data.IsA("vtkPartitionedDataSet"):
        count = data.GetNumberOfBlocks() if hasattr(data, "GetNumberOfBlocks") else 0
        for i in range(count or data.GetNumberOfPartitions()):
            yield from leaves(data.GetBlock(i) if count else data.GetPartition(i))
    elif data.GetNumberOfPoints():
        yield data


def colours(picture: str) -> int:
    """Return how many colours a picture has."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOImage import vtkPNGReader

    reader = vtkPNGReader()
    reader.SetFileName(picture)
    reader.Update()
    pixels = vtk_to_numpy(reader.GetOutput().GetPointData().GetScalars())
    return len(np.unique(pixels, axis=0))


def require(holds: bool, otherwise: str) -> None:
    """Raise with a reason unless a condition holds."""
    if not holds:
        raise SystemExit(otherwise)


if __name__ == "__main__":
    if len(sys.argv) == 2 and sys.argv[1].endswith(".png"):
        require(colours(sys.argv[1]) > 20, "the picture is blank")
        print("all as expected")
        sys.exit()
    if len(sys.argv) == 2:
        sys.exit(main(Path(sys.argv[1])))
    try_reader(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
