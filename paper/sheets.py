"""Deformed sheets below each other, all figures to one scale of length."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from paper.campaign import Results
from paper.figures import Panel, PaperFigure
from wovenfab.record.fields import read_fields
from wovenfab.report.run_data import largest, open_run_data
from wovenfab.report.sheet import Sheet, draw_outline, draw_yarns, paint, sheet_at
from wovenfab.report.style import FIELD_STYLES, INK, MILLIMETRE, Scale, scale_of

#: Length on paper (in) of a metre of sheet: the longest one fills the width of a page.
_SCALE = 4.6
#: Distance of the yarns that are drawn (m).
_SPACING = 0.04
#: Room (in) around a sheet: left, right for the colour bar, below, above for the title.
_LEFT, _RIGHT, _BELOW, _ABOVE = 0.08, 0.85, 0.08, 0.26
#: Fields whose colours follow the square root, so that small values show beside large ones.
_BY_ROOT = ("beta", "curvature_1", "curvature_2")
#: Length of the bar that tells the scale (mm).
_BAR = 100


@dataclass(frozen=True)
class _Picture:
    panel: Panel
    sheet: Sheet
    values: NDArray[np.float64]
    unit: str
    when: str


def sheets(figure: PaperFigure, results: Results) -> Figure:
    """Return the figure: the sheet of each panel at its largest displacement."""
    pictures = [_picture(results, panel) for panel in figure.panels]
    extents = [_extent(picture.sheet) for picture in pictures]
    wide = max(_SCALE * (high - low)[0] for low, high in extents)
    highs = [_SCALE * (high - low)[1] for low, high in extents]
    width = _LEFT + wide + _RIGHT
    height = sum(highs) + len(pictures) * (_BELOW + _ABOVE)
    drawn = Figure(figsize=(width, height))
    drawn.set_layout_engine("none")  # every inch is placed here
    top = height
    scale = _scale(figure, results)
    for picture, (low, high), tall in zip(pictures, extents, highs, strict=True):
        bottom = top - _ABOVE - tall
        own = _SCALE * (high - low)[0]
        axes = drawn.add_axes((_LEFT / width, bottom / height, own / width, tall / height))
        _draw(axes, picture, scale, (low, high))
        bar = drawn.add_axes(
            (
                (_LEFT + own + 0.12) / width,
                (bottom + 0.05 * tall) / height,
                0.09 / width,
                0.9 * tall / height,
            )
        )
        drawn.colorbar(
            axes.collections[0], cax=bar, label=_short(picture, scale), extend=scale.extend
        )
        top = bottom - _BELOW
    _draw_bar(drawn.axes[0])
    return drawn


def _picture(results: Results, panel: Panel) -> _Picture:
    source = open_run_data(results.directory / panel.run)
    stored = read_fields(source.directory)
    when = largest(source, stored)
    return _Picture(
        panel,
        sheet_at(source, stored, when.index),
        stored.field(panel.field, when.index),
        stored.units[panel.field],
        when.words,
    )


def _scale(figure: PaperFigure, results: Results) -> Scale:
    """Return the scale of all sheets of a field.

    Sizes that differ much between them are told apart by their roots.
    """
    found = [_picture(results, panel) for panel in figure.alike or figure.panels]
    name = figure.panels[0].field
    scale = scale_of(name, found[0].unit, [picture.values for picture in found])
    if name in _BY_ROOT:
        scale = replace(scale, norm=PowerNorm(0.5, scale.norm.vmin, scale.norm.vmax))
    return scale


def _extent(sheet: Sheet) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and the highest coordinates (m) of the sheet at rest and moved."""
    places = np.concatenate([sheet.mesh.points, sheet.mesh.points + sheet.mean])
    return places.min(axis=0) - 0.005, places.max(axis=0) + 0.005


def _draw(
    axes: Axes,
    picture: _Picture,
    scale: Scale,
    extent: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> None:
    sheet = picture.sheet
    paint(axes, sheet, scale(picture.values), scale.ramp, scale.norm)
    draw_outline(axes, sheet, 0.6)
    along = float(np.ptp(sheet.mesh.points, axis=0).max()) / _SPACING
    draw_yarns(axes, sheet, along, 0.45)
    (left, low), (right, high) = (corner * MILLIMETRE.factor for corner in extent)
    axes.set(xlim=(left, right), ylim=(low, high))
    axes.set_axis_off()
    axes.set_title(f"{picture.panel.label}, {picture.when}", pad=5)


def _draw_bar(axes: Axes) -> None:
    """Draw the bar that tells the scale of length, above the sheet on the right."""
    right, high = axes.get_xlim()[1], axes.get_ylim()[1]
    axes.plot([right - _BAR, right], [high + 22] * 2, color=INK, linewidth=1.2, clip_on=False)
    axes.text(right - _BAR / 2, high + 28, f"{_BAR} mm", ha="center", fontsize=7.5)


def _short(picture: _Picture, scale: Scale) -> str:
    """Return symbol of a picture's field and unit of its scale."""
    symbol = FIELD_STYLES[picture.panel.field].label.split()[-1]
    return symbol + " " + scale.label[scale.label.rindex("(") :]
