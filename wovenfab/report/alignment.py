"""Where the points of a cloud lie on the sheet: the camera's coordinates, moved positions.

A camera has coordinates of its own. A rotation and a translation bring a point x to R x + t on the
sheet, and its displacement to R u. Both are found by least squares: the distances of R u from the
displacement that was computed at R x + t, and those of R x + t from the sheet. The search starts
from many angles and places, since there are wrong minima.

Positions are those at rest, or those of the points as they have moved, x + u.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.optimize import least_squares
from scipy.spatial import KDTree

from wovenfab.measured.cloud import MeasuredCloud
from wovenfab.record.fields import StoredFields
from wovenfab.report.yarns import displacements

Array = NDArray[np.float64]
#: What positions of a cloud may be: found out, at rest, moved.
POSITIONS = ("auto", "rest", "moved")
#: Angles and places along each side from which the search starts, and the best of them that are
#: followed to their ends.
ANGLES, PLACES, FOLLOWED = 36, 7, 8
#: Points that the first look at all starts takes, and the search.
FEW, MANY = 80, 600
#: Angle (rad) from which on two ends of a search are different ones.
APART = 0.1
#: Square of the distances, over the least one, up to which another end fits as well.
AS_WELL = 2.0
#: Standard error of a place over the size of the sheet, or of an angle in rad, from which on the
#: displacements do not tell it.
VAGUE = 0.05
#: Share of points beside the sheet that says that they cannot lie so, and that of the other way.
BESIDE, FEWER = 0.02, 0.25
#: Distances over the largest displacement from which on a mirrored cloud is tried, too.
POOR = 0.02
#: Distances of moved positions over those at rest from which on both fit as well, and up to which
#: they are moved ones whatever the model's error.
SAME, CLEAR = 0.9, 0.25


class AlignmentError(ValueError):
    """The displacements do not tell how the camera's coordinates lie."""


@dataclass(frozen=True)
class Rigid:
    """A rotation and a translation in the plane.

    Attributes:
        angle: Rotation, rad.
        shift: Translation after it, m, shape (2,).
        error: Standard errors of both by the scatter of the distances: rad, m, m.
        rms: Root mean square of the distances that are left, m.
    """

    angle: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    error: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rms: float = 0.0

    @property
    def rotation(self) -> Array:
        """The matrix R, shape (2, 2)."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.array([[c, -s], [s, c]])

    def __call__(self, cloud: MeasuredCloud) -> MeasuredCloud:
        """Return a cloud in the coordinates of the sheet."""
        turned = self.rotation.T
        points = cloud.points @ turned + np.array(self.shift)
        return replace(cloud, points=points, displacements=cloud.displacements @ turned)

    def __str__(self) -> str:
        """Return angle and translation in words."""
        (x, y), (da, dx, dy) = (1e3 * np.array(self.shift)), np.array(self.error)
        return (
            f"the camera's coordinates are turned by {np.degrees(self.angle):.3f} +- "
            f"{np.degrees(da):.1g} degrees, and their origin is at x = {x:.4f} +- {1e3 * dx:.1g} "
            f"mm, y = {y:.4f} +- {1e3 * dy:.1g} mm of the sheet"
        )


@dataclass(frozen=True)
class Placed:
    """A cloud on the sheet at rest.

    Attributes:
        cloud: With positions at rest in the coordinates of the sheet.
        notes: Sentences on what was found.
    """

    cloud: MeasuredCloud
    notes: tuple[str, ...]


class SheetField:
    """The computed displacement at a stored time, the mean of the families, anywhere.

    Beside the sheet it is that at its nearest point.
    """

    def __init__(self, stored: StoredFields, index: int) -> None:
        """Look up the fields of a stored time.

        Raises:
            ValueError: The run stored no displacement.
        """
        names = displacements(stored)
        if not names:
            raise ValueError("the run stored no displacement: add it to output.fields")
        self._stored, self._names, self._index = stored, names, index
        self._nodes = stored.points()
        self._values = np.mean([stored.field(name, index) for name in names], axis=0)
        self._tree = KDTree(self._nodes)
        self._linear = LinearNDInterpolator(self._nodes, self._values)
        self._sheet = shapely.union_all(shapely.polygons(stored.corners()))
        shapely.prepare(self._sheet)
        self.size = float(np.linalg.norm(np.ptp(self._nodes, axis=0)))

    @property
    def middle(self) -> Array:
        """Middle of the sheet's extent, m."""
        ends: Array = (self._nodes.min(axis=0) + self._nodes.max(axis=0)) / 2
        return ends

    @property
    def extent(self) -> Array:
        """Length along x and along y, m."""
        sides: Array = np.ptp(self._nodes, axis=0)
        return sides

    def nearest(self, points: Array) -> Array:
        """Return the displacement of the nearest node, m, shape (n, 2)."""
        return np.asarray(self._values[self._tree.query(points)[1]])

    def roughly(self, points: Array) -> tuple[Array, Array]:
        """Return the displacement between nodes, as for a convex sheet, and the distance from it.

        Much quicker than :meth:`at`; the distance is that to the nearest node, m, shape (n, 1).
        """
        values = np.asarray(self._linear(points))
        off = ~np.isfinite(values).all(axis=1)
        distance, nearest = self._tree.query(points[off])
        values[off] = self._values[nearest]
        far = np.zeros((len(points), 1))
        far[off, 0] = distance
        return values, far

    def at(self, points: Array) -> tuple[Array, Array]:
        """Return the displacement, and how far (m) points are from the sheet, shapes (n, 2)."""
        flat = shapely.points(points)
        on = shapely.distance(flat, self._sheet) == 0.0
        places = points.copy()
        if not on.all():
            lines = shapely.shortest_line(self._sheet, flat[~on])
            places[~on] = shapely.get_coordinates(shapely.get_point(lines, 0))
        at = self._stored.at(places)
        values = np.mean([at(name, self._index) for name in self._names], axis=0)
        if (lacking := ~np.isfinite(values).all(axis=1)).any():  # at an edge, by rounding
            values[lacking] = self.nearest(places[lacking])
        return values, points - places


