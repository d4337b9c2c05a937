"""Material lines and the outline of a sheet, from the triangles on which fields are stored.

The yarns of a run over time, as lines that ParaView opens.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from wovenfab.record.field_file import FieldFile, polylines
from wovenfab.record.stored_fields import StoredFields
from wovenfab.report.run_data import RunData

Values = NDArray[np.float64]
Numbers = NDArray[np.int64]
Polyline = NDArray[np.float64]
#: Sides of a triangle, as the numbers of their ends.
_SIDES = np.array([[0, 1], [1, 2], [2, 0]])


@dataclass(frozen=True)
class Triangles:
    """The stored mesh.

    Attributes:
        points: Reference points (m), shape (n, 2); each cell has its own.
        triangles: Points of each triangle, shape (m, 3).
    """

    points: Values
    triangles: Numbers

    def surface(self) -> pv.PolyData:
        """Return the mesh as VTK has it."""
        space = np.column_stack([self.points, np.zeros(len(self.points))])
        faces = np.column_stack([np.full(len(self.triangles), 3), self.triangles])
        return pv.PolyData(space, faces.ravel())


@dataclass(frozen=True)
class Yarns:
    """Yarns of one family as they lie on the mesh at rest, whatever happens to it.

    A point of a yarn lies on the side of a triangle, so that a field there follows from its
    values at both ends.

    Attributes:
        ends: Numbers of both ends in the mesh, shape (points, 2).
        share: How far each point is from the first to the second, shape (points,).
        starts: Number of the first point of each piece of yarn, ascending from 0.
        levels: Which yarn each piece belongs to, counted across the sheet.
    """

    ends: Numbers
    share: Values
    starts: Numbers
    levels: Numbers

    def on(self, field: Values) -> Values:
        """Return a field of the mesh, shape (n,) or (n, 2), at the points of the yarns."""
        share = self.share.reshape(-1, *[1] * (field.ndim - 1))
        first, second = field[self.ends[:, 0]], field[self.ends[:, 1]]
        found: Values = (1 - share) * first + share * second
        return found

    def pieces(self, values: Values) -> list[Polyline]:
        """Return values at the points of the yarns, piece by piece."""
        return np.split(values, self.starts[1:]) if len(values) else []


def lay_yarns(mesh: Triangles, direction: Values, spacing: float) -> Yarns:
    """Return equidistant yarns of a family, which end on the edge of the sheet.

    Args:
        mesh: The stored mesh.
        direction: Reference direction of the family, shape (2,).
        spacing: Distance of the yarns in the reference (m).
    """
    across = mesh.points @ np.array([-direction[1], direction[0]])
    along = mesh.points @ direction
    middle = (across.min() + across.max()) / 2
    half = int((across.max() - across.min()) / (2 * spacing))
    # a hair beside the middle: placements may jump across the fibres through corners, and
    # a yarn must not lie on such a line, between its two sides
    places = middle + spacing * (np.arange(-half, half) + 0.5 + 1e-4)
    level, ends, share = _cut(across[mesh.triangles], mesh.triangles, places)
    reach = (1 - share) * along[ends[..., 0]] + share * along[ends[..., 1]]
    ways = np.argsort(reach, axis=1)  # from the first end of each segment to the second
    reach, share = (np.take_along_axis(a, ways, axis=1) for a in (reach, share))
    ends = np.take_along_axis(ends, ways[..., None], axis=1)
    gap = 1e-9 * float(np.ptp(along))
    (order,) = np.nonzero(reach[:, 1] > reach[:, 0] + gap)  # not those at a corner only
    order = order[np.lexsort((reach[order, 0], level[order]))]
    level, reach, share, ends = level[order], reach[order], share[order], ends[order]
    begins = np.ones(len(level), dtype=bool)
    begins[1:] = (level[1:] != level[:-1]) | (reach[1:, 0] > reach[:-1, 1] + gap)
    # a piece is the beginning of each of its segments, and the end of its last one
    closes = np.append(begins[1:], True)[: len(level)]
    kept = np.column_stack([np.ones(len(level), dtype=bool), closes])
    before = np.cumsum(kept.sum(axis=1)) - kept.sum(axis=1)
    return Yarns(ends[kept], share[kept], before[begins], level[begins])


def _cut(across: Values, triangles: Numbers, places: Values) -> tuple[Numbers, Numbers, Values]:
    """Return the segments in which lines cut triangles.

    Args:
        across: Distance of each corner from the first line's family (m), shape (m, 3).
        triangles: Points of each triangle, shape (m, 3).
        places: Distances of the lines, ascending.

    Returns:
        Of each segment the number of its line, shape (k,); both ends of the sides on which
        it begins and ends, shape (k, 2, 2); how far it is along them, shape (k, 2).
    """
    first = np.searchsorted(places, across.min(axis=1))
    count = np.searchsorted(places, across.max(axis=1)) - first
    owner = np.repeat(np.arange(len(triangles)), count)
    level = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + first[owner]
    distance = across[owner] - places[level][:, None]
    distance[np.abs(distance) < 1e-12 * np.ptp(across)] = 0.0  # rounding makes no side
    beyond = distance > 0
    crossed = beyond[:, _SIDES[:, 0]] != beyond[:, _SIDES[:, 1]]
    inside = crossed.sum(axis=1) == 2  # all but those that a corner touches
    level, owner, distance = level[inside], owner[inside], distance[inside]
    sides = _SIDES[np.nonzero(crossed[inside])[1].reshape(-1, 2)]
    start, end = (np.take_along_axis(distance, sides[..., i], axis=1) for i in (0, 1))
    ends = np.take_along_axis(triangles[owner], sides.reshape(-1, 4), axis=1).reshape(-1, 2, 2)
    return level, ends, start / (start - end)


def material_lines(
    mesh: Triangles, direction: Values, displacement: Values, spacing: float
) -> list[Polyline]:
    """Return where equidistant yarns of a family are now.

    Args:
        mesh: The stored mesh.
        direction: Reference direction of the family, shape (2,).
        displacement: Displacement of the family (m), shape (n, 2).
        spacing: Distance of the yarns in the reference (m).

    Returns:
        A polyline for each piece of yarn, each of shape (points, 2), in m.
    """
    yarns = lay_yarns(mesh, direction, spacing)
    return yarns.pieces(yarns.on(mesh.points + displacement))


def outline(mesh: Triangles, displacement: Values | None = None) -> list[Polyline]:
    """Return the edges of the sheet and of its holes, at rest or displaced, in m."""
    surface = mesh.surface()
    surface["displacement"] = np.zeros_like(mesh.points) if displacement is None else displacement
    edges = _joined(surface).extract_feature_edges(
        boundary_edges=True, feature_edges=False, non_manifold_edges=False, manifold_edges=False
    )
    chains = edges.strip(join=True, max_length=10**7)
    moved, found, rest = _moved(chains), [], chains.lines
    while len(rest):
        found.append(moved[rest[1 : rest[0] + 1]])
        rest = rest[rest[0] + 1 :]
    return found


def _joined(mesh: pv.PolyData) -> pv.PolyData:
    """Make one point of all that differ by rounding only; of two values it takes one."""
    tolerance = 1e-9 * float(np.ptp(mesh.points, axis=0).max())
    return mesh.clean(tolerance=tolerance, absolute=True, lines_to_points=False)


def _moved(mesh: pv.PolyData) -> Values:
    """Return where the points are now (m), shape (n, 2)."""
    return np.asarray(mesh.points[:, :2] + mesh["displacement"], dtype=np.float64)


#: Name of the two files, without suffix.
SERIES = "yarns"


def write_yarns(source: RunData, stored: StoredFields) -> list[Path]:
    """Write ``yarns.xdmf`` and ``yarns.h5`` with every stored time.

    A yarn is cut out of the sheet at rest and moves with its own family; its points have all
    scalar fields, those of one family under their names without its number.

    Args:
        source: The run; its fibres must be known.
        stored: Its fields.

    Returns:
        The two files.
    """
    from wovenfab.report.sheet import YARNS_ALONG

    assert source.fibres is not None
    mesh = Triangles(stored.points(), stored.triangles())
    spacing = float(np.ptp(mesh.points, axis=0).max()) / YARNS_ALONG
    families = [lay_yarns(mesh, direction, spacing) for direction in source.fibres]
    rest = np.concatenate([yarns.on(mesh.points) for yarns in families])
    sizes = [len(piece) for y in families for piece in y.pieces(y.share)]
    units = {"points": "m", "family": "1", "yarn": "1"} | _common(stored)
    file = FieldFile(source.directory, SERIES, polylines(sizes), rest, units, moving=True)
    marks = {
        "family": np.repeat([1.0, 2.0], [len(yarns.share) for yarns in families]),
        "yarn": np.concatenate([_numbers(yarns) for yarns in families]),
    }
    for index, (step, time) in enumerate(zip(stored.steps, stored.times, strict=True)):
        moved = [
            yarns.on(mesh.points + stored.field(_of(stored, "displacement", number), index))
            for number, yarns in enumerate(families, 1)
        ]
        fields = {
            name: np.concatenate(
                [
                    yarns.on(stored.field(_of(stored, name, number), index))
                    for number, yarns in enumerate(families, 1)
                ]
            )
            for name in _common(stored)
        }
        file.add(int(step), float(time), {"points": np.concatenate(moved), **marks, **fields})
    return [source.directory / f"{SERIES}.{kind}" for kind in ("xdmf", "h5")]


def _common(stored: StoredFields) -> dict[str, str]:
    """Return names, without the family's number, and units of the scalar fields."""
    from wovenfab.report.sheet import displacements

    vectors = {*displacements(stored), "relative_displacement"}
    return {
        name.removesuffix("_1").removesuffix("_2"): unit
        for name, unit in stored.units.items()
        if name not in vectors
    }


def _of(stored: StoredFields, name: str, family: int) -> str:
    """Return the field of a family, or the one that both share."""
    own = f"{name}_{family}"
    return own if own in stored.units else name


def _numbers(yarns: Yarns) -> Values:
    """Return the number of its yarn at each point."""
    sizes = np.diff([*yarns.starts, len(yarns.share)])
    return np.repeat(yarns.levels, sizes).astype(np.float64)
