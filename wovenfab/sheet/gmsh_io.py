"""Meshes by gmsh: any .geo or .msh file with named edges, and graded rectangles."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from dolfinx.mesh import Mesh, MeshTags
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.compat import mesh_from_gmsh
from wovenfab.sheet.sheet import GeometryError, Outline, outline_of

#: Statements that run a program; refused wherever the word stands, in comments, too.
PROGRAMS = re.compile(r"\b(SystemCall|NonBlockingSystemCall|OnelabRun)\b")
#: Statements that end gmsh, wait or write files; refused outside comments and strings.
ACTIONS = re.compile(r"\b(Exit|Abort|Sleep|Print|Save|CreateDir|Plugin|Draw)\b|>>?(?=\s*\")")
#: Statements that read another file, and the only way in which they may name it.
READING = re.compile(r"\b(?:Include|Merge|MergeWithBoundingBox|ShapeFromFile)\b")
NAMED = re.compile(READING.pattern + r"\s*\(?\s*\"([^\"\n]*)\"")
#: Comments, whose content does nothing, and strings.
COMMENTS = re.compile(r"//[^\n]*|/\*.*?\*/|\"[^\"\n]*\"", re.DOTALL)
#: Cells of a mesh at most, by the area of what encloses the sheet.
MOST_CELLS = 1e7
#: Segments that a full circle of the outline is divided in, at least.
SEGMENTS = 48


def from_file(
    comm: MPI.Comm, path: Path, mesh_size: float | None
) -> tuple[Mesh, MeshTags, dict[str, int]]:
    """Return mesh, facet tags and tag numbers of a gmsh geometry or mesh.

    Args:
        comm: Communicator.
        path: A .geo file (meshed here) or a .msh file.
        mesh_size: Largest cell size, m; None keeps what the file says.

    Raises:
        GeometryError: On every rank, if gmsh cannot read the file or it lacks a
            physical surface or named physical curves.
    """

    def build(gmsh: Any) -> None:
        _read(gmsh, path, mesh_size)

    return _on_root(comm, build, str(path))


def outline_from_file(comm: MPI.Comm, path: Path, mesh_size: float | None) -> tuple[Outline, float]:
    """Return the outline of a gmsh geometry, and the size of cells it asks for (m); collective.

    Args:
        comm: Communicator.
        path: A .geo file.
        mesh_size: Largest cell size, m; None keeps what the file says.

    Raises:
        GeometryError: As from :func:`from_file`.
    """
    found: list[tuple[Outline, float]] = []

    def build(gmsh: Any) -> None:
        _read(gmsh, path, mesh_size, _follow_curves)
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        number = {int(tag): i for i, tag in enumerate(tags)}
        points = coordinates.reshape(-1, 3)[:, :2]
        triangles = _numbers(gmsh, 2, -1, number)
        named = {
            gmsh.model.getPhysicalName(1, group): np.concatenate(
                [
                    _numbers(gmsh, 1, int(curve), number)
                    for curve in gmsh.model.getEntitiesForPhysicalGroup(1, group)
                ]
            )
            for _, group in gmsh.model.getPhysicalGroups(1)
        }
        sides = points[triangles] - points[np.roll(triangles, 1, axis=1)]
        found.append(
            (outline_of(points, triangles, named), float(np.linalg.norm(sides, axis=2).max()))
        )

    outline, size = _rooted(
        comm, build, str(path), lambda _: comm.bcast(found[0] if found else None)
    )
    return outline, mesh_size or size


def _follow_curves(gmsh: Any) -> None:
    """Divide curves finely enough for their shape, whatever the size of the cells."""
    for _, curve in gmsh.model.getEntities(1):
        if gmsh.model.getType(1, curve) != "Line":
            (first,), (last,) = gmsh.model.getParametrizationBounds(1, curve)
            places = np.linspace(first, last, SEGMENTS + 1)
            slopes = gmsh.model.getDerivative(1, curve, places).reshape(-1, 3)
            angles = np.unwrap(np.arctan2(slopes[:, 1], slopes[:, 0]))
            turned = np.abs(np.diff(angles)).sum()
            parts = max(1, int(np.ceil(turned / (2 * np.pi) * SEGMENTS)))
            gmsh.model.mesh.setTransfiniteCurve(curve, parts + 1)


def _read(
    gmsh: Any,
    path: Path,
    mesh_size: float | None,
    prepare: Callable[[Any], None] = lambda gmsh: None,
) -> None:
    """Open a geometry or mesh, and mesh it, once prepared, unless it is."""
    _require_harmless(path)
    gmsh.open(str(path))
    prepare(gmsh)
    if mesh_size is not None:
        _require_few(gmsh, path, mesh_size)
        gmsh.option.setNumber("Mesh.MeshSizeMax", mesh_size)
    if not gmsh.model.mesh.getNodes()[0].size:
        gmsh.model.mesh.generate(2)
    if not gmsh.model.getPhysicalGroups(2):
        raise GeometryError(f"{path}: no physical surface; add one, such as Physical Surface")
    if not gmsh.model.getPhysicalGroups(1):
        raise GeometryError(f'{path}: no named edges; add, such as Physical Curve("left")')


def _require_few(gmsh: Any, path: Path, mesh_size: float) -> None:
    """Refuse a geometry that would get too many cells, as one in millimetres does."""
    x, y, _, right, top, _ = gmsh.model.getBoundingBox(-1, -1)
    wide, high = right - x, top - y
    if 2 * wide * high > MOST_CELLS * mesh_size**2:
        raise GeometryError(
            f"{path}: {wide:g} m x {high:g} m in cells of {mesh_size:g} m are too many; "
            "the unit of a geometry is the metre"
        )


def _require_harmless(path: Path, seen: tuple[Path, ...] = ()) -> None:
    """Refuse a file, or one that it reads, with statements that do more than describe a sheet.

    gmsh runs programs for a geometry, for a mesh file that is none, and for the options that
    stand beside either in a file of the same name and ``.opt``.

    Raises:
        GeometryError: With the line and the statement.
    """
    if path in seen or not path.is_file():
        return  # gmsh says that it is missing
    text = path.read_text(encoding="latin-1")
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
    for other in (*others, path.with_name(f"{path.name}.opt")):
        _require_harmless(other, (*seen, path))


def _blank(text: str) -> str:
    """Return a comment or string without its content, as long as it was."""
    if text[0] == '"':
        return '"' + " " * (len(text) - 2) + '"'
    return re.sub(r"[^\n]", " ", text)


def _numbers(gmsh: Any, dim: int, entity: int, number: dict[int, int]) -> NDArray[np.int64]:
    """Return the vertices of the lines or triangles of an entity, shape (n, dim + 1)."""
    _, _, nodes = gmsh.model.mesh.getElements(dim, entity)
    tags = np.concatenate(nodes) if nodes else np.zeros(0, dtype=np.int64)
    return np.array([number[int(t)] for t in tags], dtype=np.int64).reshape(-1, dim + 1)


def graded_rectangle(
    comm: MPI.Comm, length: float, width: float, mesh_size: float, corner_size: float | None
) -> tuple[Mesh, MeshTags, dict[str, int]]:
    """Return an unstructured rectangle, optionally refined towards its corners.

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

    def build(gmsh: Any) -> None:
        geo = gmsh.model.geo
        wide, high = length / unit, width / unit
        corners = [(0, 0), (wide, 0), (wide, high), (0, high)]
        points = [geo.addPoint(x, y, 0, smallest) for x, y in corners]
        lines = [geo.addLine(points[i], points[(i + 1) % 4]) for i in range(4)]
        surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        geo.synchronize()
        for line, name in zip(lines, ("bottom", "right", "top", "left"), strict=True):
            gmsh.model.addPhysicalGroup(1, [line], name=name)
        gmsh.model.addPhysicalGroup(2, [surface], name="sheet")
        if corner_size is not None:
            _refine_at(gmsh, points, smallest, largest, min(wide, high) / 2)
        gmsh.option.setNumber("Mesh.MeshSizeMax", largest)
        gmsh.model.mesh.generate(2)

    mesh, tags, names = _on_root(comm, build, "the rectangle")
    mesh.geometry.x[:] *= unit
    return mesh, tags, names


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


