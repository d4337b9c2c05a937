"""The sheet at one time, coloured by a field, with its outline, yarns or cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import fill as wrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection, TriMesh
from matplotlib.colors import Colormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter
from matplotlib.tri import Triangulation

from wovenfab.record.fields import StoredFields
from wovenfab.report.run_data import RunData, largest
from wovenfab.report.style import (
    INK,
    MILLIMETRE,
    QUIET,
    WIDTH,
    YARNS,
    Scale,
    Values,
    colour_bar,
    fill,
    label_sheet,
    main_field,
    readable,
    scale_of,
)
from wovenfab.report.yarns import (
    YARNS_ALONG,
    Polyline,
    Triangles,
    displacements,
    material_lines,
    outline,
)

#: Largest displacement by a mode in its picture, over the length of the sheet.
MODE_SIZE = 0.08
#: Smallest share of the error that the colours show, over the largest.
LEAST_SHARE = 1e-3
#: Yarns along the longest side of a small picture, and most of a figure's height (in) for a row.
FEW, TALL = 12, 4.0


@dataclass(frozen=True)
class DisplacedSheet:
    """The sheet at one time.

    Attributes:
        mesh: The stored mesh.
        families: Displacement of each placement (m), each of shape (n, 2): one or two.
        fibres: Reference directions, a row a family, shape (2, 2), if known.
    """

    mesh: Triangles
    families: tuple[Values, ...]
    fibres: Values | None

    @property
    def mean(self) -> Values:
        """Mean displacement of the families (m), shape (n, 2)."""
        middle: Values = np.mean(self.families, axis=0)
        return middle

    @property
    def points(self) -> Values:
        """Points displaced by the mean (m), shape (n, 2)."""
        return self.mesh.points + self.mean

    def yarns(self, family: int, along: float = YARNS_ALONG) -> list[Polyline]:
        """Return the displaced yarns of a family (0 or 1), about ``along`` on the longest side."""
        if self.fibres is None:
            return []
        own = self.families[family % len(self.families)]
        return material_lines(self.mesh, self.fibres[family], own, self.mesh.length / along)


@dataclass(frozen=True)
class Panel:
    """A small picture: the sheet, a field at its points (SI), shape (n,), and a title."""

    sheet: DisplacedSheet
    values: Values
    words: str


def sheet_at(source: RunData, stored: StoredFields, index: int) -> DisplacedSheet:
    """Return the sheet at ``stored.times[index]``."""
    families = tuple(stored.field(name, index) for name in displacements(stored))
    return DisplacedSheet(Triangles(stored.points(), stored.triangles()), families, source.fibres)


def deformed(source: RunData, stored: StoredFields) -> Figure:
    """Return the figure: the sheet at the stored time of largest displacement."""
    when = largest(source, stored)
    sheet, subtitle = sheet_at(source, stored, when.index), f"{when.words}, true to scale"
    name = main_field(stored, when.index)
    if name is None:
        return _coloured(source.title, subtitle, sheet)
    values = stored.field(name, when.index)
    return _coloured(
        source.title, subtitle, sheet, values, scale_of(name, stored.units[name], [values])
    )


def mode(source: RunData, stored: StoredFields) -> Figure:
    """Return the figure: the sheet displaced along the mode of the first loss of stability."""
    state = sheet_at(source, stored, 0)
    names = [name.replace("displacement", "mode") for name in displacements(stored)]
    modes = [stored.field(name, 0) for name in names]
    size = np.hypot(*np.mean(modes, axis=0).T)
    factor = MODE_SIZE * state.mesh.length / float(size.max())
    moved = tuple(u + factor * m for u, m in zip(state.families, modes, strict=True))
    label = "displacement in the mode, whose size is arbitrary"
    scale = Scale(label, 1.0, fill(), Normalize(0.0, 1.0), "neither")
    row = int(np.searchsorted(source.history["time_s"], float(stored.times[0])))
    u, force = (float(source.history[name][row]) for name in ("displacement_m", "force_N"))
    unit = readable("N", force)
    at = f"{u * MILLIMETRE.factor:.4g} mm, {force * unit.factor:.4g} {unit.name}"
    sheet = DisplacedSheet(state.mesh, moved, source.fibres)
    return _coloured(source.title, f"stability lost at {at}", sheet, size / size.max(), scale)


def error(source: RunData, stored: StoredFields) -> Figure:
    """Return the figure: each cell of the sheet at rest coloured by its share of the error."""
    x, y = (stored.points() * MILLIMETRE.factor).T
    triangles = stored.triangles()
    share = stored.field("error_share", -1)[triangles[:, 0]]
    half = int(np.searchsorted(np.cumsum(np.sort(share)[::-1]), 0.5)) + 1
    figure = Figure(figsize=(WIDTH, WIDTH * 0.62))
    axes = figure.add_subplot(aspect="equal")
    most = float(share.max()) or 1.0
    painted = axes.tripcolor(
        x,
        y,
        triangles,
        facecolors=np.maximum(share, LEAST_SHARE * most),
        norm=LogNorm(LEAST_SHARE * most, most),
        cmap=fill(),
        edgecolors="0.7",
        linewidth=0.2,
    )
    label = "share of each cell in the energy of the error"
    bar = figure.colorbar(painted, label=label, shrink=0.7, aspect=36, location="bottom")
    bar.ax.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    bar.ax.xaxis.set_minor_formatter(NullFormatter())
    cells = f"half of it in {half} of {len(share)} cells"
    label_sheet(axes, source.title, f"error of the elements at the largest force: {cells}")
    return figure


def mesh(source: RunData, stored: StoredFields) -> Figure:
    """Return the figure: the cells at rest, and an arrow along each family."""
    cells = stored.corners() * MILLIMETRE.factor
    wide, high = figure_size(np.ptp(cells.reshape(-1, 2), axis=0))
    figure = Figure(figsize=(wide, high - 0.6))
    axes = figure.add_subplot(aspect="equal")
    thin = 0.6 if len(cells) < 3000 else 0.25
    axes.add_collection(
        PolyCollection(list(cells), facecolors="none", edgecolors=QUIET, linewidths=thin)
    )
    axes.autoscale_view()
    if source.fibres is not None:
        _draw_fibres(axes, source.fibres, cells.reshape(-1, 2))
    label_sheet(axes)
    return figure


def panels(name: str, unit: str, rows: Sequence[Sequence[Panel]]) -> Figure:
    """Return the figure: rows of small pictures with one scale of colours and one of length.

    Later rows may be shorter. The field has a name and an SI unit.
    """
    everything = [panel for row in rows for panel in row]
    scale = scale_of(name, unit, [panel.values for panel in everything])
    both = [np.concatenate([p.sheet.mesh.points, p.sheet.points]) for p in everything]
    wide, high = np.max([np.ptp(points, axis=0) for points in both], axis=0)
    count = len(rows[0])
    height = min(WIDTH / max(count, 1.4) * high / wide + 0.25, TALL) * len(rows) + 0.75
    figure = Figure(figsize=(WIDTH, height))
    grid = figure.subplots(len(rows), count, sharex=True, sharey=True, squeeze=False)
    for axes in grid.flat:
        axes.set_aspect("equal")
        axes.set_axis_off()
    for axes_row, row in zip(grid, rows, strict=True):
        for axes, panel in zip(axes_row, row, strict=False):
            painted = paint(axes, panel.sheet, scale(panel.values), scale.ramp, scale.norm)
            draw_outline(axes, panel.sheet, 0.5)
            draw_yarns(axes, panel.sheet, FEW, 0.35)
            axes.set_title(panel.words, fontsize=8, fontweight="normal", pad=3)
    colour_bar(figure, grid, painted, scale)
    return figure


def paint(
    axes: Axes, sheet: DisplacedSheet, values: Values, ramp: Colormap, norm: Normalize
) -> TriMesh:
    """Colour the displaced sheet by values at its points, shape (n,), in axes in mm."""
    x, y = (sheet.points * MILLIMETRE.factor).T
    surface = Triangulation(x, y, sheet.mesh.triangles)
    return axes.tripcolor(surface, values, shading="gouraud", cmap=ramp, norm=norm)


def draw_outline(axes: Axes, sheet: DisplacedSheet, width: float = 0.8) -> None:
    """Draw the edge of the sheet, and in dashes the one at rest."""
    axes.add_collection(lines(outline(sheet.mesh), QUIET, width, "at rest", dashed=True))
    axes.add_collection(lines(outline(sheet.mesh, sheet.mean), INK, width))


def draw_yarns(
    axes: Axes, sheet: DisplacedSheet, along: float = YARNS_ALONG, width: float = 0.6
) -> None:
    """Draw yarns of both families, if their directions are known."""
    if sheet.fibres is None:
        return
    for family, shade in enumerate(YARNS):
        label = f"family {family + 1}"
        axes.add_collection(lines(sheet.yarns(family, along), shade, width, label))


def lines(
    polylines: Sequence[Polyline], colour: str, width: float, label: str = "", dashed: bool = False
) -> LineCollection:
    """Return polylines (m) as a collection for axes in mm."""
    return LineCollection(
        [line * MILLIMETRE.factor for line in polylines],
        colors=colour,
        linewidths=width,
        linestyles=[(0, (5, 3))] if dashed else "solid",
        capstyle="round",
        label=label,
    )


def _coloured(
    title: str,
    subtitle: str,
    sheet: DisplacedSheet,
    values: Values | None = None,
    scale: Scale | None = None,
) -> Figure:
    """Return the figure of a displaced sheet with its yarns, coloured by values (SI), if any."""
    wide, high = size = np.ptp(sheet.points, axis=0)
    figure = Figure(figsize=figure_size(size))
    axes = figure.add_subplot(aspect="equal")
    if values is not None and scale is not None:
        painted = paint(axes, sheet, scale(values), scale.ramp, scale.norm)
        colour_bar(figure, axes, painted, scale, shrink=0.6, aspect=36)
    draw_outline(axes, sheet)
    draw_yarns(axes, sheet)
    label_sheet(axes, wrap(title, 74), subtitle)
    # Above a sheet that is higher than wide there is room for the subtitle alone.
    beside = (
        {"loc": "upper left", "ncols": 1} if high > wide else {"loc": "lower right", "ncols": 3}
    )
    axes.legend(bbox_to_anchor=(1, 1), handlelength=1.6, borderpad=0.2, **beside)
    axes.autoscale_view()
    return figure


def figure_size(extent: Values) -> tuple[float, float]:
    """Return a figure size (in) for the width and height of a sheet, with room for the key."""
    return WIDTH, float(np.clip(0.92 * WIDTH * extent[1] / extent[0] + 1.7, 2.2, 9.0))


def _draw_fibres(axes: Axes, fibres: Values, points: Values) -> None:
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    length = 0.3 * float(np.ptp(points, axis=0).min())
    for number, shade in enumerate(YARNS, 1):
        direction = fibres[number - 1]
        tip, tail = centre + length * direction, centre - length * direction
        style = {"arrowstyle": "-|>", "color": shade, "linewidth": 2, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", tip, tail, arrowprops=style)
        axes.annotate(
            f"$D_{number}$",
            tip,
            parse_math=True,
            xytext=tuple(6 * direction),
            textcoords="offset points",
            color=shade,
            ha="center",
            va="center",
            fontsize=11,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 1},
        )
