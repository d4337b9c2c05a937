"""What smooth elements hide, as a picture of the yarns where one through a corner is crossed."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from paper.across import across, sample
from paper.campaign import JUMPING, Campaign, Results
from paper.claims import RATIOS
from paper.elements import KINDS
from paper.field import index_at_largest
from wovenfab.case import Rectangle
from wovenfab.record.fields import read_fields
from wovenfab.report.run_data import open_run_data
from wovenfab.report.sheet import Sheet, lines, paint, sheet_at
from wovenfab.report.style import INK, MILLIMETRE, WIDTH, YARNS, scale_of
from wovenfab.report.yarns import Triangles, material_lines

Values = NDArray[np.float64]
#: Half the side of the zoom (m), and distance of yarns and marks (m).
_HALF, _SPACING = 0.03, 0.006


def yarns(campaign: Campaign, results: Results) -> Figure:
    """Return the figure: yarns of family 1, and lines on it that were straight at rest."""
    run = RATIOS["1:3"]
    rest = campaign.case(run).sheet
    assert isinstance(rest, Rectangle)
    sheets = {k: _sheet(results, campaign.elements.loops[k][run]) for k in KINDS}
    middle = _moved(sheets[JUMPING][0], rest)
    window = np.array([middle - _HALF, middle + _HALF])
    seen = [beta[_inside(sheet, window)] for sheet, beta in sheets.values()]
    scale = scale_of("beta", "m", seen)
    figure = Figure(figsize=(WIDTH, 0.36 * WIDTH))
    grid = figure.subplots(1, len(KINDS))
    for axes, (kind, (sheet, beta)) in zip(grid, sheets.items(), strict=True):
        painted = paint(axes, sheet, scale(beta), scale.ramp, scale.norm)
        _draw_lines(axes, sheet, rest)
        (left, low), (right, high) = window * MILLIMETRE.factor
        axes.set(xlim=(left, right), ylim=(low, high), aspect="equal")
        axes.set_axis_off()
        axes.set_title(KINDS[kind].replace(", ", ",\n"), fontsize=9)
    figure.colorbar(painted, ax=list(grid), label=f"β ({MILLIMETRE.name})")
    return figure


def _sheet(results: Results, run: str) -> tuple[Sheet, Values]:
    """Return the sheet of a run at its largest displacement, and beta (m) on it."""
    source = open_run_data(results.directory / run)
    stored = read_fields(source.directory)
    index = index_at_largest(source.directory, stored)
    return sheet_at(source, stored, index), stored.field("beta", index)


def _moved(sheet: Sheet, rest: Rectangle) -> Values:
    """Return where the place is now (m) at which the yarn through the corner is crossed."""
    place, _, line = across(rest)
    beside = (place - 1e-4 * line)[None]
    found = [sample(sheet.mesh, sheet.mean[:, i], beside)[0] for i in (0, 1)]
    moved: Values = place + np.array(found)
    return moved


def _inside(sheet: Sheet, window: Values) -> NDArray[np.bool_]:
    """Return which points of a sheet are now in a window (m)."""
    places = sheet.mesh.points + sheet.mean
    inside: NDArray[np.bool_] = ((places > window[0]) & (places < window[1])).all(axis=1)
    return inside


def _draw_lines(axes: Axes, sheet: Sheet, rest: Rectangle) -> None:
    """Draw yarns of family 1, and what lay straight across them at rest and moves with them."""
    assert sheet.fibres is not None
    slid, mesh = sheet.families[0], sheet.mesh
    yarns = material_lines(mesh, sheet.fibres[0], slid, _SPACING)
    axes.add_collection(lines(yarns, INK, 1.0))
    for half in _halves(mesh, rest):
        marks = material_lines(half, sheet.fibres[1], slid, _SPACING)
        axes.add_collection(lines(marks, YARNS[1], 0.8))


def _halves(mesh: Triangles, rest: Rectangle) -> list[Triangles]:
    """Return the mesh on both sides of the yarn through the corner, so that no line joins them."""
    place, _, line = across(rest)
    beyond = (mesh.points[mesh.triangles].mean(axis=1) - place) @ line > 0
    return [Triangles(mesh.points, mesh.triangles[where]) for where in (~beyond, beyond)]
