"""The picture of sheets that are pushed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.tri import Triangulation

from benchmarks.hard.pictures.panels import MARKS, panels
from benchmarks.hard.row import Figures, Picture
from wovenfab.report.style import MILLIMETRE, QUIET, fill, sequence

#: Largest displacement by the mode in the picture, over the length of the sheet.
SHOWN = 0.15


def draw_compression(figures: Mapping[str, Figures], picture: Picture) -> None:
    """Draw forces, lowest eigenvalues and the mode."""
    colours = dict(zip(figures, sequence(len(figures)), strict=True))
    with panels(picture, 3, widths=(1.1, 1.1, 0.9)) as (left, middle, right):
        for (name, f), mark in zip(figures.items(), MARKS, strict=False):
            x = -MILLIMETRE.factor * np.array(f.series["displacement"])
            force, softest = -np.array(f.series["force"]), np.array(f.series["softest"])
            label = name.removeprefix("compression-")
            left.plot(x[1:], force[1:], marker=mark, color=colours[name], label=label, markersize=3)
            share = softest / softest[0]
            middle.plot(x[1:], share[1:], marker=mark, color=colours[name], markersize=3)
        shown = next((f for f in figures.values() if "mode" in f.series), None)
        if shown:
            _mode(right, shown)
        for axes in (left, middle):
            axes.set_xscale("log")
            axes.set_xlabel("push (mm)")
        left.set_yscale("log")
        left.set_ylabel("force (N)")
        left.legend(fontsize=7)
        middle.axhline(0.0, color=QUIET, linewidth=0.9)
        middle.set_yscale("symlog", linthresh=1e-3)
        middle.set_ylabel("lowest eigenvalue (1 at rest)")


def _mode(axes: Axes, figures: Figures) -> None:
    mode = {name: np.array(values) for name, values in figures.series["mode"].items()}
    rest, cells, moved = mode["points"], mode["cells"], mode["displacement"]
    size = np.hypot(*moved.T)
    points = MILLIMETRE.factor * (rest + SHOWN * np.ptp(rest, axis=0).max() * moved)
    mesh = Triangulation(points[:, 0], points[:, 1], cells)
    axes.tripcolor(mesh, size, cmap=fill(), shading="gouraud")
    axes.triplot(mesh, color=QUIET, linewidth=0.2)
    axes.set_aspect("equal")
    axes.grid(visible=False)
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
    axes.set_title(f"mode at {figures.series['load']:.5g} N", fontsize=7.5, fontweight="normal")
