"""The fields that a user sees, evaluated cell by cell at given points, and at probes.

Values are not averaged between cells: curvatures jump there, and that shows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import basix.ufl
import numpy as np
import shapely
import ufl
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray
from scipy import sparse

from wovenfab.case.schema import Extensometer, Line, PointProbe, Probe, Yarn, Zone
from wovenfab.compat import corners_of
from wovenfab.forms.kinematics import (
    curvature_vector,
    displacements,
    norm,
    point_of,
    shear_angle,
    stretch,
)
from wovenfab.model.assembly import compile_expression
from wovenfab.model.model import Model
from wovenfab.sheet.lattice import NOWHERE, Lattice, circle, locate
from wovenfab.sheet.sheet import Sheet


@dataclass(frozen=True)
class Field:
    """A field of the deformed sheet.

    Attributes:
        name: Name in the results, such as ``curvature_1``.
        group: Name in the case file, such as ``curvature``.
        unit: SI unit, empty where there is none.
        expression: UFL scalar or vector.
    """

    name: str
    group: str
    unit: str
    expression: Any

    @property
    def size(self) -> int:
        """Number of components."""
        return int(np.prod(self.expression.ufl_shape, dtype=int))


def available(model: Model) -> tuple[Field, ...]:
    """Return all fields that the model's effects give a meaning to."""
    balance = model.balance
    point = point_of(model.field, balance.fibres, balance.second_gradient)
    families = tuple(enumerate(displacements(model.field), start=1))
    fields = []
    if point.slip is None:
        fields.append(Field("displacement", "displacement", "m", families[0][1]))
    else:
        fields += [Field(f"displacement_{a}", "displacement", "m", u) for a, u in families]
        fields.append(Field("relative_displacement", "relative_displacement", "m", -point.slip))
        fields.append(Field("beta", "relative_displacement", "m", norm(point.slip)))
    if point.g is not None:
        fields += [
            Field(f"curvature_{a}", "curvature", "1/m", norm(curvature_vector(f, g)))
            for a, (f, g) in enumerate(zip(point.f, point.g, strict=True), start=1)
        ]
    fields.append(Field("shear_angle", "shear_angle", "rad", shear_angle(point.f, point.fibres)))
    fields += [Field(f"stretch_{a}", "stretch", "", stretch(f)) for a, f in enumerate(point.f, 1)]
    return tuple(fields)


class FieldProbe:
    """Evaluates chosen fields on this rank's own cells at the same reference points."""

    def __init__(
        self,
        model: Model,
        groups: Sequence[str],
        points: NDArray[np.float64],
        cells: NDArray[np.int32] | None = None,
    ) -> None:
        """Compile the evaluation; collective.

        Args:
            model: The model whose present field is evaluated.
            groups: Groups of fields; those that the model lacks are left out.
            points: Reference points, shape (n, 2).
            cells: Some of the own cells; all if None.
        """
        mesh = model.sheet.mesh
        own = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        self.fields = tuple(f for f in available(model) if f.group in groups)
        self.cells = own if cells is None else cells
        self._mesh = mesh
        self._points_per_cell = len(points)
        everything = [f.expression for f in self.fields]
        self._values = compile_expression(ufl.as_vector(_components(everything)), points)
        place = ufl.SpatialCoordinate(mesh)
        self._places: fem.Expression = compile_expression(place, points)

    def positions(self) -> NDArray[np.float64]:
        """Return the reference positions of all points, shape (cells, n, 2), m."""
        return self._evaluate(self._places, 2)

    def together(self) -> NDArray[np.float64]:
        """Return all fields one after the other, shape (cells, n, components of all)."""
        return self._evaluate(self._values, sum(f.size for f in self.fields))

    def values(self) -> dict[str, NDArray[np.float64]]:
        """Return each field at all points, shape (cells, n, components)."""
        parts = np.split(self.together(), np.cumsum([f.size for f in self.fields])[:-1], axis=2)
        return {f.name: part for f, part in zip(self.fields, parts, strict=True)}

    def _evaluate(self, expression: fem.Expression, size: int) -> NDArray[np.float64]:
        values: NDArray[np.float64] = expression.eval(self._mesh, self.cells)
        return values.reshape(len(self.cells), self._points_per_cell, size)


