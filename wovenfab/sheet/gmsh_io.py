"""Sessions of gmsh, what the text of a geometry may do, and unstructured rectangles."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from dolfinx.mesh import Mesh, MeshTags
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.lacking import load
from wovenfab.sheet.sheet import GeometryError, name_facets, rectangle_outline, triangle_mesh

Array = NDArray[np.float64]
Cells = NDArray[np.int64]

#: Statements that run a program; refused wherever the word stands, in comments, too.
PROGRAMS = re.compile(r"\b(SystemCall|NonBlockingSystemCall|OnelabRun)\b")
#: Statements that end gmsh, wait or write files; refused outside comments and strings.
ACTIONS = re.compile(r"\b(Exit|Abort|Sleep|Print|Save|CreateDir|Plugin|Draw)\b|>>?(?=\s*\")")
#: Statements that read another file, and the only way in which they may name it.
READING = re.compile(r"\b(?:Include|Merge|MergeWithBoundingBox|ShapeFromFile)\b")
NAMED = re.compile(READING.pattern + r"\s*\(?\s*\"([^\"\n]*)\"")
#: Comments, whose content does nothing, and strings.
COMMENTS = re.compile(r"//[^\n]*|/\*.*?\*/|\"[^\"\n]*\"", re.DOTALL)


def with_gmsh[T](build: Callable[[Any], T], what: str) -> T:
    """Return what ``build`` makes of gmsh, which is started and ended around it.

    Args:
        build: Gets the module.
        what: Name of the geometry for messages.

    Raises:
        GeometryError: gmsh fails.
        LackingError: gmsh, or a library that it needs, is missing.
    """
    gmsh = load("gmsh", "gmsh", "a mesh that does not follow the fibres of a rectangle")
    failed = False
    _start(gmsh)
    try:
        return build(gmsh)
    except Exception as error:
        if type(error) is not Exception:  # that of gmsh
            raise
        failed = True
        why = str(error).replace(f"'{what}', ", "")  # gmsh names the file again
        raise GeometryError(f"gmsh cannot mesh {what}: {why}") from error
    finally:
        gmsh.finalize()
        if failed:
            _empty_parser(gmsh)


def _start(gmsh: Any) -> None:
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)


def _empty_parser(gmsh: Any) -> None:
    """Let gmsh read what a syntax error left in its parser, which outlives the model."""
    _start(gmsh)
    with TemporaryDirectory() as folder:
        blank = Path(folder) / "blank.geo"
        blank.write_text("blank = 1;\n")
        for _ in range(100):  # one statement each
            with suppress(Exception):
                gmsh.open(str(blank))
                break
    gmsh.finalize()


def code_of(path: Path) -> str:
    """Return the text of a geometry, and of those that it reads, without comments."""
    if path.suffix.lower() != ".geo" or not path.is_file():
        return ""
    text = path.read_text(encoding="latin-1")
    parts = [path.parent / name for name in NAMED.findall(text)]
    bare = COMMENTS.sub(lambda m: m.group() if m.group()[0] == '"' else _blank(m.group()), text)
    return "\n".join([bare, *(code_of(part) for part in parts if part != path)])


def line_of(path: Path, statement: re.Pattern[str]) -> str:
    """Return in words the line where a statement stands, or nothing."""
    found = statement.search(code := code_of(path))
    return f"in line {code.count(chr(10), 0, found.start()) + 1}" if found else ""


def options_of(path: Path) -> Path:
    """Return the file of options that gmsh reads with a geometry, if it exists."""
    return path.with_name(f"{path.name}.opt")


def require_harmless(path: Path, seen: tuple[Path, ...] = ()) -> None:
    """Refuse a file, or one that it reads, with statements that do more than describe a sheet.

    gmsh runs programs for a geometry, for a mesh file that is none, and for the options that
    stand beside either in a file of the same name and ``.opt``. A file that begins as a mesh has
    no statements.

    Raises:
        GeometryError: With the line and the statement.
    """
    if path in seen or not path.is_file():
        return  # gmsh says that it is missing
    text = "" if _begins_as_mesh(path) else path.read_text(encoding="latin-1")
    bare = COMMENTS.sub(lambda m: _blank(m.group()), text)
    found = PROGRAMS.search(text) or ACTIONS.search(bare)
    if not found and len(READING.findall(bare)) > len(NAMED.findall(text)):
        found = READING.search(bare)
    if found:
        line = text.count("\n", 0, found.start()) + 1
        raise GeometryError(
            f"{path}, line {line}: {found.group().strip()} is not allowed: a geometry may not run "
            "programs, end gmsh, write files, or read others but by a name in quotes; remove it"
        )
    others = [path.parent / name for name in NAMED.findall(text)]
    for other in (*others, options_of(path)):
        require_harmless(other, (*seen, path))


def _begins_as_mesh(path: Path) -> bool:
    with path.open("rb") as lines:
        return lines.readline(80).strip() == b"$MeshFormat"


def stated_points(path: Path) -> int:
    """Return how many points a mesh in text says it has, or 0 if its head does not tell."""
    if not (path.is_file() and _begins_as_mesh(path)):
        return 0
    with path.open(encoding="latin-1") as lines:
        for line in lines:
            if line.strip() == "$Nodes":
                numbers = next(lines, "").split()[:2]  # blocks, points; one number in version 2
                return int(numbers[-1]) if numbers and numbers[-1].isdecimal() else 0
    return 0


def _blank(text: str) -> str:
    """Return a comment or string without its content, as long as it was."""
    if text[0] == '"':
        return '"' + " " * (len(text) - 2) + '"'
    return re.sub(r"[^\n]", " ", text)


def nodes_of(gmsh: Any) -> tuple[Array, Cells]:
    """Return the positions of all nodes, shape (n, 3), and the row of each tag."""
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    rows = np.zeros(int(tags.max(initial=0)) + 1, dtype=np.int64)
    rows[tags.astype(np.int64)] = np.arange(len(tags))
    return coordinates.reshape(-1, 3), rows


def cells_of(gmsh: Any, dim: int, entity: int, rows: Cells) -> Cells:
    """Return the rows of the corners of the lines or triangles of an entity, shape (n, dim + 1)."""
    found = [np.zeros((0, dim + 1), dtype=np.int64)]
    kinds, _, nodes = gmsh.model.mesh.getElements(dim, entity)
    for kind, tags in zip(kinds, nodes, strict=True):
        count = gmsh.model.mesh.getElementProperties(kind)[3]
        found.append(rows[tags.astype(np.int64).reshape(-1, count)[:, : dim + 1]])
    return np.concatenate(found)


def graded_rectangle(
    comm: MPI.Comm, length: float, width: float, mesh_size: float, corner_size: float | None
) -> tuple[Mesh, MeshTags, dict[str, int]]:
    """Return an unstructured rectangle, optionally refined towards its corners; collective.

    It is meshed as a rectangle of unit size and scaled: gmsh has tolerances of its own,
    so that a sheet of another size would get another mesh.

    Args:
        comm: Communicator.
        length: Extent in x, m.
        width: Extent in y, m.
        mesh_size: Cell size away from the corners, m.
        corner_size: Cell size at the corners, m; None for a uniform mesh.
    """
    unit = max(length, width)
    largest, smallest = mesh_size / unit, (corner_size or mesh_size) / unit

    def build(gmsh: Any) -> tuple[Array, Cells]:
        geo = gmsh.model.geo
        wide, high = length / unit, width / unit
        corners = [(0, 0), (wide, 0), (wide, high), (0, high)]
        points = [geo.addPoint(x, y, 0, smallest) for x, y in corners]
        lines = [geo.addLine(points[i], points[(i + 1) % 4]) for i in range(4)]
        geo.addPlaneSurface([geo.addCurveLoop(lines)])
        geo.synchronize()
        if corner_size is not None:
            _refine_at(gmsh, points, smallest, largest, min(wide, high) / 2)
        gmsh.option.setNumber("Mesh.MeshSizeMax", largest)
        gmsh.model.mesh.generate(2)
        places, rows = nodes_of(gmsh)
        return unit * places[:, :2], cells_of(gmsh, 2, -1, rows)

    mesh = triangle_mesh(comm, lambda: with_gmsh(build, "the rectangle"))
    return mesh, *name_facets(mesh, rectangle_outline(length, width))


def _refine_at(gmsh: Any, points: list[int], smallest: float, largest: float, reach: float) -> None:
    """Let the cell size grow linearly with the distance from the points."""
    field = gmsh.model.mesh.field
    distance = field.add("Distance")
    field.setNumbers(distance, "PointsList", points)
    threshold = field.add("Threshold")
    field.setNumber(threshold, "InField", distance)
    field.setNumber(threshold, "SizeMin", smallest)
    field.setNumber(threshold, "SizeMax", largest)
    field.setNumber(threshold, "DistMin", 0.0)
    field.setNumber(threshold, "DistMax", reach)
    field.setAsBackgroundMesh(threshold)
    for option in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
        gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)
