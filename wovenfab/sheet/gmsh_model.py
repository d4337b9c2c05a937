"""gmsh as a library: how it is loaded, and the nodes and elements of its present model."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.lacking import load

Array = NDArray[np.float64]
Cells = NDArray[np.int64]


def load_gmsh() -> Any:
    """Return the module, which most scenes need not pay for.

    Raises:
        LackingError: It is missing, or cannot load a library.
    """
    return load("gmsh", "gmsh", "a mesh that does not follow the fibres of a rectangle")


def start(gmsh: Any) -> None:
    """Begin, without a user's .gmshrc, and without messages on the terminal."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)


def nodes_of(gmsh: Any) -> tuple[Array, Cells]:
    """Return the positions of all nodes, shape (n, 3), and the row of each tag."""
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    rows = np.zeros(int(tags.max(initial=0)) + 1, dtype=np.int64)
    rows[tags.astype(np.int64)] = np.arange(len(tags))
    return coordinates.reshape(-1, 3), rows


def cells_of(gmsh: Any, dim: int, entity: int, rows: Cells) -> Cells:
    """Return the rows of the corners of the lines or triangles of an entity, shape (n, dim + 1)."""
    found = [np.zeros((0, dim + 1), dtype=np.int64)]
    kinds, _, nodes = gmsh.model.mesh.getElements(dim, entity)
    for kind, tags in zip(kinds, nodes, strict=True):
        *_, count, _, corners = gmsh.model.mesh.getElementProperties(kind)
        if corners == dim + 1:
            found.append(rows[tags.astype(np.int64).reshape(-1, count)[:, : dim + 1]])
    return np.concatenate(found)
