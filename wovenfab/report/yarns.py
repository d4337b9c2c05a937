"""Yarns as material lines on the stored triangles, in pictures and as a series for ParaView."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from wovenfab.record.field_file import FieldFile, polylines
from wovenfab.record.fields import StoredFields
from wovenfab.record.results import write_whole
from wovenfab.report.run_data import RunData
from wovenfab.report.style import Values

Numbers = NDArray[np.int64]
Polyline = NDArray[np.float64]
#: Number of yarns of a family along the longest side of the sheet, about.
YARNS_ALONG = 30
#: Name of the two files of the series, without suffix, and of the script that shows it.
SERIES, SCRIPT = "yarns", "open_in_paraview.py"
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

    @property
    def length(self) -> float:
        """Longest side of the sheet (m)."""
        return float(np.ptp(self.points, axis=0).max())


@dataclass(frozen=True)
class Yarns:
    """Yarns of one family on the mesh at rest, for all times.

    Each point of a yarn lies on a side of a triangle. A field there is interpolated between
    both ends of the side.

    Attributes:
        ends: Mesh points at the ends of the sides, shape (points, 2).
        share: Place of each point on its side, from 0 to 1, shape (points,).
        starts: Number of the first point of each piece of yarn, ascending from 0.
        levels: Number of the yarn of each piece, counted across the sheet.
    """

    ends: Numbers
    share: Values
    starts: Numbers
    levels: Numbers

    def on(self, field: Values) -> Values:
        """Return a field of the mesh, shape (n,) or (n, 2), at the points of the yarns."""
        share = self.share.reshape(-1, *[1] * (field.ndim - 1))
        first, second = field[self.ends[:, 0]], field[self.ends[:, 1]]
        values: Values = (1 - share) * first + share * second
        return values

    def pieces(self, values: Values) -> list[Polyline]:
        """Return values at the points of the yarns, piece by piece."""
        return np.split(values, self.starts[1:]) if len(values) else []

    def numbers(self) -> Values:
        """Return the number of the yarn at each point."""
        sizes = np.diff([*self.starts, len(self.share)])
        return np.repeat(self.levels, sizes).astype(np.float64)


def lay_yarns(mesh: Triangles, direction: Values, spacing: float) -> Yarns:
    """Return equidistant yarns of a family, from edge to edge of the sheet.

    Args:
        mesh: The stored mesh.
        direction: Reference direction of the family, shape (2,).
        spacing: Distance of the yarns in the reference (m).
    """
    across = mesh.points @ np.array([-direction[1], direction[0]])
    along = mesh.points @ direction
    middle = (across.min() + across.max()) / 2
    half = int((across.max() - across.min()) / (2 * spacing))
    # slightly off the middle: placements may jump across the fibres through corners, and a
    # yarn must not lie on such a line, between its two sides
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
    # the points of a piece: the start of each of its segments, and the end of the last one
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
        it begins and ends, shape (k, 2, 2); its places on these sides, shape (k, 2).
    """
    first = np.searchsorted(places, across.min(axis=1))
    count = np.searchsorted(places, across.max(axis=1)) - first
    owner = np.repeat(np.arange(len(triangles)), count)
    level = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count) + first[owner]
    distance = across[owner] - places[level][:, None]
    distance[np.abs(distance) < 1e-12 * np.ptp(across)] = 0.0  # rounding makes no side
    beyond = distance > 0
    crossed = beyond[:, _SIDES[:, 0]] != beyond[:, _SIDES[:, 1]]
    inside = crossed.sum(axis=1) == 2  # not those touched at a corner
    level, owner, distance = level[inside], owner[inside], distance[inside]
    sides = _SIDES[np.nonzero(crossed[inside])[1].reshape(-1, 2)]
    start, end = (np.take_along_axis(distance, sides[..., i], axis=1) for i in (0, 1))
    ends = np.take_along_axis(triangles[owner], sides.reshape(-1, 4), axis=1).reshape(-1, 2, 2)
    return level, ends, start / (start - end)


def material_lines(
    mesh: Triangles, direction: Values, displacement: Values, spacing: float
) -> list[Polyline]:
    """Return the displaced yarns of :func:`lay_yarns`: a polyline (m) for each piece.

    The displacement (m) is that of the family, shape (n, 2).
    """
    yarns = lay_yarns(mesh, direction, spacing)
    return yarns.pieces(yarns.on(mesh.points + displacement))


