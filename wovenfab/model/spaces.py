"""The space of the placements, which may jump across lines of their own fibres.

The energy differentiates chi_a along D_a only, so that chi_a may jump at no cost across
a fibre of family a; where yarns of one family stop being held alike, it does. Along such
lines the nodes of that family are doubled in the dof map: the cells on either side have
their own copy. Where the line touches the edge of the sheet on its way, at a re-entrant corner
or a hole, the cells on that side have two: those before the place and those behind it have no
yarn in common. Kernels are unchanged, and so is everything away from the lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.mesh import Mesh, entities_to_geometry, exterior_facet_indices, meshtags
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.compat import corners_of, index_map_of, space_with
from wovenfab.sheet.tolerance import SAME_DIRECTION, SAME_PLACE

Array = NDArray[np.float64]
Ints = NDArray[np.int32]
#: Lines on which the placement of each family may jump: end points, shape (n, 2, 2), m.
Lines = Sequence[Array]
NO_LINES: Array = np.zeros((0, 2, 2))
#: Copies of a node: on either side of a line, one more where an edge of the sheet touches it.
MOST = 3


@dataclass(frozen=True)
class Placements:
    """The unknowns of one or two placements: blocks of an x and a y component.

    Attributes:
        space: Space of 2 components a placement; its dof map has blocks of two.
        count: 1 or 2.
        positions: Reference position of each block of this rank, shape (n, 2), m.
        blocks: Blocks of each local cell, shape (cells, nodes, count).
        families: For each family the space of its placement alone, whose unknowns have
            the same numbers; with one placement both are the whole space.
        doubled: Number of blocks that lines have added, over all ranks.
    """

    space: fem.FunctionSpace
    count: int
    positions: Array
    blocks: Ints
    families: tuple[fem.FunctionSpace, fem.FunctionSpace]
    doubled: int = 0

    @property
    def spaces(self) -> tuple[fem.FunctionSpace, ...]:
        """All spaces that forms live on."""
        return (self.space,) if self.count == 1 else (self.space, *self.families)

    @property
    def owned(self) -> int:
        """Number of unknowns that this rank owns; they come first."""
        return 2 * int(self.space.dofmap.index_map.size_local)

    @property
    def unknowns(self) -> int:
        """Number of unknowns over all ranks."""
        return 2 * int(self.space.dofmap.index_map.size_global)

    def from_cells(self, rows: Array) -> Array:
        """Return values at this rank's unknowns, with ghosts, from those in its cells; collective.

        A rank may own nodes that are in none of its cells: other ranks send it their values.

        Args:
            rows: Values at the nodes of all local cells, in the order of ``blocks``, x and y.
        """
        own = self.space.mesh.topology.index_map(2).size_local
        rows = rows.reshape(*self.blocks.shape, 2)
        sums, numbers = (fem.Function(self.space).x for _ in range(2))
        for vector, given in ((sums, rows), (numbers, np.ones_like(rows))):
            vector.array.reshape(-1, 2)[self.blocks[:own]] = given[:own]
            vector.scatter_reverse(la.InsertMode.add)
            vector.scatter_forward()
        values: Array = sums.array / numbers.array
        values.reshape(-1, 2)[self.blocks] = rows
        return values

    def on_facets(self, facets: Ints, family: int) -> Ints:
        """Return this rank's blocks of a family on boundary facets; collective.

        Of a doubled node, it is the copy of the cell that the facet belongs to.

        Args:
            facets: Local boundary facets.
            family: 0 or 1; one placement stands for both.
        """
        topology = self.space.mesh.topology
        topology.create_connectivity(1, 2)
        topology.create_connectivity(2, 1)
        cells, sides = topology.connectivity(1, 2), topology.connectivity(2, 1)
        nodes = self.space.element.basix_element.entity_closure_dofs[1]
        mark = fem.Function(self.space)
        for facet in facets:
            cell = cells.links(facet)[0]
            side = int(np.flatnonzero(sides.links(cell) == facet)[0])
            mark.x.array[2 * self.blocks[cell, nodes[side], family % self.count]] = 1.0
        # A rank may have a node of a facet that it does not have itself.
        mark.x.scatter_reverse(la.InsertMode.add)
        mark.x.scatter_forward()
        return np.flatnonzero(mark.x.array[::2]).astype(np.int32)


def placements_on(
    mesh: Mesh, degree: int, count: int, jumps: Lines = (NO_LINES, NO_LINES)
) -> Placements:
    """Return the Lagrange space of the placements; collective.

    Args:
        mesh: Triangles.
        degree: Degree of the elements.
        count: 1 placement for both families, or 2.
        jumps: For each family, lines along facets across which it may jump. One
            placement is differentiated along both families: it never jumps.
    """
    scalar = fem.functionspace(mesh, ("Lagrange", degree))
    element = basix.ufl.element("Lagrange", mesh.basix_cell(), degree, shape=(2 * count,))
    nodes = scalar.dofmap.list
    places = np.ascontiguousarray(scalar.tabulate_dof_coordinates()[:, :2])
    if count == 1:
        space = fem.functionspace(mesh, element)
        return Placements(space, count, places, nodes[:, :, None], (space, space))
    cut = [split_along(scalar, places, np.reshape(lines, (-1, 2, 2))) for lines in jumps]
    return _doubled(scalar, element, places, cut, degree)


def _doubled(
    scalar: fem.FunctionSpace, element: Any, places: Array, cuts: Sequence[SplitNodes], degree: int
) -> Placements:
    """Return the space of two placements with doubled nodes; collective.

    Both families of a node are numbered together, further copies after all others.
    """
    mesh, nodes, old = scalar.mesh, scalar.dofmap.list, scalar.dofmap.index_map
    own, ghosts = old.size_local, old.num_ghosts
    size = 2 * own + sum(int((cut.copies[:own] - 1).sum()) for cut in cuts)
    first = int(mesh.comm.exscan(size) or 0)
    numbers: list[Any] = []  # local numbers of the copies by family
    ghost_numbers, ghost_owners = [], []
    next_own, next_ghost = 2 * own, size
    for family, cut in enumerate(cuts):
        copies = []
        for which in range(MOST):
            there = cut.copies > which
            local = np.full(own + ghosts, -1, dtype=np.int32)
            mine = np.flatnonzero(there[:own])
            local[mine] = 2 * mine + family if which == 0 else next_own + np.arange(len(mine))
            next_own += len(mine) if which else 0
            everywhere = fem.Function(scalar)
            everywhere.x.array[:own] = first + local[:own]
            everywhere.x.scatter_forward()
            theirs = own + np.flatnonzero(there[own:])
            local[theirs] = next_ghost + np.arange(len(theirs))
            next_ghost += len(theirs)
            ghost_numbers.append(everywhere.x.array[theirs])
            ghost_owners.append(old.owners[theirs - own])
            copies.append(local)
        numbers.append(copies)
    index_map = index_map_of(
        mesh.comm,
        size,
        np.rint(np.concatenate(ghost_numbers)).astype(np.int64),
        np.concatenate(ghost_owners).astype(np.int32),
    )
    blocks = np.stack(
        [
            np.choose(cut.which, [local[nodes] for local in copies])
            for cut, copies in zip(cuts, numbers, strict=True)
        ],
        axis=2,
    ).astype(np.int32)
    positions = np.zeros((next_ghost, 2))
    for copies in numbers:
        for local in copies:
            positions[local[local >= 0]] = places[local >= 0]
    doubled = mesh.comm.allreduce(size - 2 * own, op=MPI.SUM)
    space = space_with(mesh, element, index_map, blocks.reshape(len(blocks), -1))
    single = basix.ufl.element("Lagrange", mesh.basix_cell(), degree, shape=(2,))
    first_family, second_family = (
        space_with(mesh, single, index_map, np.ascontiguousarray(blocks[:, :, family]))
        for family in (0, 1)
    )
    families = (first_family, second_family)
    return Placements(space, 2, positions, blocks, families, doubled)


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
    centres = mesh.geometry.x[corners_of(mesh)][:, :, :2].mean(axis=1)
    slack = SAME_PLACE * _extent(mesh)
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
        signs = np.where(np.abs(slopes) < SAME_DIRECTION, 0.0, np.sign(slopes))
        both = _summed(self._scalar, self._nodes, signs)
        sides: NDArray[np.int8] = (np.rint(both) / 2).astype(np.int8)
        return sides


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


CROSSED = 1


def crossed_facets(mesh: Mesh, fibre: NDArray[np.float64]) -> Any:
    """Return the measure of the interior facets that are not parallel to a fibre.

    On a mesh along the fibres this leaves out about a third of the facets.

    Args:
        mesh: Triangles.
        fibre: Unit vector, shape (2,).
    """
    mesh.topology.create_connectivity(1, 2)
    mesh.topology.create_connectivity(2, 1)
    facets = np.arange(_count(mesh, 1), dtype=np.int32)
    ends = mesh.geometry.x[entities_to_geometry(mesh, 1, facets)][:, :, :2]
    way = ends[:, 1] - ends[:, 0]
    across = np.abs(way[:, 0] * fibre[1] - way[:, 1] * fibre[0])
    crossed = facets[across > SAME_DIRECTION * np.linalg.norm(way, axis=1)]
    tags = meshtags(mesh, 1, crossed, np.full(len(crossed), CROSSED, dtype=np.int32))
    return ufl.Measure("dS", domain=mesh, subdomain_data=tags, subdomain_id=CROSSED)


def _count(mesh: Mesh, dimension: int) -> int:
    entities = mesh.topology.index_map(dimension)
    return int(entities.size_local + entities.num_ghosts)
