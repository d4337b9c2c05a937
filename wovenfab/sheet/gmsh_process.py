"""Runs gmsh in a process of its own, with a limit of time and memory.

What a geometry does to that process, such as a crash or a loop without an end, becomes a message.
This is no sandbox: a ``.geo`` is a program, and does what its user may do.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from wovenfab.parallel import child_environment, ending_with_parent
from wovenfab.sheet.errors import GeometryError
from wovenfab.sheet.file_mesh import FileMesh, Group

#: Time after which gmsh is ended, s: enough for some millions of triangles.
LIMIT = 120.0
#: Share of the machine's memory that gmsh may use.
MEMORY = 0.5
#: Cells of a mesh at most, by the area of what encloses the sheet.
MOST_CELLS = 1e7


@dataclass(frozen=True)
class Request:
    """What gmsh is to mesh.

    Attributes:
        path: A .geo or .step file.
        unit: Length of its unit, m, for messages.
        parameters: Values of constants that it defines by DefineConstant, in its units.
        mesh_size: Largest cell size in its unit; None keeps what the file says.
        follow: Whether curves are divided finely enough for their shape, whatever the size.
        coarse: Whether the cell size is compared with the size of the sheet alone.
        cells: Cells at most.
        memory: Bytes at most.
    """

    path: str
    unit: float = 1.0
    parameters: Mapping[str, float] = field(default_factory=dict)
    mesh_size: float | None = None
    follow: bool = False
    coarse: bool = False
    cells: float = MOST_CELLS
    memory: int = int(MEMORY * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))


def meshed(request: Request, seconds: float = LIMIT) -> FileMesh:
    """Return what gmsh makes of a geometry.

    Args:
        request: What it is to do.
        seconds: Time that it has.

    Raises:
        GeometryError: It cannot mesh the file, dies, or needs more time.
    """
    with TemporaryDirectory(prefix="wovenfab-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        (folder / "request.json").write_text(json.dumps(asdict(request)))
        _run(folder, request, seconds)
        with np.load(folder / "mesh.npz", allow_pickle=False) as found:
            head = json.loads(str(found["head"]))
            if "problem" in head:
                raise GeometryError(head["problem"], head["key"])
            cells = {
                dim: {int(n): found[f"{dim} {n}"] for n in numbers}
                for dim, numbers in head["entities"].items()
            }
            groups: dict[int, list[Group]] = {1: [], 2: []}
            for dim, title, members, missing, place in head["groups"]:
                groups[dim].append(Group(title, tuple(members), tuple(missing), place))
            return FileMesh(
                found["points"],
                cells["1"],
                cells["2"],
                tuple(groups[1]),
                tuple(groups[2]),
                head["other_cells"],
                head["recombining"],
                head["boolean"],
            )


def _run(folder: Path, request: Request, seconds: float) -> None:
    """Let another process write the mesh; nothing of it goes on afterwards."""
    command = [sys.executable, "-P", "-m", "wovenfab.sheet.gmsh_program", str(folder)]
    with (folder / "said").open("wb") as said:
        process = subprocess.Popen(
            ending_with_parent(command),
            env=child_environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=said,
            start_new_session=True,
        )
        try:
            code = process.wait(seconds)
        except subprocess.TimeoutExpired as error:
            raise GeometryError(
                f"gmsh was ended after {seconds:g} s: the geometry has a loop without an end, or "
                "gets too many cells; if it needs that long, mesh it yourself (gmsh -2) and name "
                "the .msh"
            ) from error
        finally:  # also what a geometry has started
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    if code == 0 and (folder / "mesh.npz").is_file():
        return
    words = (folder / "said").read_text(errors="replace").strip().splitlines()
    last = words[-1][:300] if words else "without a word"
    if "bad_alloc" in last or "MemoryError" in last:
        most = f"more than {request.memory / 1e9:.1f} GB of memory"
        raise GeometryError(f"gmsh needs {most}: the geometry gets too many cells")
    if code == 0:
        raise GeometryError("the geometry ended gmsh before there was a mesh; remove 'Exit'")
    how = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
    raise GeometryError(f"gmsh ended {how} ({last}); the geometry may be damaged")