def _components(expressions: Sequence[Any]) -> list[Any]:
    components: list[Any] = []
    for e in expressions:
        components += [e] if e.ufl_shape == () else [e[i] for i in range(e.ufl_shape[0])]
    return components


def interpolated(model: Model, name: str) -> fem.Function:
    """Return a field of the present state as a function, discontinuous between cells; collective.

    Args:
        model: The model.
        name: Name of the field, such as ``shear_angle``.

    Raises:
        KeyError: If the model's effects give it no meaning.
    """
    fields = {f.name: f for f in available(model)}
    if name not in fields:
        raise KeyError(f"the effects of this case have no field {name!r}, but {', '.join(fields)}")
    shape = () if fields[name].size == 1 else (fields[name].size,)
    mesh, degree = model.sheet.mesh, model.balance.degree
    element = basix.ufl.element("DG", "triangle", degree, shape=shape)
    space = fem.functionspace(mesh, element)
    function = fem.Function(space, name=name)
    points = basix.ufl.element("DG", "triangle", degree).basix_element.points
    probe = FieldProbe(model, [fields[name].group], points)
    rows = function.x.array.reshape(-1, fields[name].size)
    rows[space.dofmap.list[: len(probe.cells)]] = probe.values()[name]
    function.x.scatter_forward()
    return function


