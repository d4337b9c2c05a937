"""The figures as pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from paper.campaign import Campaign, Results
from paper.claims import RATIOS
from paper.elements import Compared
from paper.elements_curves import errors, loops
from paper.elements_page import ERRORS, LOOPS, YARNS
from paper.elements_yarns import yarns
from paper.figures import CYCLE, FIGURES, Panel, PaperFigure
from paper.sheets import sheets
from wovenfab.record.fields import read_fields
from wovenfab.record.results import Provenance
from wovenfab.record.summary import window
from wovenfab.report.animation import animate
from wovenfab.report.curves import program
from wovenfab.report.run_data import open_run_data
from wovenfab.report.style import (
    APART,
    DASHES,
    MILLIMETRE,
    QUIET,
    WIDTH,
    Unit,
    house_style,
    readable,
    save,
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
        origin: What they tell of where they come from.

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
    campaign: Campaign, results: Results, found: Compared, folder: Path, origin: Provenance
) -> Iterator[tuple[str, float]]:
    """Draw what smooth elements hide.

    Args:
        campaign: What was run.
        results: Its results.
        found: What was found in them.
        folder: Where the pictures go; it exists.
        origin: What they tell of where they come from.

    Yields:
        Name and width (in) of each picture.
    """
    with house_style():
        for name, drawn in (
            (LOOPS, loops(campaign, results)),
            (ERRORS, errors(found)),
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


_DRAW = {"program": _program, "loops": _loops, "sheets": sheets}
