"""The deformed sheet with its yarns, coloured by a field."""

from __future__ import annotations

from textwrap import fill as wrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wovenfab.record.fields import StoredFields
from wovenfab.report.field_styles import Scale, colour_bar, scale_of, telling_field
from wovenfab.report.run_data import RunData, largest
from wovenfab.report.sheet import Sheet, Values, draw_outline, draw_yarns, paint, sheet_at
from wovenfab.report.style import MILLIMETRE, WIDTH


def deformed(source: RunData, stored: StoredFields) -> Figure:
    """Return the figure: the sheet at the stored time of largest displacement."""
    when = largest(source, stored)
    sheet, subtitle = sheet_at(source, stored, when.index), f"{when.words}, true to scale"
    name = telling_field(stored, when.index)
    if name is None:
        return drawn(source.title, subtitle, sheet)
    values = stored.field(name, when.index)
    scale = scale_of(name, stored.units[name], [values])
    return drawn(source.title, subtitle, sheet, scale(values), scale)


def drawn(
    title: str,
    subtitle: str,
    sheet: Sheet,
    values: Values | None = None,
    scale: Scale | None = None,
) -> Figure:
    """Return the figure of a displaced sheet with its yarns.

    Args:
        title: Title of the run.
        subtitle: Line below it.
        sheet: Where the sheet is.
        values: What it is coloured by, in the unit of the scale, shape (n,), or None.
        scale: The scale of the values.
    """
    extent = np.ptp(sheet.mesh.points + sheet.mean, axis=0)
    figure = Figure(figsize=sheet_size(*extent))
    axes = figure.add_subplot(aspect="equal")
    if values is not None and scale is not None:
        painted = paint(axes, sheet, values, scale.ramp, scale.norm)
        colour_bar(figure, axes, painted, scale, shrink=0.6, aspect=36)
    draw_outline(axes, sheet)
    draw_yarns(axes, sheet)
    _label(axes, title, subtitle)
    axes.autoscale_view()
    return figure


def _label(axes: Axes, title: str, subtitle: str) -> None:
    """Write title, subtitle, key and axes around the sheet."""
    axes.set_title(wrap(title, 74), pad=22)
    axes.annotate(
        subtitle, (0, 1), xycoords="axes fraction", xytext=(0, 8), textcoords="offset points"
    )
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, handlelength=1.6, borderpad=0.2)
    axes.grid(visible=False)
    axes.set_xlabel(f"x ({MILLIMETRE.name})")
    axes.set_ylabel(f"y ({MILLIMETRE.name})")


def sheet_size(wide: float, high: float) -> tuple[float, float]:
    """Return a figure size (in) that fits the sheet's shape, with room for the key."""
    return WIDTH, float(np.clip(0.92 * WIDTH * high / wide + 1.7, 2.2, 9.0))
