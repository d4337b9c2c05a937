"""Probes evaluated: displacement, strain or shear angle at named places, on every step."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from wovenfab.compat import corners_of
from wovenfab.model.fields import FieldProbe
from wovenfab.model.model import Model
from wovenfab.sheet.output_nodes import NOWHERE, OutputNodes, locate
from wovenfab.sheet.probes import Extensometer, Gauge, Line, PointProbe, Position, Probe, Yarn, Zone
from wovenfab.sheet.sheet import Sheet


class Probes:
    """Points, extensometers and zones, evaluated on every step.

    They are located and the elements are tabulated there once: a step costs the displacement and
    the shear angle on the cells concerned, and a product with a sparse matrix.

    Attributes:
        columns: Name and unit of each value, as in ``history.csv``.
    """

    def __init__(self, model: Model, probes: Mapping[str, Gauge]) -> None:
        """Locate the probes, one at least; collective."""
        self._comm, sheet, lattice = model.comm, model.sheet, OutputNodes(model.numerics.degree)
        self._probes, self._families = tuple(probes.values()), model.placements.count
        self._places = np.reshape([x for p in self._probes for x in places_of(p)], (-1, 2))
        zones = [p.region for p in self._probes if isinstance(p, Zone)]
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


class PointFields:
    """Fields of the present state at any points of the sheet, located once.

    Attributes:
        points: Reference positions, shape (n, 2), m.
    """

    def __init__(
        self, model: Model, points: ArrayLike, groups: Sequence[str] = ("displacement",)
    ) -> None:
        """Locate the points and compile the evaluation; collective.

        Args:
            model: The model.
            points: Reference positions, shape (n, 2), m.
            groups: Groups of fields, such as ``"shear_angle"``; those that the model's effects
                give no meaning to are left out.

        Raises:
            ValueError: A point is not on the sheet.
        """
        self.points = np.reshape(np.asarray(points, dtype=float), (-1, 2))
        self._comm, lattice = model.comm, OutputNodes(model.numerics.degree)
        cells, local, on_sheet = located(model.sheet, self.points)
        if not on_sheet.all():
            x, y = self.points[~on_sheet][0]
            raise ValueError(f"the point x = {x:g} m, y = {y:g} m is not on the sheet")
        own = model.sheet.mesh.topology.index_map(2).size_local
        self._matrix = sparse.csr_array(lattice.at_points(cells, local, own))
        self._probe = FieldProbe(model, groups, lattice.points)

    def values(self) -> dict[str, NDArray[np.float64]]:
        """Return each field by name, shape (n, components), the same on all ranks; collective."""
        found = {}
        for name, values in self._probe.values().items():
            mine = self._matrix @ values.reshape(-1, values.shape[2])
            found[name] = np.empty_like(mine)
            self._comm.Allreduce(np.ascontiguousarray(mine), found[name], op=MPI.SUM)
        return found


def points_of_yarn(sheet: Sheet, yarn: Yarn) -> NDArray[np.float64]:
    """Return equidistant points at rest (m) of a yarn from edge to edge, shape (n, 2); collective.

    Raises:
        ValueError: The sheet is not where the yarn should be.
    """
    corners = np.concatenate(sheet.mesh.comm.allgather(own_corners(sheet)))
    start, end = yarn.ends(sheet.fibres, corners)
    share = np.linspace(0.0, 1.0, yarn.points)[:, None]
    return np.asarray(start + share * (end - start))


def _displaced(u: NDArray[np.float64]) -> list[float]:
    """Return displacements (m) of a point and the slip there (m), if there are two."""
    return [*u.ravel(), *([float(np.linalg.norm(u[0] - u[1]))] if len(u) == 2 else [])]


def _gauge(probe: Any, rest: NDArray[np.float64], u: NDArray[np.float64]) -> tuple[float, float]:
    """Return the distance (m) of both ends of an extensometer and its strain."""
    own = u.mean(axis=1) if probe.family is None else u[:, (probe.family - 1) % u.shape[1]]
    length, first = (float(np.linalg.norm(x[1] - x[0])) for x in (rest + own, rest))
    return length, length / first - 1


def places_of(probe: Probe) -> list[Position]:
    """Return the reference positions (m) that a probe names as points of the sheet."""
    match probe:
        case PointProbe(at=place) | Yarn(through=place):
            return [place]
        case Extensometer(ends=ends) | Line(ends=ends):
            return [*ends]
    return []


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
    lattice, corners, comm = OutputNodes(1), own_corners(sheet), sheet.mesh.comm
    for name, probe in probes.items():
        places = np.reshape(places_of(probe), (-1, 2))
        *_, on_sheet = located(sheet, places)
        for x, y in places[~on_sheet]:
            yield name, f"the point x = {x:g} m, y = {y:g} m is not on the sheet"
        if isinstance(probe, Zone):
            area = comm.allreduce(lattice.over_zones(corners, [probe.region]).sum(), op=MPI.SUM)
            if area < (1 - 1e-6) * probe.region.area:
                yield name, "the zone reaches beyond the sheet"


def extent(sheet: Sheet) -> NDArray[np.float64]:
    """Return the least and largest x and y of a sheet, shape (2, 2), m; collective."""
    x = own_corners(sheet).reshape(-1, 2)
    ends = sheet.mesh.comm.allgather(
        [x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)]
    )
    low, high = np.swapaxes(ends, 0, 1)
    return np.stack([low.min(axis=0), high.max(axis=0)], axis=1)
