"""The deformed sheet with its yarns, coloured by a field."""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import fill as wrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from wovenfab.record.stored_fields import StoredFields
from wovenfab.report.source import Source
from wovenfab.report.style import DEGREE, INK, MILLIMETRE, QUIET, WIDTH, YARNS, fill, readable
from wovenfab.report.yarns import Polyline, Triangles, material_lines, outline

#: Number of yarns of a family along the longest side of the sheet, about.
YARNS_ALONG = 30


@dataclass(frozen=True)
class Colour:
    """Values at the points, and what they are."""

    label: str
    values: NDArray[np.float64]


def deformed(source: Source, stored: StoredFields) -> Figure:
    """Return the figure: the sheet at the stored time of largest displacement."""
    index, displacement = _extreme(source, stored)
    families = [stored.field(name, index) for name in _displacements(stored)]
    subtitle = f"at {displacement * MILLIMETRE.factor:.3g} mm, true to scale"
    return sheet(source, stored, families, _colour(stored, index), subtitle)


def sheet(
    source: Source,
    stored: StoredFields,
    families: list[NDArray[np.float64]],
    colour: Colour,
    subtitle: str,
) -> Figure:
    """Return the figure of a displaced sheet with its yarns.

    Args:
        source: The results.
        stored: Their fields, for the mesh.
        families: Displacement (m) of the placements, shape (n, 2) each.
        colour: What the sheet is coloured by.
        subtitle: Line below the title.
    """
    mesh = Triangles(stored.points(), stored.triangles())
    mean = np.mean(families, axis=0)
    x, y = ((mesh.points + mean) * MILLIMETRE.factor).T
    figure = Figure(figsize=_size(float(np.ptp(x)), float(np.ptp(y))))
    axes = figure.add_subplot(aspect="equal")
    painted = axes.tripcolor(
        Triangulation(x, y, mesh.triangles),
        colour.values,
        shading="gouraud",
        cmap=fill(),
        vmin=min(0.0, colour.values.min()),
        vmax=colour.values.max() or 1.0,
    )
    axes.add_collection(_lines(outline(mesh), QUIET, 0.8, "at rest", dashed=True))
    axes.add_collection(_lines(outline(mesh, mean), INK, 0.8))
    if source.fibres is not None:
        spacing = float(np.ptp(mesh.points, axis=0).max()) / YARNS_ALONG
        for number, shade in enumerate(YARNS):
            own = families[number % len(families)]
            yarns = material_lines(mesh, source.fibres[number], own, spacing)
            axes.add_collection(_lines(yarns, shade, 0.6, f"family {number + 1}"))
    figure.colorbar(painted, label=colour.label, shrink=0.6, aspect=36, location="bottom")
    _label(axes, source.title, subtitle)
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


def _extreme(source: Source, stored: StoredFields) -> tuple[int, float]:
    """Return which stored time has the largest displacement, and that displacement (m)."""
    history = source.history
    u = np.interp(stored.times, history["time_s"], history["displacement_m"])
    index = int(np.abs(u).argmax())
    return index, float(u[index])


def _displacements(stored: StoredFields) -> list[str]:
    """Return the displacement fields: one, or one for each family."""
    return sorted(name for name in stored.units if name.split("_")[0] == "displacement")


def _colour(stored: StoredFields, index: int) -> Colour:
    """Return what to colour the sheet by: the slip of the families, or the shear angle."""
    if "beta" in stored.units:
        beta = stored.field("beta", index)
        unit = readable("m", float(beta.max()) or 1e-3)
        return Colour(f"slip between the families β ({unit.name})", beta * unit.factor)
    if "shear_angle" in stored.units:
        gamma = stored.field("shear_angle", index)
        return Colour(f"shear angle ({DEGREE.name})", gamma * DEGREE.factor)
    u = stored.field(_displacements(stored)[0], index)
    return Colour(f"displacement ({MILLIMETRE.name})", np.hypot(*u.T) * MILLIMETRE.factor)


def _lines(
    lines: list[Polyline], colour: str, width: float, label: str = "", dashed: bool = False
) -> LineCollection:
    return LineCollection(
        [line * MILLIMETRE.factor for line in lines],
        colors=colour,
        linewidths=width,
        linestyles=[(0, (5, 3))] if dashed else "solid",
        capstyle="round",
        label=label,
    )


def _size(wide: float, high: float) -> tuple[float, float]:
    """Return a figure size (in) that fits the sheet's shape, with room for the key."""
    return WIDTH, float(np.clip(0.92 * WIDTH * high / wide + 1.7, 2.2, 9.0))
