"""Pictures of contrasts, meshes and scales."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from benchmarks.hard.pictures.panels import MARKS, bars, panels, threshold
from benchmarks.hard.row import Figures, Picture
from wovenfab.report.style import INK, MILLIMETRE, sequence

#: Part of the mesh of slivers that is shown, mm.
SHOWN = 50.0
QUANTITIES = ("time", "displacement", "force", "stored", "dissipated", "work")


def draw_contrasts(figures: Mapping[str, Figures], picture: Picture) -> None:
    """Draw the force against the coupling, and the differences from the limit models."""
    coupled = [f for name, f in figures.items() if name in ("contrast-coupling", "contrast-bonded")]
    others = {
        name.removeprefix("contrast-").replace("-", " "): f.figure("difference from the limit")
        for name, f in figures.items()
        if name != "contrast-coupling"
    }
    _, dark = sequence(2)
    with panels(picture, 2) as (left, right):
        for f, inside in zip(coupled, (dark, "white"), strict=False):
            x, y = f.series["stiffness"], f.series["force"]
            left.plot(x, y, "o", color=dark, markerfacecolor=inside)
        if coupled:
            threshold(left, coupled[0].series["limit"], "bonded")
        left.set_xscale("log")
        left.set_ylim(0)
        left.set_xlabel("coupling K_c (N/m³)")
        left.set_ylabel("force at 40 mm (N)")
        bars(right, list(others), list(others.values()), dark)
        threshold(right, 1e-3, "limit model", across=False)
        right.set_xlabel("relative difference of the force")


def draw_meshes(figures: Mapping[str, Figures], picture: Picture) -> None:
    """Draw the slivers, the differences of the force, and the smallest eigenvalues."""
    differences = {
        name.removeprefix("mesh-"): f.figure("difference")
        for name, f in figures.items()
        if "difference" in f.checks
    }
    _, dark = sequence(2)
    with panels(picture, 3, widths=(0.8, 1.1, 1.1)) as (first, second, third):
        if "mesh-slivers" in figures:
            _slivers(first, figures["mesh-slivers"])
        bars(second, list(differences), list(differences.values()), dark)
        second.set_xlabel("relative difference of the force")
        for degree, colour, mark in zip((2, 3, 4), sequence(3), MARKS, strict=False):
            f = figures.get(f"mesh-coercive-p{degree}")
            for mesh, fill in (("crossed", colour), ("unstructured", "white")) if f else ():
                assert f is not None
                x = MILLIMETRE.factor * np.array(f.series["displacement"])
                third.plot(
                    x, f.series[mesh], marker=mark, color=colour, markersize=4, linewidth=1,
                    markerfacecolor=fill, label=f"P{degree}" if mesh == "crossed" else None,
                )  # fmt: skip
        third.set_ylim(0, 0.7)
        threshold(third, 1 - 2**-0.5, "proven at rest")
        third.set_xlabel("displacement (mm)")
        third.set_ylabel("smallest eigenvalue")
        third.set_title("filled: crossed, hollow: unstructured", fontsize=7.5, fontweight="normal")
        third.legend(ncols=3, loc="lower left", fontsize=7, columnspacing=1)


def _slivers(axes: Axes, figures: Figures) -> None:
    points = MILLIMETRE.factor * np.array(figures.series["points"])
    axes.triplot(*points.T, np.array(figures.series["cells"]), color=INK, linewidth=0.5)
    axes.set_xlim(-2, SHOWN)
    axes.set_ylim(-2, SHOWN)
    axes.set_aspect("equal")
    axes.grid(visible=False)
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
    axes.set_title("angles of 1°", fontsize=7.5, fontweight="normal")


def draw_scales(figures: Mapping[str, Figures], picture: Picture) -> None:
    """Draw the difference of each quantity after scaling back."""
    with panels(picture, 1, 2.6) as (axes,):
        for (name, f), colour, mark in zip(
            figures.items(), sequence(len(figures)), MARKS, strict=False
        ):
            apart = np.maximum(f.series["apart"], 1e-17)
            label = name.removeprefix("scale-")
            axes.plot(QUANTITIES, apart, mark, color=colour, label=label, markersize=5)
        axes.set_yscale("log")
        axes.set_ylim(3e-18, 1e-8)
        threshold(axes, 1e-9, "at most 1e-9")
        axes.set_ylabel("largest relative difference")
        axes.legend(ncols=1, loc="upper left", bbox_to_anchor=(1.0, 1.0))
