"""The mesh at rest, with the directions of both families."""

from __future__ import annotations

from math import isqrt

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from wovenfab.record.fields import Lattice, StoredFields
from wovenfab.report.deformed import sheet_size
from wovenfab.report.run_data import RunData
from wovenfab.report.style import MILLIMETRE, QUIET, YARNS

Values = NDArray[np.float64]


def mesh(source: RunData, stored: StoredFields) -> Figure:
    """Return the figure: every cell, and an arrow along each family."""
    cells = corners(stored.points(), stored.triangles()) * MILLIMETRE.factor
    size = np.ptp(cells.reshape(-1, 2), axis=0)
    wide, high = sheet_size(*size)
    figure = Figure(figsize=(wide, high - 0.6))
    axes = figure.add_subplot(aspect="equal")
    thin = 0.6 if len(cells) < 3000 else 0.25
    axes.add_collection(
        PolyCollection(list(cells), facecolors="none", edgecolors=QUIET, linewidths=thin)
    )
    axes.autoscale_view()
    _draw_fibres(axes, source, cells.reshape(-1, 2))
    axes.set_xlabel(f"x ({MILLIMETRE.name})")
    axes.set_ylabel(f"y ({MILLIMETRE.name})")
    axes.grid(visible=False)
    return figure


def corners(points: Values, triangles: NDArray[np.int64]) -> Values:
    """Return the corners of the cells on whose lattices fields are stored.

    Args:
        points: Stored points (m), shape (n, 2): a lattice for each cell.
        triangles: Stored triangles, shape (m, 3).

    Returns:
        Shape (cells, 3, 2), in m.
    """
    # a cell has (p+1)(p+2)/2 points and p^2 triangles, a ratio that no two degrees share
    degree = next(
        p
        for p in range(1, isqrt(len(triangles)) + 1)
        if 2 * p * p * len(points) == (p + 1) * (p + 2) * len(triangles)
    )
    lattice = Lattice(degree)
    x, y = lattice.points.T
    (ends,) = np.nonzero((x == 1) | (y == 1) | (x + y == 0))
    return points.reshape(-1, len(lattice.points), 2)[:, ends]


def _draw_fibres(axes: Axes, source: RunData, points: Values) -> None:
    if source.fibres is None:
        return
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    length = 0.3 * float(np.ptp(points, axis=0).min())
    for number, shade in enumerate(YARNS, 1):
        direction = source.fibres[number - 1]
        tip, tail = centre + length * direction, centre - length * direction
        style = {"arrowstyle": "-|>", "color": shade, "linewidth": 2, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", tip, tail, arrowprops=style)
        axes.annotate(
            f"$D_{number}$",
            tip,
            xytext=tuple(6 * direction),
            textcoords="offset points",
            color=shade,
            ha="center",
            va="center",
            fontsize=11,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1},
        )