def placed(
    stored: StoredFields,
    index: int,
    cloud: MeasuredCloud,
    align: bool = False,
    positions: str = "auto",
) -> Placed:
    """Return a cloud on the sheet at rest.

    Args:
        stored: The fields of a run.
        index: The stored time that the cloud is of.
        cloud: As it was measured.
        align: Find rotation and translation of the camera's coordinates.
        positions: Whether they are those at rest or moved, one of :data:`POSITIONS`.

    Raises:
        AlignmentError: The displacements do not tell rotation and translation.
        ValueError: The run stored no displacement.
    """
    field = SheetField(stored, index)
    before = replace(cloud, points=cloud.points - cloud.displacements)
    kinds = {"rest": cloud, "moved": before}
    tried = {name: kinds[name] for name in kinds if positions in ("auto", name)}
    found: dict[str, tuple[Rigid | None, MeasuredCloud]] = {}
    for number, (name, one) in enumerate(tried.items(), 1):
        try:
            motion = _aligned(field, one) if align else None
        except AlignmentError:
            if number == len(tried) and not found:
                raise
            continue
        found[name] = motion, motion(one) if motion else one
    name, words = (next(iter(found)), []) if len(found) == 1 else _which(field, found)
    motion, best = found[name]
    notes = [f"points where the correlation was lost, left out: {cloud.lost}"] * bool(cloud.lost)
    notes += words
    if motion is not None:
        notes.append(f"aligned: {motion}")
        poor = motion.rms > POOR * np.abs(cloud.displacements).max()
        other = _mirrored(field, tried[name]) if poor else None
        if other is not None and other.rms < motion.rms / AS_WELL:
            notes.append(
                f"mirrored, the distances would be {1e3 * other.rms:.3g} mm in place of "
                f"{1e3 * motion.rms:.3g} mm (root mean square): if the camera sees the back of the "
                "sheet, or rows of its picture count downwards, give y and uy units of the other "
                'sign, as in --units "y=-1 mm,uy=-1 mm"'
            )
    return Placed(best, tuple(notes))


def _mirrored(field: SheetField, cloud: MeasuredCloud) -> Rigid | None:
    """Return how a cloud lies that is seen from behind; None if that is not told."""
    flip = np.array([1.0, -1.0])
    turned = replace(cloud, points=cloud.points * flip, displacements=cloud.displacements * flip)
    try:
        return _aligned(field, turned)
    except AlignmentError:
        return None


def _which(
    field: SheetField, found: dict[str, tuple[Rigid | None, MeasuredCloud]]
) -> tuple[str, list[str]]:
    """Return whether positions are at rest or moved, and what is to be said of it."""
    beside, rms = {}, {}
    for name, (_, cloud) in found.items():
        values, off = field.at(cloud.points)
        away = np.linalg.norm(off, axis=1) > 1e-6 * field.size
        beside[name] = float(away.mean())
        distance = (cloud.displacements - values)[~away]
        rms[name] = float(np.sqrt((distance**2).sum(axis=1).mean())) if distance.size else np.inf
    counts = {n: round(beside[n] * len(c.points)) for n, (_, c) in found.items()}
    told = (
        f"{counts['rest']} of {len(found['rest'][1].points)} points are beside the sheet as "
        f"positions at rest, {counts['moved']} as moved ones"
    )
    for name, other in (("moved", "rest"), ("rest", "moved")):
        if beside[other] > BESIDE and beside[name] < FEWER * beside[other]:
            if name == "moved":
                return name, [f"positions are moved ones, and were moved back: {told}"]
            return name, []
    if not rms["moved"] < SAME * rms["rest"]:  # displacements are small, or fit better at rest
        return "rest", []
    distances = (
        f"distances are {1e3 * rms['rest']:.3g} mm as positions at rest and "
        f"{1e3 * rms['moved']:.3g} mm as moved ones (root mean square)"
    )
    if rms["moved"] < CLEAR * rms["rest"]:
        return "moved", [f"positions are moved ones, and were moved back: {told}; {distances}"]
    return "rest", [
        f"positions are taken as those at rest, but the sheet's edges do not tell ({told}): "
        f"{distances}; --positions moved takes these"
    ]


