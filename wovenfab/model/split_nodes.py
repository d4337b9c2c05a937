"""Where the nodes of a family have several copies, and which cell sees which.

On a line across which the placement may jump, the cells on either side have their own copy of
a node. Where the line touches the edge of the sheet on its way, at a re-entrant corner or a
hole, the cells on that side have two: those before the place and those behind it have no
yarn in common.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx import fem, la
from dolfinx.mesh import Mesh, exterior_facet_indices
from mpi4py import MPI
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: Largest distance of a node from a line that it lies on, as a share of the largest coordinate.
ON_LINE = 1e-8
#: Sine of the angle below which an edge runs along a line.
ALONG = 1e-6
#: Copies of a node: on either side of a line, one more where an edge of the sheet touches it.
MOST = 3


@dataclass(frozen=True)
class SplitNodes:
    """The copies of one family's nodes.

    Attributes:
        copies: Number of copies of each local node.
        which: For each local cell and node, the copy that it uses.
    """

    copies: NDArray[np.int8]
    which: NDArray[np.int8]


def split_along(scalar: fem.FunctionSpace, places: Array, lines: Array) -> SplitNodes:
    """Cut along lines; collective.

    Args:
        scalar: Space of the nodes.
        places: Their positions, shape (n, 2), m.
        lines: End points, shape (lines, 2, 2), m; they run along facets.
    """
    mesh, nodes = scalar.mesh, scalar.dofmap.list
    centres = mesh.geometry.x[mesh.geometry.dofmap][:, :, :2].mean(axis=1)
    slack = ON_LINE * _extent(mesh)
    copies, which = np.ones(len(places), dtype=np.int8), np.zeros(nodes.shape, dtype=np.int8)
    outline = _Outline(scalar, places)
    own = mesh.topology.index_map(2).size_local
    for start, end in lines:
        length = np.linalg.norm(end - start)
        ahead = (end - start) / length
        ahead *= 1.0 if tuple(ahead) > (0.0, 0.0) else -1.0  # parts of a line have equal sides
        across = np.array([-ahead[1], ahead[0]])
        from_middle = places - (start + end) / 2
        on = np.abs(from_middle @ across) < slack
        on &= np.abs(from_middle @ ahead) < length / 2 + slack
        left = (centres - start) @ across > 0
        # The end of a line may be seen from one side only, where the sheet ends.
        for side in (left, ~left):
            seen = np.unique(nodes[:own][side[:own]])
            on &= _summed(scalar, seen, np.ones(len(seen))) > 0
        touched = outline.touches(across)
        copies[on] = np.where(touched[on] == 0, 2, MOST)
        which[on[nodes] & left[:, None]] = 1
        behind = on[nodes] & (touched[nodes] == np.where(left, 1, -1)[:, None])
        (out_x, out_y), (x, y) = outline.out[nodes].T, (centres[:, None] - places[nodes]).T
        behind &= (out_x * y - out_y * x > 0).T
        which[behind] = MOST - 1
    return SplitNodes(copies, which)


class _Outline:
    """The edges of the sheet about each node.

    Attributes:
        out: Sum of the directions of the two edges at a vertex of the outline, which leads
            out of the sheet at a re-entrant corner; shape (nodes, 2).
    """

    def __init__(self, scalar: fem.FunctionSpace, places: Array) -> None:
        self._scalar = scalar
        topology, nodes = scalar.mesh.topology, scalar.dofmap.list
        topology.create_connectivity(1, 2)
        topology.create_connectivity(2, 1)
        cells, sides = topology.connectivity(1, 2), topology.connectivity(2, 1)
        vertices = np.ravel(scalar.element.basix_element.entity_dofs[0])
        ends = []
        for facet in exterior_facet_indices(topology):
            cell = cells.links(facet)[0]
            opposite = int(np.flatnonzero(sides.links(cell) == facet)[0])
            ends.append(np.delete(nodes[cell, vertices], opposite))
        one, other = np.reshape(ends, (-1, 2)).astype(np.int32).T
        along = places[other] - places[one]
        along /= np.linalg.norm(along, axis=1)[:, None]
        self._nodes, self._directions = np.concatenate([one, other]), np.vstack([along, -along])
        self.out = np.stack(
            [_summed(scalar, self._nodes, component) for component in self._directions.T], axis=1
        )

    def touches(self, across: Array) -> NDArray[np.int8]:
        """Return where both edges at a node lie on one side of a line through it; collective.

        Args:
            across: Normal of the line.

        Returns:
            For each local node 1 where they do on the side of the normal, -1 where on the
            other side, else 0.
        """
        slopes = self._directions @ across
        signs = np.where(np.abs(slopes) < ALONG, 0.0, np.sign(slopes))
        both = _summed(self._scalar, self._nodes, signs)
        found: NDArray[np.int8] = (np.rint(both) / 2).astype(np.int8)
        return found


def _summed(scalar: fem.FunctionSpace, nodes: NDArray[np.int32], values: Array) -> Array:
    """Return the sum of values at local nodes over all ranks that have some; collective."""
    total = fem.Function(scalar)
    np.add.at(total.x.array, nodes, values)
    total.x.scatter_reverse(la.InsertMode.add)
    total.x.scatter_forward()
    return np.array(total.x.array)


def _extent(mesh: Mesh) -> float:
    """Return the largest distance from the origin, which rounds all positions; collective."""
    return float(mesh.comm.allreduce(np.abs(mesh.geometry.x).max(initial=0.0), op=MPI.MAX))
