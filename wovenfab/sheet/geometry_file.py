"""Sheets from files for gmsh: geometries (.geo, .step) and meshes (.msh) with named edges."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from dolfinx.mesh import Mesh, MeshTags
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.parallel import by_first, from_root
from wovenfab.sheet.gmsh_io import (
    cells_of,
    code_of,
    line_of,
    nodes_of,
    options_of,
    require_harmless,
    with_gmsh,
)
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

#: What gmsh says of a physical group with a member that the geometry lacks.
UNKNOWN = re.compile(r"Skipping unknown (curve|surface) (\d+) in physical \w+ (\d+)")
#: Statements after which curves have other numbers.
BOOLEANS = re.compile(r"\b(?:Boolean\w+|Coherence)\b")
#: Statements that make quadrilaterals.
RECOMBINING = re.compile(r"\b(?:Recombine|Mesh\.RecombineAll|Mesh\.SubdivisionAlgorithm)\b")
#: Ends of the names of files that have no names for curves, and state their unit.
STEP = (".step", ".stp")
#: Cells of a mesh at most, by the area of what encloses the sheet.
MOST_CELLS = 1e7
#: Segments that a full circle of the outline is divided in, at least.
SEGMENTS = 48
#: Curves that a message lists at most.
LISTED = 12
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
class Curve:
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
    curves: tuple[Curve, ...]


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
    comm: MPI.Comm, file: GeometryFile, mesh_size: float | None, coarse: bool = False
) -> tuple[Outline, float]:
    """Return the outline of a gmsh geometry, and the size of cells it asks for (m); collective.

    Args:
        comm: Communicator.
        file: A geometry.
        mesh_size: Largest cell size, m; None keeps what the file says.
        coarse: Whether the outline is enough and gmsh need not make cells of that size.

    Raises:
        GeometryError: As from :func:`read_geometry`, on every rank.
    """

    def read() -> tuple[Outline, float]:
        geometry = read_geometry(file, mesh_size, follow_curves=True, coarse=coarse)
        corners = geometry.points[geometry.triangles]
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        return geometry.outline, mesh_size or float(sides.max())

    return by_first(comm, read)


def read_geometry(
    file: GeometryFile,
    mesh_size: float | None = None,
    follow_curves: bool = False,
    coarse: bool = False,
) -> Geometry:
    """Return what is in a file, meshed by gmsh.

    Args:
        file: The file.
        mesh_size: Largest cell size, m; None keeps what the file says.
        follow_curves: Whether curves are divided finely enough for their shape, whatever the
            size of the cells; with a ``mesh_size`` only the outline counts then.
        coarse: Whether ``mesh_size`` is compared with the size of the sheet alone.

    Raises:
        GeometryError: gmsh cannot read the file; it does more than describe a sheet; it is no
            flat sheet in one piece, of triangles, with named edges.
    """
    require_harmless(file.path)

    def build(gmsh: Any) -> Geometry:
        try:
            lacking = _open(gmsh, file)
            if follow_curves and not file.is_mesh:
                _follow_curves(gmsh)
                if mesh_size is not None:  # cells inside need not be as small as those at edges
                    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
            if mesh_size is not None:
                _require_few(gmsh, file, mesh_size)
                if not coarse:
                    gmsh.option.setNumber("Mesh.MeshSizeMax", mesh_size / file.unit)
            if not gmsh.model.mesh.getNodes()[0].size:
                gmsh.model.mesh.generate(2)
            return _geometry(gmsh, file, lacking)
        except GeometryError as error:
            raise GeometryError(f"{file.path}: {error}", error.key) from error

    return with_gmsh(build, str(file.path))


def edge_lines(curves: Iterable[Curve]) -> list[str]:
    """Return each edge with its length, place and curves, then curves without a name, in words."""
    named: dict[str, list[Curve]] = {}
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


def _described(curves: list[Curve]) -> str:
    """Return the length and the place of curves in words."""
    low = np.min([c.low for c in curves], axis=0).round(9) + 0.0
    high = np.max([c.high for c in curves], axis=0).round(9) + 0.0
    x, y = (f"{a:.4g}" + (f" to {b:.4g}" if b > a else "") for a, b in zip(low, high, strict=True))
    return f"{sum(c.length for c in curves):.4g} m long, x = {x} m, y = {y} m"


def _listed(curves: Iterable[Curve]) -> str:
    """Return the first of some curves in words."""
    every = [str(curve) for curve in curves]
    more = f" and {len(every) - LISTED} more" if len(every) > LISTED else ""
    return ", ".join(every[:LISTED]) + more


def _open(gmsh: Any, file: GeometryFile) -> list[tuple[str, ...]]:
    """Read a file with its parameters; return kind, number and group of what it names but lacks."""
    gmsh.option.setString("Geometry.OCCTargetUnit", "MM")  # of .step files, else that of the last
    gmsh.parser.clear()
    for name, value in file.parameters.items():
        gmsh.parser.setNumber(name, [value])
    gmsh.logger.stop()
    gmsh.logger.start()
    gmsh.merge(str(file.path))  # unlike open, it leaves parameters as they are
    if (options := options_of(file.path)).is_file():
        gmsh.merge(str(options))
    code, known = code_of(file.path), sorted({*gmsh.parser.getNames()} - {*file.parameters})
    for name, value in file.parameters.items():
        key = f"parameters.{name}"
        if not re.search(rf"\b{re.escape(name)}\b", code):
            has = f"it has {', '.join(known)}" if known else "it has none"
            raise GeometryError(f"there is no parameter {name!r}; {has}", key)
        if gmsh.parser.getNumber(name)[0] != value:
            raise GeometryError(
                f"the file computes {name!r}; a case sets what stands in DefineConstant[ … ]",
                key,
            )
    return [groups for line in gmsh.logger.get() for groups in UNKNOWN.findall(line)]


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


def _require_few(gmsh: Any, file: GeometryFile, mesh_size: float) -> None:
    """Refuse a geometry that would get too many cells, as one in millimetres does."""
    x, y, _, right, top, _ = gmsh.model.getBoundingBox(-1, -1)
    wide, high = (right - x) * file.unit, (top - y) * file.unit
    if 2 * wide * high > MOST_CELLS * mesh_size**2:
        raise GeometryError(
            f"{wide:g} m x {high:g} m in cells of {mesh_size:g} m are too many; "
            "if it is in millimetres, write 'unit: mm' beside 'file'"
        )


def _geometry(gmsh: Any, file: GeometryFile, lacking: list[tuple[str, ...]]) -> Geometry:
    """Return the sheet of a model that is meshed."""
    groups = gmsh.model.getPhysicalGroups(2)
    step = file.path.suffix.lower() in STEP
    if not (groups or file.edges or step or any(kind == "surface" for kind, *_ in lacking)):
        there = ", ".join(str(tag) for _, tag in gmsh.model.getEntities(2)) or "1"
        raise GeometryError(
            f'no physical surface; add one, such as Physical Surface("sheet") = {{{there}}};'
        )
    _require_triangles(gmsh, file)
    places, rows = nodes_of(gmsh)
    places *= file.unit
    surfaces = [int(s) for g in groups for s in gmsh.model.getEntitiesForPhysicalGroup(*g)]
    cells = np.concatenate([cells_of(gmsh, 2, surface, rows) for surface in surfaces or [-1]])
    used, numbers = np.unique(cells, return_inverse=True)
    if not used.size:
        raise GeometryError("there is no surface to mesh")
    low, high = places[used].min(axis=0), places[used].max(axis=0)
    if high[2] - low[2] > FLAT * (high - low).max():
        across = f"z is {low[2]:g} m to {high[2]:g} m"
        raise GeometryError(f"the sheet is not in the x-y plane: {across}; turn it")
    points, triangles = places[used, :2], numbers.reshape(-1, 3)
    fresh = np.full(len(places), -1)
    fresh[used] = np.arange(len(used))
    sides = {frozenset(map(int, side)) for side in free_sides(points, triangles)}
    curves, names, segments = [], _names(gmsh, file), dict[str, list[Triangles]]()
    for _, number in gmsh.model.getEntities(1):
        pairs = cells_of(gmsh, 1, number, rows)
        ends, name = places[pairs, :2], names.get(number)
        if len(pairs):
            length = float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum())
            outside = all(frozenset(map(int, side)) in sides for side in fresh[pairs])
            box = ends.min(axis=(0, 1)), ends.max(axis=(0, 1))
            curves.append(Curve(number, name, length, *box, outside))
            if outside and name is not None:
                segments.setdefault(name, []).append(fresh[pairs])
    _require_edges(gmsh, file, lacking, curves)
    named = {name: np.concatenate(parts) for name, parts in segments.items()}
    return Geometry(points, triangles, outline_of(points, triangles, named), tuple(curves))


def _require_triangles(gmsh: Any, file: GeometryFile) -> None:
    mesh = gmsh.model.mesh
    if any(mesh.getElementProperties(kind)[5] != 3 for kind in mesh.getElementTypes(2)):
        remedy = f"remove Recombine {line_of(file.path, RECOMBINING)}".rstrip()
        if file.is_mesh:
            remedy = "name its .geo in the case, or mesh that without Recombine (gmsh -2 FILE.geo)"
        raise GeometryError(f"has quadrilaterals, and a sheet is made of triangles: {remedy}")


def _names(gmsh: Any, file: GeometryFile) -> dict[int, str]:
    """Return the edge of each curve that has one."""
    groups = {
        gmsh.model.getPhysicalName(1, group): gmsh.model.getEntitiesForPhysicalGroup(1, group)
        for _, group in gmsh.model.getPhysicalGroups(1)
    }
    names: dict[int, str] = {}
    for name, numbers in {**groups, **file.edges}.items():
        for number in numbers if name else ():
            if names.setdefault(int(number), name) != name:
                both = f"{names[int(number)]!r} and {name!r}"
                raise GeometryError(f"curve {number} is in two edges, {both}; take it out of one")
    return names


def _require_edges(
    gmsh: Any, file: GeometryFile, lacking: list[tuple[str, ...]], curves: list[Curve]
) -> None:
    """Refuse names of what is not there or not on the outline, and a sheet without names."""
    has = f"the outline has {_listed(c for c in curves if c.outside)}"
    for kind, tag, group in lacking:
        name = gmsh.model.getPhysicalName(1 if kind == "curve" else 2, int(group))
        place = line_of(file.path, re.compile(rf"Physical\s+\w+\s*\(\s*\"{re.escape(name)}\""))
        text = f"Physical {kind.title()}({name!r}) {place} names {kind} {tag}, which is not there"
        if boolean := line_of(file.path, BOOLEANS):
            text += f": the Boolean operation {boolean} numbers what it makes anew"
        surfaces = ", ".join(str(surface) for _, surface in gmsh.model.getEntities(2))
        raise GeometryError(f"{text}; {has if kind == 'curve' else f'surfaces are {surfaces}'}")
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
