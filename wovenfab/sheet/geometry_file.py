"""Sheets from files for gmsh: geometries (.geo, .step) and meshes (.msh) with named edges."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from dolfinx.mesh import Mesh, MeshTags
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.parallel import compute_on_root, from_root
from wovenfab.sheet.file_mesh import FileMesh
from wovenfab.sheet.gmsh_process import LIMIT, Request, meshed
from wovenfab.sheet.msh import read_msh
from wovenfab.sheet.sheet import (
    GeometryError,
    Outline,
    free_sides,
    name_facets,
    outline_of,
    triangle_mesh,
)

Array = NDArray[np.float64]
Triangles = NDArray[np.int64]

#: Ends of the names of files that have no names for curves, and state their unit.
STEP = (".step", ".stp")
#: Distance from the origin, in sizes of the sheet, at most: positions are unknowns of the solver.
FAR = 1e4
#: A sheet is flat if its z differs by less than this share of its size.
FLAT = 1e-6


@dataclass(frozen=True)
class GeometryFile:
    """A file for gmsh, and what a case says of it.

    Attributes:
        path: A .geo, .step or .msh file.
        unit: Length of gmsh's unit, m.
        parameters: Values of constants that the file defines by DefineConstant, in its units.
        edges: Numbers of the curves of edges that the file does not name.
    """

    path: Path
    unit: float = 1.0
    parameters: Mapping[str, float] = field(default_factory=dict)
    edges: Mapping[str, tuple[int, ...]] = field(default_factory=dict)

    @property
    def is_mesh(self) -> bool:
        """Whether it has cells already."""
        return self.path.suffix.lower() == ".msh"


@dataclass(frozen=True)
class BoundaryCurve:
    """A curve of a geometry.

    Attributes:
        number: Its number in gmsh.
        name: The edge that it belongs to.
        length: Of the segments that it is divided in, m.
        low: Least coordinates, shape (2,), m.
        high: Largest coordinates, shape (2,), m.
        outside: Whether it is on the outline of the sheet.
    """

    number: int
    name: str | None
    length: float
    low: Array
    high: Array
    outside: bool

    def __str__(self) -> str:
        """Return number, length and place in words."""
        return f"curve {self.number} ({_described([self])})"


@dataclass(frozen=True)
class Geometry:
    """What a file gives.

    Attributes:
        points: Vertices of the mesh by gmsh, shape (n, 2), m.
        triangles: Corners of its cells, shape (m, 3).
        outline: The outline with its named edges.
        curves: All curves.
    """

    points: Array
    triangles: Triangles
    outline: Outline
    curves: tuple[BoundaryCurve, ...]

    @property
    def longest_side(self) -> float:
        """The longest side of its cells, m."""
        corners = self.points[self.triangles]
        return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())


def from_file(
    comm: MPI.Comm, file: GeometryFile, mesh_size: float | None
) -> tuple[Mesh, MeshTags, dict[str, int]]:
    """Return mesh, facet tags and tag numbers of a gmsh geometry or mesh; collective.

    Args:
        comm: Communicator.
        file: The file, which is meshed here unless it is a mesh.
        mesh_size: Largest cell size, m; None keeps what the file says.

    Raises:
        GeometryError: As from :func:`read_geometry`, on every rank.
    """
    geometry = from_root(comm, lambda: read_geometry(file, mesh_size), None)
    outline = comm.bcast(geometry and geometry.outline)
    mesh = triangle_mesh(comm, lambda: (geometry.points, geometry.triangles))  # type: ignore[union-attr]
    return mesh, *name_facets(mesh, outline)


def outline_from_file(
    comm: MPI.Comm, file: GeometryFile, mesh_size: float | None
) -> tuple[Outline, float]:
    """Return the outline of a gmsh geometry, and the size of cells it asks for (m); collective.

    Args:
        comm: Communicator.
        file: A geometry.
        mesh_size: Largest cell size, m; None keeps what the file says.

    Raises:
        GeometryError: As from :func:`read_geometry`, on every rank.
    """

    def read() -> tuple[Outline, float]:
        geometry = read_geometry(file, mesh_size, follow_curves=True)
        return geometry.outline, mesh_size or geometry.longest_side

    return compute_on_root(comm, read)


def read_geometry(
    file: GeometryFile,
    mesh_size: float | None = None,
    follow_curves: bool = False,
    coarse: bool = False,
    seconds: float = LIMIT,
) -> Geometry:
    """Return what is in a file; a geometry is meshed by gmsh, in a process of its own.

    Args:
        file: The file.
        mesh_size: Largest cell size, m; None keeps what the file says.
        follow_curves: Whether curves are divided finely enough for their shape, whatever the
            size of the cells; with a ``mesh_size`` only the outline counts then.
        coarse: Whether ``mesh_size`` is compared with the size of the sheet alone.
        seconds: Time that gmsh has.

    Raises:
        GeometryError: The file cannot be read or meshed; it is no flat sheet in one piece, of
            triangles, with named edges.
    """
    try:
        if file.is_mesh:
            return _geometry(read_msh(file.path), file)
        request = Request(
            str(file.path.absolute()),
            file.unit,
            dict(file.parameters),
            None if mesh_size is None else mesh_size / file.unit,
            follow_curves,
            coarse,
        )
        return _geometry(meshed(request, seconds), file)
    except GeometryError as error:
        raise GeometryError(f"{file.path}: {error}", error.key) from error


def edge_lines(curves: Iterable[BoundaryCurve]) -> list[str]:
    """Return each edge with its length, place and curves, then curves without a name, in words."""
    named: dict[str, list[BoundaryCurve]] = {}
    for curve in curves:
        if curve.name is not None:
            named.setdefault(curve.name, []).append(curve)
    lines = [
        f"edge {name}: {_described(parts)} (curve {', '.join(str(c.number) for c in parts)})"
        if all(c.outside for c in parts)
        else f"{name} is not on the outline, and no edge"
        for name, parts in named.items()
    ]
    unnamed = [c for c in curves if c.name is None and c.outside]
    return [*lines, *([f"without a name: {_listed(unnamed)}"] if unnamed else [])]


def _described(curves: list[BoundaryCurve]) -> str:
    """Return the length and the place of curves in words."""
    low = np.min([c.low for c in curves], axis=0).round(9) + 0.0
    high = np.max([c.high for c in curves], axis=0).round(9) + 0.0
    x, y = (f"{a:.4g}" + (f" to {b:.4g}" if b > a else "") for a, b in zip(low, high, strict=True))
    return f"{sum(c.length for c in curves):.4g} m long, x = {x} m, y = {y} m"


def _listed(curves: Iterable[BoundaryCurve]) -> str:
    """Return curves in words."""
    return ", ".join(map(str, curves))


def _geometry(mesh: FileMesh, file: GeometryFile) -> Geometry:
    """Return the sheet of a mesh."""
    groups = mesh.surface_groups
    step = file.path.suffix.lower() in STEP
    if not (groups or file.edges or step):
        there = ", ".join(map(str, mesh.surfaces)) or "1"
        raise GeometryError(
            f'no physical surface; add one, such as Physical Surface("sheet") = {{{there}}};'
        )
    _require_triangles(mesh, file)
    places = mesh.points * file.unit
    chosen = {number for group in groups for number in group.members} or {*mesh.surfaces}
    none = np.zeros((0, 3), dtype=np.int64)
    cells = np.concatenate([none, *(c for n, c in mesh.surfaces.items() if n in chosen)])
    used, numbers = np.unique(cells, return_inverse=True)
    if not used.size:
        raise GeometryError("there is no surface with triangles")
    low, high = places[used].min(axis=0), places[used].max(axis=0)
    if high[2] - low[2] > FLAT * (high - low).max():
        across = f"z is {low[2]:g} m to {high[2]:g} m"
        raise GeometryError(f"the sheet is not in the x-y plane: {across}; turn it")
    _require_near(low[:2], high[:2])
    points, triangles = places[used, :2], numbers.reshape(-1, 3)
    fresh = np.full(len(places), -1)
    fresh[used] = np.arange(len(used))
    sides = {frozenset(map(int, side)) for side in free_sides(points, triangles)}
    curves, names, segments = [], _names(mesh, file), dict[str, list[Triangles]]()
    for number, pairs in mesh.curves.items():
        ends, name = places[pairs, :2], names.get(number)
        if len(pairs):
            length = float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum())
            outside = all(frozenset(map(int, side)) in sides for side in fresh[pairs])
            box = ends.min(axis=(0, 1)), ends.max(axis=(0, 1))
            curves.append(BoundaryCurve(number, name, length, *box, outside))
            if outside and name is not None:
                segments.setdefault(name, []).append(fresh[pairs])
    _require_edges(mesh, file, curves)
    named = {name: np.concatenate(parts) for name, parts in segments.items()}
    return Geometry(points, triangles, outline_of(points, triangles, named), tuple(curves))


def _require_near(low: Array, high: Array) -> None:
    """Refuse a sheet so far from the origin that its coordinates are not exact enough."""
    size, away = float((high - low).max()), float(np.abs([low, high]).max())
    if not 0 < size < np.inf or away > FAR * size:
        where = f"it is {size:.3g} m large, and up to {away:.3g} m from the origin"
        raise GeometryError(f"{where}, where coordinates are too rough; move it to the origin")


def _require_triangles(mesh: FileMesh, file: GeometryFile) -> None:
    if mesh.other_cells:
        remedy = f"remove Recombine {mesh.recombining}".rstrip()
        if file.is_mesh:
            remedy = "name its .geo in the case, or mesh that without Recombine (gmsh -2 FILE.geo)"
        raise GeometryError(f"has quadrilaterals, and a sheet is made of triangles: {remedy}")


def _names(mesh: FileMesh, file: GeometryFile) -> dict[int, str]:
    """Return the edge of each curve that has one."""
    groups = [(group.name, group.members) for group in mesh.curve_groups]
    names: dict[int, str] = {}
    for name, numbers in (*groups, *file.edges.items()):
        for number in numbers if name else ():
            if names.setdefault(number, name) != name:
                both = f"{names[number]!r} and {name!r}"
                raise GeometryError(f"curve {number} is in two edges, {both}; take it out of one")
    return names


def _require_edges(mesh: FileMesh, file: GeometryFile, curves: list[BoundaryCurve]) -> None:
    """Refuse names of what is not there or not on the outline, and a sheet without names."""
    has = f"the outline has {_listed(c for c in curves if c.outside)}"
    for kind, groups in (("curve", mesh.curve_groups), ("surface", mesh.surface_groups)):
        for group in groups:
            if group.missing:
                what = f"Physical {kind.title()}({group.name!r}) {group.place}".rstrip()
                text = f"{what} names {kind} {group.missing[0]}, which is not there"
                if mesh.boolean:
                    text += f": the Boolean operation {mesh.boolean} numbers what it makes anew"
                surfaces = ", ".join(map(str, mesh.surfaces))
                there = has if kind == "curve" else f"surfaces are {surfaces}"
                raise GeometryError(f"{text}; {there}")
    known = {curve.number: curve for curve in curves}
    for name, numbers in file.edges.items():
        for number in numbers:
            if number not in known or not known[number].outside:
                what = f"curve {number} of {name!r} is not on the outline of the sheet"
                raise GeometryError(f"{what}; {has}", f"edges.{name}")
    edges = {c.name for c in curves if c.outside and c.name is not None}
    for curve in curves:
        if curve.name in edges and not curve.outside:
            what = f"{curve} of {curve.name!r} is not on the outline of the sheet"
            raise GeometryError(f"{what}; take it out of that Physical Curve; {has}")
    if not edges:
        first = next(c.number for c in curves if c.outside) if any(c.outside for c in curves) else 1
        raise GeometryError(
            f'no named edges; add, such as Physical Curve("left") = {{{first}}}, or in the case '
            f"'edges: {{left: {first}}}' beside 'file'; {has}"
        )
