"""Where to cut along the fibres: even between special fibres, without slivers at the edges."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from wovenfab.sheet.fibre_lines import SAME, pieces
from wovenfab.sheet.outline import Outline

Array = NDArray[np.float64]
#: Share of the spacing by which a line may be moved.
SHIFT = 0.35
#: Number of places that are tried on the way.
TRIALS = 15


def evenly(special: Array, size: float) -> Array:
    """Return positions that include the special ones and are at most ``size`` apart."""
    parts = [
        np.linspace(a, b, max(1, int(np.ceil((b - a) / size * (1 - 1e-9)))) + 1)[:-1]
        for a, b in pairwise(special)
    ]
    return np.concatenate([*parts, special[-1:]])


def spaced(
    outline: Outline, fibres: Array, special: tuple[Array, Array], size: float
) -> tuple[Array, Array]:
    """Return the positions of the lines of both families, m.

    Lines of the two families that end close to one another on an edge would leave slivers:
    those between special fibres are moved a little, so that they end at the same point or
    well apart.

    Args:
        outline: The sheet.
        fibres: Unit vectors along the fibres, shape (2, 2).
        special: For each family, positions that must be among them.
        size: Largest distance between neighbours before they are moved, m.
    """
    lines = [evenly(positions, size) for positions in special]
    vertices = np.concatenate([ring.points for ring in outline.rings])
    for family in (1, 0):
        ends = [_ends(outline, fibres[1 - family], offset) for offset in lines[1 - family]]
        others = np.concatenate([vertices, *ends])
        fixed = np.isin(lines[family], special[family])
        lines[family] = np.array(
            [
                offset if stays else _moved(outline, fibres[family], offset, gap, others)
                for offset, stays, gap in zip(
                    lines[family], fixed, np.gradient(lines[family]), strict=True
                )
            ]
        )
    return lines[0], lines[1]


def _ends(outline: Outline, direction: Array, offset: float) -> Array:
    return np.reshape(pieces(outline, direction, offset), (-1, 2))


def _moved(outline: Outline, direction: Array, offset: float, gap: float, others: Array) -> float:
    """Return the best place for a line near its present one.

    Args:
        outline: The sheet.
        direction: Unit vector along the line.
        offset: Its present position across, m.
        gap: Distance from its neighbours, m.
        others: Where other lines end, shape (n, 2), m.
    """
    shifts = np.linspace(-SHIFT, SHIFT, TRIALS) * gap
    across = np.array([-direction[1], direction[0]])
    meeting = others @ across - offset
    candidates = np.concatenate([[0.0], shifts, meeting[np.abs(meeting) < SHIFT * gap]])
    tolerance = SAME * outline.extent
    best, chosen = -np.inf, offset
    for shift in candidates:
        ends = _ends(outline, direction, offset + shift)
        apart = np.linalg.norm(ends[:, None] - others[None], axis=2)
        apart = np.where(apart < tolerance, np.inf, apart).min(axis=1)
        room = float(np.minimum(apart, gap).sum() - 0.5 * abs(shift))
        room += 2 * float(np.minimum(apart.min(initial=gap), gap / 2))
        if room > best:
            best, chosen = room, offset + float(shift)
    return chosen
