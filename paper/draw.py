"""The figures as pictures: curves, and deformed sheets at one scale of length."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from paper.campaign import Campaign, Results
from paper.claims import RATIOS
from paper.elements import Compared, errors, loops, yarns
from paper.figures import CYCLE, FIGURES, Panel, PaperFigure
from paper.page import ERRORS, LOOPS, YARNS
from wovenfab.record.fields import read_fields
from wovenfab.record.results import Provenance
from wovenfab.record.summary import window
from wovenfab.report.curves import program
from wovenfab.report.pictures import animate
from wovenfab.report.run_data import largest, open_run_data
from wovenfab.report.sheet import DisplacedSheet, draw_outline, draw_yarns, paint, sheet_at
from wovenfab.report.style import (
    APART,
    DASHES,
    FIELD_STYLES,
    INK,
    MILLIMETRE,
    QUIET,
    WIDTH,
    Scale,
    Unit,
    house_style,
    readable,
    save,
    scale_of,
    sequence,
)

Values = NDArray[np.float64]
#: Resolution of the pictures of fields (1/in), which are smooth.
FIELD_DPI = 150


def draw_figures(results: Results, folder: Path, origin: Provenance) -> Iterator[tuple[int, float]]:
    """Draw all figures, one after the other.

    Args:
        results: The results of the campaign.
        folder: Where the pictures go.
        origin: What made the results and draws them.

    Yields:
        Number and width (in) of each.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for figure in FIGURES:
        with house_style():
            drawn = _DRAW[figure.kind](figure, results)
            save(drawn, folder / figure.file, origin, FIELD_DPI)
        yield figure.number, float(drawn.get_figwidth())


def draw_cycle(results: Results, folder: Path, origin: Provenance) -> Path:
    """Draw the largest cycle of the 1:3 sample in motion, and return the file."""
    source = open_run_data(results.directory / RATIOS["1:3"])
    with house_style():
        return animate(source, read_fields(source.directory), folder / CYCLE, origin)


def draw_elements(
    campaign: Campaign, results: Results, compared: Compared, folder: Path, origin: Provenance
) -> Iterator[tuple[str, float]]:
    """Draw what smooth elements hide.

    Args:
        campaign: What was run.
        results: Its results.
        compared: The runs on other elements.
        folder: Where the pictures go; it exists.
        origin: What made the results and draws them.

    Yields:
        Name and width (in) of each picture.
    """
    with house_style():
        for name, drawn in (
            (LOOPS, loops(campaign, results)),
            (ERRORS, errors(compared)),
            (YARNS, yarns(campaign, results)),
        ):
            save(drawn, folder / name, origin, FIELD_DPI)
            yield name, float(drawn.get_figwidth())


def _program(figure: PaperFigure, results: Results) -> Figure:
    return program(open_run_data(results.directory / figure.panels[0].run))


def _loops(figure: PaperFigure, results: Results) -> Figure:
    """Return the figure: each run by itself on scales of its own, and all of them together."""
    drawn = Figure(figsize=(WIDTH, 0.85 * WIDTH))
    grid = drawn.add_gridspec(2, len(figure.panels), height_ratios=[2, 3])
    for i, panel in enumerate(figure.panels):
        _draw_cycles(drawn.add_subplot(grid[0, i]), results, panel)
    axes = drawn.add_subplot(grid[1, :])
    unit = _unit(results, [panel.run for panel in figure.panels])
    for i, panel in enumerate(figure.panels):
        style = {"color": APART[i], "linestyle": DASHES[i], "linewidth": 1.3}
        axes.plot(*_path(results.history(panel.run), unit), label=panel.label, **style)
    axes.legend(loc="upper left")
    _finish(axes, unit)
    return drawn


def _draw_cycles(axes: Axes, results: Results, panel: Panel) -> None:
    """Draw the loop of each cycle in a shade of its own."""
    history, cycles = results.history(panel.run), results.summary(panel.run)["cycles"]
    unit = _unit(results, [panel.run])
    if panel.beside:
        behind = _path(results.history(panel.beside), unit)
        axes.plot(*behind, color=QUIET, linewidth=0.8, label=panel.beside_label)
        axes.legend(loc="upper left")
    for cycle, shade in zip(cycles, sequence(len(cycles)), strict=True):
        part = window(history, cycle["start_s"], cycle["end_s"])
        axes.plot(*_path(part, unit), color=shade, linewidth=1.2)
    axes.set_title(panel.label)
    _finish(axes, unit)


def _unit(results: Results, runs: Sequence[str]) -> Unit:
    """Return the unit of force that suits some runs."""
    return readable("N", max(float(np.abs(results.history(run)["force_N"]).max()) for run in runs))


def _path(history: Mapping[str, Values], unit: Unit) -> tuple[Values, Values]:
    return history["displacement_m"] * MILLIMETRE.factor, history["force_N"] * unit.factor


def _finish(axes: Axes, unit: Unit) -> None:
    axes.axhline(0, color=QUIET, linewidth=0.7, zorder=1)
    axes.set_xlabel(f"displacement ({MILLIMETRE.name})")
    axes.set_ylabel(f"force ({unit.name})")


#: Length on paper (in) of a metre of sheet: the longest one fills the width of a page.
_SCALE = 4.6
#: Distance of the yarns that are drawn (m).
_SPACING = 0.04
#: Room (in) around a sheet: left, right for the colour bar, below, above for the title.
_LEFT, _RIGHT, _BELOW, _ABOVE = 0.08, 0.85, 0.08, 0.26
#: Fields whose colours follow the square root, so that small values show beside large ones.
_BY_ROOT = ("beta", "curvature_1", "curvature_2")
#: Length of the bar that shows the scale (mm).
_BAR = 100


@dataclass(frozen=True)
class _Picture:
    panel: Panel
    sheet: DisplacedSheet
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

    Where sizes differ much, colours follow their roots.
    """
    pictures = [_picture(results, panel) for panel in figure.alike or figure.panels]
    name = figure.panels[0].field
    scale = scale_of(name, pictures[0].unit, [picture.values for picture in pictures])
    if name in _BY_ROOT:
        scale = replace(scale, norm=PowerNorm(0.5, scale.norm.vmin, scale.norm.vmax))
    return scale


def _extent(sheet: DisplacedSheet) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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
    """Draw the bar that shows the scale of length, above the sheet on the right."""
    right, high = axes.get_xlim()[1], axes.get_ylim()[1]
    axes.plot([right - _BAR, right], [high + 22] * 2, color=INK, linewidth=1.2, clip_on=False)
    axes.text(right - _BAR / 2, high + 28, f"{_BAR} mm", ha="center", fontsize=7.5)


def _short(picture: _Picture, scale: Scale) -> str:
    """Return symbol of a picture's field and unit of its scale."""
    symbol = FIELD_STYLES[picture.panel.field].label.split()[-1]
    return symbol + " " + scale.label[scale.label.rindex("(") :]


_DRAW = {"program": _program, "loops": _loops, "sheets": sheets}