def outline(mesh: Triangles, displacement: Values | None = None) -> list[Polyline]:
    """Return the edges of the sheet and of its holes, at rest or displaced, in m.

    Each is a polyline that ends where it began, or where it would meet another one.
    """
    moved = mesh.points if displacement is None else mesh.points + displacement
    one = _same_points(mesh)
    (ax, ay), (bx, by) = (
        np.diff(mesh.points[mesh.triangles[:, [0, i]]], axis=1)[:, 0].T for i in (1, 2)
    )
    turned = np.where((ax * by < ay * bx)[:, None], mesh.triangles[:, ::-1], mesh.triangles)
    sides = turned[:, _SIDES].reshape(-1, 2)  # counter-clockwise: edges follow each other
    ends = np.sort(one[sides], axis=1)
    _, first, count = np.unique(ends, axis=0, return_index=True, return_counts=True)
    alone = sides[first[count == 1]]  # sides of one triangle only
    return [moved[chain] for chain in _chains(alone, one)]


def _same_points(mesh: Triangles) -> Numbers:
    """Return for each point the number of its place, which those have that differ by rounding."""
    pairs = KDTree(mesh.points).query_pairs(1e-9 * mesh.length, output_type="ndarray")
    size = len(mesh.points)
    near = coo_array((np.ones(len(pairs), dtype=bool), pairs.T), shape=(size, size))
    places: Numbers = connected_components(near, directed=False)[1].astype(np.int64)
    return places


def _chains(sides: Numbers, places: Numbers) -> list[Numbers]:
    """Return points in the order in which sides, shape (n, 2), follow each other."""
    at: dict[int, list[int]] = {}
    for number, start in enumerate(places[sides[:, 0]]):
        at.setdefault(int(start), []).append(number)
    chains, left = [], set(range(len(sides)))
    while left:
        number = min(left)
        chain = [sides[number, 0]]
        while True:
            left.discard(number)
            at[int(places[sides[number, 0]])].remove(number)
            chain.append(sides[number, 1])
            following = at.get(int(places[sides[number, 1]]))
            if not following:
                break
            number = following[0]
        chains.append(np.array(chain))
    return chains


def displacements(stored: StoredFields) -> list[str]:
    """Return the names of the displacement fields: one, or one for each family."""
    return sorted(name for name in stored.units if name.split("_")[0] == "displacement")


def write_yarns(source: RunData, stored: StoredFields) -> list[Path]:
    """Write ``yarns.xdmf`` and ``yarns.h5`` with every stored time, and return both.

    A yarn is cut out of the sheet at rest and moves with its own family. Its points have all
    scalar fields; those of one family have its name without the number. The directions of
    the fibres must be known.
    """
    assert source.fibres is not None
    mesh = Triangles(stored.points(), stored.triangles())
    families = [lay_yarns(mesh, fibre, mesh.length / YARNS_ALONG) for fibre in source.fibres]
    rest = np.concatenate([yarns.on(mesh.points) for yarns in families])
    sizes = [len(piece) for y in families for piece in y.pieces(y.share)]
    scalars = _scalars(stored)
    units = {"points": "m", "family": "1", "yarn": "1"} | scalars
    file = FieldFile(source.directory, SERIES, polylines(sizes), rest, units, moving=True)
    numbers = {
        "family": np.repeat([1.0, 2.0], [len(yarns.share) for yarns in families]),
        "yarn": np.concatenate([yarns.numbers() for yarns in families]),
    }

    def on_yarns(name: str, index: int) -> Values:
        """Return a field on the yarns of both families, of each its own where it has one."""
        own = [f"{name}_{i}" if f"{name}_{i}" in stored.units else name for i in (1, 2)]
        parts = [y.on(stored.field(n, index)) for y, n in zip(families, own, strict=True)]
        return np.concatenate(parts)

    for index, (step, time) in enumerate(zip(stored.steps, stored.times, strict=True)):
        fields = {name: on_yarns(name, index) for name in scalars}
        points = rest + on_yarns("displacement", index)
        file.add(int(step), float(time), {"points": points, **numbers, **fields})
    file.finish()
    return [source.directory / f"{SERIES}.{kind}" for kind in ("xdmf", "h5")]


def write_viewer(directory: Path) -> Path:
    """Write the script that shows a run in ParaView into its directory and return its path.

    The script finds the results beside itself. Inside ParaView's window a script does not
    know its own path, so it also has the path of the results.
    """
    text = (Path(__file__).parent / SCRIPT).read_text(encoding="utf-8")
    results = f"RESULTS = {str(directory.resolve())!r}"
    path = directory / SCRIPT
    write_whole(path, text.replace('RESULTS = ""', results, 1))
    return path


def _scalars(stored: StoredFields) -> dict[str, str]:
    """Return names, without the family's number, and units of the scalar fields."""
    vectors = {*displacements(stored), "relative_displacement"}
    return {
        name.removesuffix("_1").removesuffix("_2"): unit
        for name, unit in stored.units.items()
        if name not in vectors
    }
