"""Pictures of large steps, locking and tunnelling."""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from typing import Any

import numpy as np

from benchmarks.hard.pictures.panels import MARKS, panels, threshold
from benchmarks.hard.row import Figures, Picture
from wovenfab.report.style import INK, MILLIMETRE, sequence

#: Displacement (mm) at which the inextensible 1:2 and 1:3 sheets lock.
LOCKS = {"1x2": (sqrt(2) - 1) * 300, "1x3": (sqrt(2) - 1) * 600}


def draw_large_steps(figures: Mapping[str, Figures], picture: Picture) -> None:
    """Draw iterations against unknowns."""
    with panels(picture, 1, 2.8) as (axes,):
        for degree, colour, mark in zip((2, 3, 4), sequence(3), MARKS, strict=False):
            for graded in (False, True):
                chosen = [
                    (f.unknowns, f.worst)
                    for name, f in figures.items()
                    if f"-p{degree}-" in name and name.endswith("graded") == graded
                ]
                if chosen:
                    x, y = zip(*sorted(chosen), strict=True)
                    label = f"P{degree}" + (", 0.1 mm at the corners" if graded else "")
                    style: dict[str, Any] = {"markerfacecolor": "white"} if graded else {}
                    axes.plot(x, y, mark, color=colour, label=label, **style)
        threshold(axes, 10, "at most 10")
        axes.set_xscale("log")
        axes.set_ylim(0, 11.5)
        axes.set_xlabel("unknowns")
        axes.set_ylabel("Newton iterations")
        axes.set_title("100 mm in one step from rest")
        axes.legend(ncols=3, loc="lower right")


def draw_locking(figures: Mapping[str, Figures], picture: Picture) -> None:
    """Draw force and margin against displacement."""
    marches = {name: f for name, f in figures.items() if name[8:11] in LOCKS}
    colours = dict(zip(LOCKS, sequence(2), strict=True))
    with panels(picture, 2) as (left, right):
        for name, f in marches.items():
            _, ratio, stiffness = name.split("-")
            dashes = "solid" if stiffness == "400" else (0, (2, 1.5))
            x = MILLIMETRE.factor * np.array(f.series["displacement"])
            label = f"{ratio.replace('x', ':')}, {stiffness} N/m"
            line: dict[str, Any] = {"color": colours[ratio], "linestyle": dashes}
            left.plot(x[1:], np.array(f.series["force"][1:]) / 1e3, **line)
            right.plot(x, f.series["margin"], label=label, **line)
        for axes in (left, right):
            for ratio, lock in LOCKS.items():
                threshold(axes, lock, f"{ratio.replace('x', ':')} locks", across=False)
            axes.set_xlabel("displacement (mm)")
        left.set_yscale("log")
        left.set_ylabel("force (kN)")
        right.legend(title="K_s", fontsize=7, title_fontsize=7, loc="lower left")
        right.set_ylabel("smallest margin")
        right.set_ylim(0, 1.02)


def draw_tunnelling(figures: Mapping[str, Figures], picture: Picture) -> None:
    """Draw the error of the limit against the limit."""
    (f,) = figures.values()
    exact, found = np.array(f.series["exact"]), np.array(f.series["found"])
    error = np.maximum(np.abs(found - exact) / exact, 1e-17)
    light, dark = sequence(2)
    with panels(picture, 1, 2.8) as (axes,):
        for beyond, colour, label in (
            (True, dark, "step leads beyond the barrier"),
            (False, light, "step stays on this side"),
        ):
            chosen = (exact < 1) == beyond
            axes.plot(exact[chosen], error[chosen], "o", color=colour, markersize=3.5, label=label)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(3e-18, 1e-11)
        threshold(axes, 1e-12, "at most 1e-12")
        axes.axvline(1.0, color=INK, linewidth=0.6)
        axes.set_xlabel("exact crossing, in lengths of the step")
        axes.set_ylabel("relative error of the limit")
        axes.legend(loc="upper right", bbox_to_anchor=(1, 0.85))
