"""Meshes by gmsh: any .geo or .msh file with named edges, and graded rectangles."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from dolfinx.mesh import Mesh, MeshTags
from mpi4py import MPI

from wovenfab.compat import mesh_from_gmsh


class GeometryError(Exception):
    """A geometry that cannot be meshed; the text says why and what to do."""


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
        gmsh.open(str(path))
        if mesh_size is not None:
            gmsh.option.setNumber("Mesh.MeshSizeMax", mesh_size)
        if not gmsh.model.mesh.getNodes()[0].size:
            gmsh.model.mesh.generate(2)
        if not gmsh.model.getPhysicalGroups(2):
            raise GeometryError(f"{path}: no physical surface; add one, such as Physical Surface")
        if not gmsh.model.getPhysicalGroups(1):
            raise GeometryError(f'{path}: no named edges; add, such as Physical Curve("left")')

    return _on_root(comm, build, str(path))


def graded_rectangle(
    comm: MPI.Comm, length: float, width: float, mesh_size: float, corner_size: float | None
) -> tuple[Mesh, MeshTags, dict[str, int]]:
    """Return an unstructured rectangle, optionally refined towards its corners.

    Args:
        comm: Communicator.
        length: Extent in x, m.
        width: Extent in y, m.
        mesh_size: Cell size away from the corners, m.
        corner_size: Cell size at the corners, m; None for a uniform mesh.
    """

    def build(gmsh: Any) -> None:
        geo = gmsh.model.geo
        size = corner_size or mesh_size
        corners = [(0, 0), (length, 0), (length, width), (0, width)]
        points = [geo.addPoint(x, y, 0, size) for x, y in corners]
        lines = [geo.addLine(points[i], points[(i + 1) % 4]) for i in range(4)]
        surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        geo.synchronize()
        for line, name in zip(lines, ("bottom", "right", "top", "left"), strict=True):
            gmsh.model.addPhysicalGroup(1, [line], name=name)
        gmsh.model.addPhysicalGroup(2, [surface], name="sheet")
        if corner_size is not None:
            _refine_at(gmsh, points, corner_size, mesh_size, min(length, width) / 2)
        gmsh.option.setNumber("Mesh.MeshSizeMax", mesh_size)
        gmsh.model.mesh.generate(2)

    return _on_root(comm, build, "the rectangle")


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
    """Build a gmsh model on rank 0, share it, and fail on all ranks alike."""
    import gmsh  # here because it costs time that most scenes need not pay

    problem: str | None = None
    if comm.rank == 0:
        gmsh.initialize(interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        try:
            build(gmsh)
        except GeometryError as error:
            problem = str(error)
        except Exception as error:  # gmsh raises bare Exception
            problem = f"gmsh cannot mesh {what}: {error}"
    problem = comm.bcast(problem)
    try:
        if problem is not None:
            raise GeometryError(problem)
        with redirect_stdout(StringIO()):
            mesh, tags, names = mesh_from_gmsh(gmsh.model if comm.rank == 0 else None, comm)
        return mesh, tags, names
    finally:
        if comm.rank == 0:
            gmsh.finalize()
            if problem is not None:
                _empty_parser(gmsh)


def _empty_parser(gmsh: Any) -> None:
    """Let gmsh read what a syntax error left in its parser, which outlives the model."""
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    with TemporaryDirectory() as folder, suppress(Exception):
        blank = Path(folder) / "blank.geo"
        blank.write_text(";\n")
        gmsh.open(str(blank))
    gmsh.finalize()