class Probes:
    """Points, extensometers and zones of a case, for every step.

    They are located and the elements are tabulated there once: a step costs the displacement and
    the shear angle on the cells concerned, and a product with a sparse matrix.

    Attributes:
        columns: Name and unit of each value, as in ``history.csv``.
    """

    def __init__(
        self, model: Model, probes: Mapping[str, PointProbe | Extensometer | Zone]
    ) -> None:
        """Locate the probes, one at least; collective."""
        self._comm, sheet, lattice = model.comm, model.sheet, Lattice(model.numerics.degree)
        self._probes, self._families = tuple(probes.values()), model.placements.count
        self._places = np.reshape([x for p in self._probes for x in places_of(p)], (-1, 2))
        zones = [zone_of(p) for p in self._probes if isinstance(p, Zone)]
        corners = own_corners(sheet)
        cells, local, _ = located(sheet, self._places)
        means = lattice.over_zones(corners, zones)
        self._areas = self._comm.allreduce(means.sum(axis=1), op=MPI.SUM)
        matrix = sparse.vstack([lattice.at_points(cells, local, len(corners)), means]).tocsr()
        nodes = len(lattice.points)
        used = np.unique(matrix.indices // nodes).astype(np.int32)
        self._matrix = matrix[:, (nodes * used[:, None] + np.arange(nodes)).ravel()]
        groups = ["displacement", *(["shear_angle"] if zones else [])]
        self._probe = FieldProbe(model, groups, lattice.points, used)
        self.columns = tuple(c for n, p in probes.items() for c in self._columns(n, p))

    def values(self) -> list[float]:
        """Return the values of the present state, one a column; collective."""
        together = self._probe.together()
        own = self._matrix @ together.reshape(-1, together.shape[2])
        rows = np.empty_like(own)
        self._comm.Allreduce(own, rows, op=MPI.SUM)
        moved = rows[: len(self._places), : 2 * self._families].reshape(-1, self._families, 2)
        angles, at = iter(rows[len(self._places) :, -1] / self._areas), 0
        values: list[float] = []
        for probe in self._probes:
            if isinstance(probe, Zone):
                values.append(float(next(angles)))
                continue
            count = len(places_of(probe))
            here, u = self._places[at : at + count], moved[at : at + count]
            at += count
            values += map(float, _gauge(probe, here, u) if count == 2 else _displaced(u[0]))
        return values

    def _columns(self, name: str, probe: Probe) -> list[str]:
        if isinstance(probe, Zone):
            return [f"{name}_shear_angle_rad"]
        if isinstance(probe, Extensometer):
            return [f"{name}_gauge_length_m", f"{name}_strain"]
        families = ["_1", "_2"] if self._families == 2 else [""]
        moved = [f"{name}_displacement{a}_{xy}_m" for a in families for xy in "xy"]
        return [*moved, *([f"{name}_beta_m"] if self._families == 2 else [])]


def _displaced(u: NDArray[np.float64]) -> list[float]:
    """Return displacements (m) of a point and the slip there (m), if there are two."""
    return [*u.ravel(), *([float(np.linalg.norm(u[0] - u[1]))] if len(u) == 2 else [])]


def _gauge(probe: Any, rest: NDArray[np.float64], u: NDArray[np.float64]) -> tuple[float, float]:
    """Return the distance (m) of both ends of an extensometer and its strain."""
    own = u.mean(axis=1) if probe.family is None else u[:, (probe.family - 1) % u.shape[1]]
    length, first = (float(np.linalg.norm(x[1] - x[0])) for x in (rest + own, rest))
    return length, length / first - 1


def places_of(probe: Probe) -> list[tuple[float, float]]:
    """Return the reference positions (m) that a probe names as points of the sheet."""
    match probe:
        case PointProbe(at=place) | Yarn(through=place):
            return [place]
        case Extensometer(ends=ends) | Line(ends=ends):
            return [*ends]
    return []


def zone_of(probe: Zone) -> shapely.Polygon:
    """Return the region (m) of a zone."""
    if probe.corners is None:
        assert probe.centre is not None and probe.radius is not None
        return circle(probe.centre, probe.radius)
    return shapely.box(*np.min(probe.corners, axis=0), *np.max(probe.corners, axis=0))


def own_corners(sheet: Sheet) -> NDArray[np.float64]:
    """Return the corners of this rank's own cells, shape (cells, 3, 2), m."""
    mesh = sheet.mesh
    corners = corners_of(mesh)[: mesh.topology.index_map(2).size_local]
    return np.asarray(mesh.geometry.x[corners][:, :, :2])


def located(sheet: Sheet, points: NDArray[np.float64]) -> tuple[Any, Any, NDArray[np.bool_]]:
    """Locate points (m), shape (n, 2), each on one rank; collective.

    Returns:
        Own cell, negative where it is of another rank or none; coordinates in it; whether the
        point is on the sheet.
    """
    corners = own_corners(sheet)
    cells, local, keys = locate(corners, points, sheet.original_cells[: len(corners)])
    best = np.empty_like(keys)
    sheet.mesh.comm.Allreduce(keys, best, op=MPI.MIN)
    return np.where(keys == best, cells, -1), local, best != NOWHERE


def misplaced(sheet: Sheet, probes: Mapping[str, Probe]) -> Iterator[tuple[str, str]]:
    """Yield name and fault of each probe that is not wholly on the sheet; collective."""
    lattice, corners, comm = Lattice(1), own_corners(sheet), sheet.mesh.comm
    for name, probe in probes.items():
        places = np.reshape(places_of(probe), (-1, 2))
        *_, on_sheet = located(sheet, places)
        for x, y in places[~on_sheet]:
            yield name, f"the point x = {x:g} m, y = {y:g} m is not on the sheet"
        if isinstance(probe, Zone):
            zone = zone_of(probe)
            area = comm.allreduce(lattice.over_zones(corners, [zone]).sum(), op=MPI.SUM)
            if area < (1 - 1e-6) * zone.area:
                yield name, "the zone reaches beyond the sheet"


def extent(sheet: Sheet) -> NDArray[np.float64]:
    """Return the least and largest x and y of a sheet, shape (2, 2), m; collective."""
    x = own_corners(sheet).reshape(-1, 2)
    ends = sheet.mesh.comm.allgather(
        [x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)]
    )
    low, high = np.swapaxes(ends, 0, 1)
    return np.stack([low.min(axis=0), high.max(axis=0)], axis=1)