def _on_root(
    comm: MPI.Comm, build: Callable[[Any], None], what: str
) -> tuple[Mesh, MeshTags, dict[str, int]]:
    """Build a gmsh model on rank 0 and share its mesh; collective."""

    def share(model: Any) -> tuple[Mesh, MeshTags, dict[str, int]]:
        with redirect_stdout(StringIO()):
            mesh, tags, names = mesh_from_gmsh(model, comm)
        return mesh, tags, names

    return _rooted(comm, build, what, share)


def _rooted[T](
    comm: MPI.Comm,
    build: Callable[[Any], None],
    what: str,
    use: Callable[[Any], T],
) -> T:
    """Build a gmsh model on rank 0, use it, and fail on all ranks alike; collective.

    Args:
        comm: Communicator.
        build: Makes the model, on rank 0.
        what: Its name for messages.
        use: Called on every rank with the model, which is None but on rank 0.
    """
    import gmsh  # here because it costs time that most scenes need not pay

    problem: str | None = None
    if comm.rank == 0:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        try:
            build(gmsh)
        except GeometryError as error:
            problem = str(error)
        except Exception as error:  # gmsh raises bare Exception
            why = str(error).replace(f"'{what}', ", "")  # gmsh names the file again
            problem = f"gmsh cannot mesh {what}: {why}"
    problem = comm.bcast(problem)
    try:
        if problem is not None:
            raise GeometryError(problem)
        return use(gmsh.model if comm.rank == 0 else None)
    finally:
        if comm.rank == 0:
            gmsh.finalize()
            if problem is not None:
                _empty_parser(gmsh)


def _empty_parser(gmsh: Any) -> None:
    """Let gmsh read what a syntax error left in its parser, which outlives the model."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    with TemporaryDirectory() as folder, suppress(Exception):
        blank = Path(folder) / "blank.geo"
        blank.write_text(";\n")
        gmsh.open(str(blank))
    gmsh.finalize()
