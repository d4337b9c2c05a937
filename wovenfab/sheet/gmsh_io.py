"""Unstructured rectangles by gmsh."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx.mesh import Mesh, MeshTags
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.sheet.errors import GeometryError
from wovenfab.sheet.gmsh_model import cells_of, load_gmsh, nodes_of, start
from wovenfab.sheet.sheet import name_facets, rectangle_outline, triangle_mesh

Array = NDArray[np.float64]
Cells = NDArray[np.int64]


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

    def made() -> tuple[Array, Cells]:
        gmsh = load_gmsh()
        start(gmsh)
        try:
            return build(gmsh)
        except Exception as error:
            if type(error) is not Exception:  # that of gmsh
                raise
            raise GeometryError(f"gmsh cannot mesh the rectangle: {error}") from error
        finally:
            gmsh.finalize()

    mesh = triangle_mesh(comm, made)
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
