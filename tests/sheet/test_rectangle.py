"""Structured rectangles: named edges, and forces that no numbering or rotation changes."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np
import pytest
from dolfinx.mesh import (
    create_mesh,
    entities_to_geometry,
    locate_entities_boundary,
    meshtags,
)
from mpi4py import MPI

from tests import scenes
from tests.outlines import EDGES, LENGTHS, assert_edges, fibres_at
from wovenfab.compat import corners_of
from wovenfab.model.constraints import Grip, Held
from wovenfab.sheet.sheet import Sheet


@pytest.mark.parametrize("pattern", ["crossed", "right"])
def test_edges_have_their_names_and_lengths_and_cover_the_boundary(pattern: str) -> None:
    on = scenes.sheet(mesh_size=0.07, pattern=pattern)
    assert_edges(on, LENGTHS)
    assert len(np.unique(on.facets.indices)) == len(on.facets.indices)


@pytest.mark.parametrize("edge", EDGES)
def test_an_edge_lies_where_its_name_says(edge: str) -> None:
    on, (axis, place, _) = scenes.sheet(), EDGES[edge]
    nodes = entities_to_geometry(on.mesh, 1, on.edge_facets(edge))
    assert on.mesh.geometry.x[nodes][..., axis] == pytest.approx(place, abs=1e-12)


def test_cells_are_no_larger_than_asked_and_round_off_adds_none() -> None:
    for size, squares in ((0.3, 3), (0.1, 27), (0.07, 13 * 5), (0.9 / 36, 36 * 12)):
        on = scenes.sheet(mesh_size=size, pattern="right")
        assert on.mesh.topology.index_map(2).size_global == 2 * squares


def rebuilt(on: Sheet, move: np.ndarray, fibres: np.ndarray, seed: int | None) -> Sheet:
    """Return the sheet with nodes mapped by ``move`` and, with a seed, numbered at random."""
    points, cells = on.mesh.geometry.x[:, :2], corners_of(on.mesh).astype(np.int64)
    if seed is not None:
        random = np.random.default_rng(seed)
        order = random.permutation(len(points))
        points, cells = points[order], np.argsort(order)[cells]
        cells = random.permuted(cells[random.permutation(len(cells))], axis=1)
    element = on.mesh.ufl_domain().ufl_coordinate_element()
    mesh = create_mesh(
        MPI.COMM_SELF, cells=cells, x=np.ascontiguousarray(points @ move.T), e=element
    )
    back = np.linalg.inv(move)
    marked = {
        name: locate_entities_boundary(
            mesh, 1, lambda x, a=axis, p=place: np.isclose((back @ x[:2])[a], p)
        )
        for name, (axis, place, _) in EDGES.items()
    }
    facets = np.concatenate(list(marked.values()))
    values = np.concatenate([np.full_like(f, i) for i, f in enumerate(marked.values())])
    order = np.argsort(facets)
    tags = meshtags(mesh, 1, facets[order], values[order])
    return Sheet(mesh, tags, {name: i for i, name in enumerate(marked)}, fibres)


def along_axis(angle: float) -> tuple[Grip, ...]:
    pull = (Held(cos(angle)), Held(sin(angle)))
    return Grip("left", scenes.CLAMP), Grip("right", pull)


@pytest.mark.parametrize("names", [scenes.BONDED, scenes.COUPLED], ids=["one", "two placements"])
@pytest.mark.parametrize("seed", [51, 52])
def test_the_force_does_not_depend_on_the_numbering(names: tuple[str, ...], seed: int) -> None:
    on = scenes.sheet(mesh_size=0.1, pattern="right", comm=MPI.COMM_SELF)
    mixed_up = rebuilt(on, np.eye(2), on.fibres, seed)
    forces = [
        scenes.force(scenes.model(s, names, scenes.PROTOTYPE), scenes.PULL, 0.04)["right"]
        for s in (on, mixed_up)
    ]
    assert forces[1] == pytest.approx(forces[0], rel=1e-9, abs=1e-9 * forces[0][0])


@pytest.mark.parametrize("names", [scenes.BONDED, scenes.COUPLED], ids=["one", "two placements"])
def test_the_force_turns_with_the_sheet(names: tuple[str, ...]) -> None:
    angle = pi / 6
    on = scenes.sheet(mesh_size=0.1, pattern="right", comm=MPI.COMM_SELF)
    turn = np.array([[cos(angle), -sin(angle)], [sin(angle), cos(angle)]])
    fibres = fibres_at((75, -15))
    assert fibres == pytest.approx(on.fibres @ turn.T, abs=1e-15)
    turned = rebuilt(on, turn, fibres, 53)
    straight = scenes.force(scenes.model(on, names, scenes.PROTOTYPE), along_axis(0.0), 0.04)
    oblique = scenes.force(scenes.model(turned, names, scenes.PROTOTYPE), along_axis(angle), 0.04)
    for edge in ("left", "right"):
        expected = turn @ straight[edge]
        size = np.linalg.norm(expected)
        assert oblique[edge] == pytest.approx(expected, rel=1e-9, abs=1e-9 * size)