def _aligned(field: SheetField, cloud: MeasuredCloud) -> Rigid:
    """Return the rotation and translation of least squares.

    Raises:
        AlignmentError: They are not told, or another one fits as well.
    """
    chosen = np.random.default_rng(0).permutation(len(cloud.points))
    few, many = (_part(cloud, chosen[:n]) for n in (FEW, MANY))
    middle = cloud.points.mean(axis=0)

    def residuals(of: MeasuredCloud, rough: bool) -> Callable[[Array], Array]:
        def at(q: Array) -> Array:
            turned = Rigid(float(q[0])).rotation.T
            points = (of.points - middle) @ turned + q[1:]
            if rough:
                values, far = field.roughly(points)
                return np.column_stack([of.displacements @ turned - values, far]).ravel()
            values, off = field.at(points)
            return np.column_stack([of.displacements @ turned - values, off]).ravel()

        return at

    first = residuals(few, rough=True)
    shares = (np.arange(PLACES) + 0.5) / PLACES - 0.5
    starts = [
        np.array([a, *(field.middle + field.extent * [sx, sy])])
        for a in np.linspace(-np.pi, np.pi, ANGLES, endpoint=False)
        for sx in shares
        for sy in shares
    ]
    costs = np.array([np.abs(first(q)).sum() for q in starts])
    best = [starts[i] for i in _apart(np.argsort(costs), np.array(starts), FOLLOWED)]
    spread = float(np.median(np.abs(first(starts[int(costs.argmin())])))) + 1e-9 * field.size
    scale = np.array([1.0, field.size, field.size])
    ends = [least_squares(first, q, loss="soft_l1", f_scale=spread, x_scale=scale) for q in best]
    q = min(ends, key=lambda end: float(end.cost)).x
    full = residuals(many, False)
    end = least_squares(full, q, x_scale=scale)
    square = 2 * float(end.cost)
    noise = 1e-12 * field.size**2 * len(many.points)
    for other in ends:
        turn = np.angle(np.exp(1j * (other.x[0] - end.x[0])))
        if abs(turn) > APART and float((full(other.x) ** 2).sum()) < AS_WELL * square + noise:
            raise AlignmentError(
                "the camera's coordinates cannot be found: turned by "
                f"{np.degrees(end.x[0]):.0f} and by {np.degrees(other.x[0]):.0f} degrees the "
                "displacements fit as well. Turn them by hand, or compare at a larger displacement"
            )
    angle, shift = float(np.angle(np.exp(1j * end.x[0]))), end.x[1:]
    error = _errors(end.jac / (1 / scale), square / max(end.fun.size - 3, 1)) * scale
    if not (error / scale < VAGUE).all():
        raise AlignmentError(
            "the camera's coordinates cannot be found: the displacements are too uniform to tell "
            "where on the sheet they were measured. Compare at a larger displacement, or add what "
            "the origins differ by"
        )
    origin = shift - Rigid(angle).rotation @ middle
    rms = float(np.sqrt(square / len(many.points)))
    da, dx, dy = map(float, error)
    return Rigid(angle, (float(origin[0]), float(origin[1])), (da, dx, dy), rms)


def _errors(jacobian: Array, variance: float) -> Array:
    """Return the standard errors of least squares; infinite of what has no effect."""
    _, singular, directions = np.linalg.svd(jacobian, full_matrices=False)
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = np.where(directions == 0, 0.0, directions / singular[:, None])
    return np.asarray(np.sqrt(variance * (parts**2).sum(axis=0)))


def _part(cloud: MeasuredCloud, rows: NDArray[np.intp]) -> MeasuredCloud:
    return replace(cloud, points=cloud.points[rows], displacements=cloud.displacements[rows])


def _apart(order: NDArray[np.intp], starts: Array, count: int) -> list[int]:
    """Return the first few numbers of an order, not more than two of each angle."""
    found: list[int] = []
    per_angle: dict[float, int] = {}
    for i in order:
        angle = round(float(starts[i, 0]), 6)
        if per_angle.get(angle, 0) < 2:
            per_angle[angle] = per_angle.get(angle, 0) + 1
            found.append(int(i))
        if len(found) == count:
            break
    return found
