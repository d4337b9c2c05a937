"""Material lines and the outline of a sheet, from the triangles on which fields are stored."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Polyline = NDArray[np.float64]


@dataclass(frozen=True)
class Triangles:
    """The stored mesh.

    Attributes:
        points: Reference points (m), shape (n, 2); each cell has its own.
        triangles: Points of each triangle, shape (m, 3).
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]

    def surface(self) -> pv.PolyData:
        """Return the mesh as VTK has it."""
        space = np.column_stack([self.points, np.zeros(len(self.points))])
        faces = np.column_stack([np.full(len(self.triangles), 3), self.triangles])
        return pv.PolyData(space, faces.ravel())


def material_lines(
    mesh: Triangles,
    direction: NDArray[np.float64],
    displacement: NDArray[np.float64],
    spacing: float,
) -> list[Polyline]:
    """Return where equidistant yarns of a family are now.

    The lines are cut from the triangles exactly, so that they end on the edge of the sheet.

    Args:
        mesh: The stored mesh.
        direction: Reference direction of the family, shape (2,).
        displacement: Displacement of the family (m), shape (n, 2).
        spacing: Distance of the yarns in the reference (m).

    Returns:
        A polyline for each piece of yarn, each of shape (points, 2), in m.
    """
    across = mesh.points @ np.array([-direction[1], direction[0]])
    middle = (across.min() + across.max()) / 2
    half = int((across.max() - across.min()) / (2 * spacing))
    # a hair beside the middle: placements may jump across the fibres through corners, and
    # a yarn must not lie on such a line, between its two sides
    values = middle + spacing * (np.arange(-half, half) + 0.5 + 1e-4)
    surface = mesh.surface()
    surface["across"] = across
    surface["displacement"] = displacement
    cut = surface.contour(values.tolist(), scalars="across")
    if not cut.n_points:
        return []
    joined = _joined(cut)
    ends = joined.lines.reshape(-1, 3)[:, 1:]
    links = coo_array((np.ones(len(ends)), ends.T), shape=(joined.n_points, joined.n_points))
    _, piece = connected_components(links, directed=False)
    along = np.lexsort((joined.points[:, :2] @ direction, piece))
    moved = _moved(joined)[along]
    return np.split(moved, np.flatnonzero(np.diff(piece[along])) + 1)


def outline(mesh: Triangles, displacement: NDArray[np.float64] | None = None) -> list[Polyline]:
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


def _moved(mesh: pv.PolyData) -> NDArray[np.float64]:
    """Return where the points are now (m), shape (n, 2)."""
    return np.asarray(mesh.points[:, :2] + mesh["displacement"], dtype=np.float64)
