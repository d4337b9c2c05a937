"""The reaction of a corner that two held edges share, divided between them.

The nodal force of a corner c is r_c = int_A t phi_c + int_B t phi_c, with the traction t on the
edges A and B and the shape function phi_c. On edge B a combination w = phi_c + sum_j a_j phi_j of
shape functions of the nodes next to the corner is made orthogonal to all polynomials below the
degree of the elements, so that int_B t w is of higher order. What is left of r_c + sum_j a_j r_j
is then the share of A, and likewise that of B. What both differ from r_c is divided equally.
The shares converge one order faster than the traction does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from wovenfab.model.spaces import Placements
from wovenfab.sheet.sheet import Sheet

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
#: Facets of an edge next to a corner whose nodes take part: those of one are too few for degree 1.
FACETS = 2


@dataclass(frozen=True)
class Claim:
    """One component of one placement that is held on an edge.

    Attributes:
        edge: Name of the edge.
        family: 0 or 1; 0 for one placement.
        component: 0 for x, 1 for y.
    """

    edge: str
    family: int
    component: int


@dataclass(frozen=True)
class Share:
    """What an edge gives of the reaction of a corner to another one.

    Attributes:
        taken, given: Edge that has all of the corner's force, and the one that gets a part.
        component: 0 for x, 1 for y.
        unknowns: This rank's own unknowns that take part.
        weights: Weights of their forces in the part.
    """

    taken: str
    given: str
    component: int
    unknowns: Ints
    weights: Array


#: Facets of an edge by row: blocks over all ranks, shape (n, nodes), and positions of them.
_Facets = tuple[Ints, Array]


def corner_shares(placements: Placements, sheet: Sheet, claims: Sequence[Claim]) -> list[Share]:
    """Return how the reactions of shared corners are divided; collective.

    Args:
        placements: The unknowns.
        sheet: The sheet with its named edges.
        claims: What edges hold; a shared unknown belongs to the first one.
    """
    pairs = [
        (a, b)
        for i, a in enumerate(claims)
        for b in claims[i + 1 :]
        if a.edge != b.edge and (a.family, a.component) == (b.family, b.component)
    ]
    if not pairs:
        return []
    facets = {
        key: _facets_on(placements, sheet, *key)
        for key in dict.fromkeys((c.edge, c.family) for pair in pairs for c in pair)
    }
    shares = []
    for a, b in pairs:
        sides = facets[a.edge, a.family], facets[b.edge, b.family]
        for corner in np.intersect1d(sides[0][0], sides[1][0]):
            blocks, weights = _part_of_second(int(corner), sides)
            mine = _local(placements, blocks)
            own = mine >= 0
            unknowns = 2 * mine[own] + b.component
            shares.append(Share(a.edge, b.edge, a.component, unknowns, weights[own]))
    return shares


def _part_of_second(corner: int, sides: tuple[_Facets, _Facets]) -> tuple[Ints, Array]:
    """Return blocks and weights of the part of a corner's force that the second edge gets."""
    (on_first, a), (on_second, b) = (_orthogonal(corner, *side) for side in sides)
    blocks = np.concatenate([[corner], on_first, on_second])
    return blocks, np.concatenate([[0.5], 0.5 * a, -0.5 * b])


def _orthogonal(corner: int, blocks: Ints, places: Array) -> tuple[Ints, Array]:
    """Return nodes of an edge next to a corner, and their a_j.

    Args:
        corner: Block of the corner.
        blocks: Blocks of the facets of the edge, vertices first, shape (n, degree + 1).
        places: Their positions, shape (n, degree + 1, 2), m.
    """
    degree, start, last = blocks.shape[1] - 1, 0.0, corner
    moments: dict[int, Array] = {}
    chain = list(_chain(corner, blocks, places))
    length = sum(size for _, _, size in chain)
    points, weights = leggauss(degree + 1)
    for nodes, along, size in chain:
        at, shape = (points + 1) / 2, along[:, None] ** np.arange(degree + 1)
        values = at[:, None] ** np.arange(degree + 1) @ np.linalg.inv(shape)
        powers = ((start + size * at) / length)[:, None] ** np.arange(degree)
        for node, integral in zip(nodes, (values * weights[:, None]).T @ powers, strict=True):
            moments[node] = np.asarray(moments.get(node, 0.0) + size / length * integral)
        start, last = start + size, nodes[1]
    nodes = [node for node in moments if node not in (corner, last)]
    if not nodes:
        return np.array([], dtype=np.int64), np.array([])
    known = slice(0, min(degree, len(nodes)))
    matrix = np.array([moments[node][known] for node in nodes]).T
    return np.array(nodes), np.linalg.lstsq(matrix, -moments[corner][known], rcond=None)[0]


def _chain(corner: int, blocks: Ints, places: Array) -> Iterator[tuple[list[int], Array, float]]:
    """Yield nodes, positions along it from 0 to 1, and length of the facets from a corner on.

    The first node is the one nearer to the corner, the second one the farther end.
    """
    used: set[int] = set()
    for _ in range(FACETS):
        at_corner = (blocks[:, :2] == corner).any(axis=1)
        found = next((int(i) for i in np.flatnonzero(at_corner) if i not in used), None)
        if found is None:
            return
        used.add(found)
        row, where = blocks[found], places[found]
        order = [0, 1] if row[0] == corner else [1, 0]
        order += range(2, len(row))
        ends = where[order[:2]]
        size = float(np.linalg.norm(ends[1] - ends[0]))
        along = (where[order] - ends[0]) @ (ends[1] - ends[0]) / size**2
        corner = int(row[order[1]])
        yield [int(node) for node in row[order]], along, size


def _facets_on(placements: Placements, sheet: Sheet, edge: str, family: int) -> _Facets:
    """Return all facets of an edge over all ranks; collective."""
    topology = sheet.mesh.topology
    topology.create_connectivity(1, 2)
    topology.create_connectivity(2, 1)
    cells, sides = topology.connectivity(1, 2), topology.connectivity(2, 1)
    closure = placements.space.element.basix_element.entity_closure_dofs[1]
    rows = []
    for facet in sheet.edge_facets(edge):
        cell = cells.links(facet)[0]
        if cell < topology.index_map(2).size_local:
            side = int(np.flatnonzero(sides.links(cell) == facet)[0])
            rows.append(placements.blocks[cell, closure[side], family])
    local = np.array(rows, dtype=np.int32).reshape(-1, len(closure[0]))
    numbers = placements.space.dofmap.index_map.local_to_global(local.ravel())
    mine = numbers.reshape(local.shape), placements.positions[local]
    blocks, places = zip(*sheet.mesh.comm.allgather(mine), strict=True)
    return np.concatenate(blocks), np.concatenate(places)


def _local(placements: Placements, blocks: Ints) -> Ints:
    """Return this rank's own numbers of blocks, negative for those of other ranks."""
    index_map = placements.space.dofmap.index_map
    first, end = index_map.local_range
    return np.where((blocks >= first) & (blocks < end), blocks - first, -1)
