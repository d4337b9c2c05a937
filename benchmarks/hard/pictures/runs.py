"""Pictures of long runs and of failures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.hard.pictures.panels import MARKS, panels, threshold
from benchmarks.hard.row import Figures, Picture
from wovenfab.report.style import MILLIMETRE, QUIET, sequence


def draw_long(figures: Mapping[str, Figures], picture: Picture) -> None:
    """Draw change of the loop, imbalance and memory by cycle."""
    (f,) = figures.values()
    _, dark = sequence(2)
    with panels(picture, 3, 2.4) as (first, second, third):
        apart = np.array(f.series["apart"][:-1])
        cycle = np.arange(1, len(apart) + 1)
        first.plot(cycle, np.maximum(apart, 1e-17), ".", color=dark)
        first.set_yscale("log")
        threshold(first, 1e-6, "at most 1e-6")
        first.set_ylabel("change up to the last cycle")
        second.plot(cycle, 100 * np.array(f.series["imbalance"][:-1]), ".", color=dark)
        second.set_ylim(*sorted((0, 130 * f.series["imbalance"][-1])))
        second.set_ylabel("imbalance over losses (%)")
        memory = f.series["memory"]
        third.plot(np.arange(1, len(memory) + 1), memory, ".", color=dark)
        third.set_ylim(0, 1.2 * max(memory))
        threshold(third, 1.02 * memory[min(4, len(memory) - 1)], "2 % more than after cycle 5")
        third.set_ylabel("resident memory (MB)")
        for axes in (first, second, third):
            axes.set_xlabel("cycle")


def draw_failures(figures: Mapping[str, Figures], picture: Picture) -> None:
    """Draw how far the runs came, and the worst points that they name."""
    names = list(figures)
    colours = dict(zip(names, sequence(len(names)), strict=True))
    marks = dict(zip(names, MARKS, strict=False))
    with panels(picture, 2, 2.4, widths=(1.0, 1.3)) as (left, right):
        for name, f in figures.items():
            x = MILLIMETRE.factor * np.array(f.series["displacement"])
            force = np.array(f.series["force"]) / 1e3
            style: dict[str, Any] = {"color": colours[name], "marker": marks[name]}
            left.plot(x, force, color=colours[name], linewidth=1)
            left.plot(x[-1], force[-1], markersize=6, **style)
            if f.series["place"]:
                place = MILLIMETRE.factor * np.array(f.series["place"])
                label = name.removeprefix("failure-").replace("-", " ")
                right.plot(*place, linestyle="none", label=label, markersize=6, **style)
        left.set_yscale("symlog", linthresh=1.0)
        left.set_xlabel("displacement (mm)")
        left.set_ylabel("force (kN)")
        left.set_title("up to the failure")
        for length in (600, 900):
            right.plot([0, length, length, 0, 0], [0, 0, 300, 300, 0], color=QUIET, linewidth=0.8)
        right.set_aspect("equal")
        right.grid(visible=False)
        right.set_xlabel("x at rest (mm)")
        right.set_ylabel("y (mm)")
        right.legend(
            title="worst point", alignment="left", loc="lower left", bbox_to_anchor=(0, 1.02),
            ncols=2, fontsize=7,
        )  # fmt: skip
