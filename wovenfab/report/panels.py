"""A field in several pictures of the sheet, small, all on one scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from wovenfab.report.field_styles import colour_bar, scale_of
from wovenfab.report.sheet import Sheet, draw_outline, draw_yarns, paint
from wovenfab.report.style import WIDTH

#: Yarns along the longest side of a small picture.
FEW = 12
#: Most of a figure's height (in) for one row.
TALL = 4.0


@dataclass(frozen=True)
class Panel:
    """One picture: the sheet, the field at its points (SI), shape (n,), and words above."""

    sheet: Sheet
    values: NDArray[np.float64]
    words: str


def panels(name: str, unit: str, rows: Sequence[Sequence[Panel]]) -> Figure:
    """Return the figure; the sheets, too, are to one scale.

    Args:
        name: Name of the field.
        unit: Its SI unit.
        rows: Panels from left to right, row by row; later rows may be shorter.
    """
    everything = [panel for row in rows for panel in row]
    scale = scale_of(name, unit, [panel.values for panel in everything])
    wide, high = np.max([_extent(panel.sheet) for panel in everything], axis=0)
    count = len(rows[0])
    height = min(WIDTH / max(count, 1.4) * high / wide + 0.25, TALL) * len(rows) + 0.75
    figure = Figure(figsize=(WIDTH, height))
    grid = figure.subplots(len(rows), count, sharex=True, sharey=True, squeeze=False)
    for axes in grid.flat:
        axes.set_aspect("equal")
        axes.set_axis_off()
    for axes_row, row in zip(grid, rows, strict=True):
        for axes, panel in zip(axes_row, row, strict=False):
            values = scale(panel.values)
            painted = paint(axes, panel.sheet, values, scale.ramp, scale.norm)
            draw_outline(axes, panel.sheet, 0.5)
            draw_yarns(axes, panel.sheet, FEW, 0.35)
            axes.set_title(panel.words, fontsize=8, fontweight="normal", pad=3)
    colour_bar(figure, grid, painted, scale)
    return figure


def _extent(sheet: Sheet) -> tuple[float, float]:
    """Return width and height (m) of the sheet at rest and moved together."""
    places = np.concatenate([sheet.mesh.points, sheet.mesh.points + sheet.mean])
    wide, high = np.ptp(places, axis=0)
    return float(wide), float(high)
