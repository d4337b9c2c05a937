"""Which motions without energy the held edges of a rectangle leave to the sheet."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .boundary import Boundary, conditions_of

Array = npt.NDArray[np.float64]

#: End points of the edges of a rectangle, in units of its sides.
EDGES = {
    "left": ((0, 0), (0, 1)),
    "right": ((1, 0), (1, 1)),
    "bottom": ((0, 0), (1, 0)),
    "top": ((0, 1), (1, 1)),
}


def free_motion(
    sides: tuple[float, float],
    fibres: tuple[float, float],
    boundary: Boundary,
    shear_resisted: bool,
) -> str | None:
    """Return in words how the sheet can move at no cost, or None if it cannot.

    Args:
        sides: Length and width, m.
        fibres: Angles of the families, rad.
        boundary: Conditions on the edges of the rectangle. Two placements are tied, so
            that what holds one of them holds both.
        shear_resisted: Whether an effect resists shear. If not, the fibres may also
            turn independently of each other, each family as one.
    """
    directions = np.array([[np.cos(a), np.sin(a)] for a in fibres])
    names, gradients = zip(*_gradients(directions, shear_resisted), strict=True)
    size = max(sides)
    rows: list[Array] = []
    for edge, _, condition in conditions_of(boundary):
        for corner in EDGES[edge]:
            point = np.array(corner) * np.array(sides) / size
            moved = np.column_stack([np.eye(2), *(g @ point for g in gradients)])
            rows += [moved[i] for i in (0, 1) if condition.components[i].held]
        for d in directions[[f - 1 for f in condition.families]] if condition.rotation else ():
            across = np.array([-d[1], d[0]])
            rows.append(np.array([0.0, 0.0, *(across @ g @ d for g in gradients)]))
    constraints = np.array(rows).reshape(-1, 2 + len(gradients))
    free = [
        name
        for name, column in zip(("move along x", "move along y"), constraints.T, strict=False)
        if not column.any()
    ]
    if free:
        return free[0]
    rank = int(np.linalg.matrix_rank(constraints, tol=1e-9))
    return None if rank == constraints.shape[1] else names[0]


def _gradients(directions: Array, shear_resisted: bool) -> list[tuple[str, Array]]:
    """Return the displacement gradients that keep the fibres straight and their length."""
    inverse = np.linalg.inv(directions)
    turns = [inverse @ np.array(m, float) @ inverse.T for m in ([[0, 1], [0, 0]], [[0, 0], [1, 0]])]
    if shear_resisted:
        return [("turn as a whole", turns[0] - turns[1])]
    return [("turn as a whole or shear uniformly", turn) for turn in turns]
