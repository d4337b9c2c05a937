"""Structured meshes of a rectangle, with its edges named left, right, bottom, top."""

from __future__ import annotations

from math import ceil

import numpy as np
from dolfinx.mesh import (
    DiagonalType,
    GhostMode,
    Mesh,
    MeshTags,
    create_rectangle,
    locate_entities_boundary,
    meshtags,
)
from mpi4py import MPI

PATTERNS = {"crossed": DiagonalType.crossed, "right": DiagonalType.right}


def rectangle(
    comm: MPI.Comm, length: float, width: float, mesh_size: float, pattern: str
) -> tuple[Mesh, MeshTags, dict[str, int]]:
    """Return mesh, facet tags and tag numbers of a structured rectangle.

    Args:
        comm: Communicator.
        length: Extent in x, m.
        width: Extent in y, m.
        mesh_size: Largest side of the squares that are cut into triangles, m.
        pattern: ``crossed`` (four triangles a square) or ``right`` (two).
    """
    # The tolerance keeps 0.9 m / 30 mm at 30 squares in spite of round-off.
    counts = [max(1, ceil(side / mesh_size * (1 - 1e-9))) for side in (length, width)]
    mesh = create_rectangle(
        comm,
        [[0.0, 0.0], [length, width]],
        counts,
        ghost_mode=GhostMode.shared_facet,
        diagonal=PATTERNS[pattern],
    )
    return mesh, *name_edges(mesh, length, width)


def name_edges(mesh: Mesh, length: float, width: float) -> tuple[MeshTags, dict[str, int]]:
    """Return facet tags and tag numbers of the four edges of a rectangle at the origin."""
    slack = 1e-9 * max(length, width)
    on_edge = {
        "left": lambda x: x[0] < slack,
        "right": lambda x: x[0] > length - slack,
        "bottom": lambda x: x[1] < slack,
        "top": lambda x: x[1] > width - slack,
    }
    tags = {name: number for number, name in enumerate(on_edge, start=1)}
    facets = [locate_entities_boundary(mesh, 1, marker) for marker in on_edge.values()]
    values = [np.full_like(f, tag) for f, tag in zip(facets, tags.values(), strict=True)]
    together, marks = np.concatenate(facets), np.concatenate(values)
    order = np.argsort(together, kind="stable")
    return meshtags(mesh, 1, together[order], marks[order]), tags
