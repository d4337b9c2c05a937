"""A picture for each family of hard cases."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import sqrt
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from benchmarks.hard.row import Figures, Picture
from wovenfab.report.style import INK, MILLIMETRE, QUIET, WIDTH, fill, house_style, save, sequence

#: Height of a row of panels (in).
HEIGHT = 2.6
MARKS = ("o", "s", "^", "D", "v", "P")


@contextmanager
def panels(
    picture: Picture, count: int, height: float = HEIGHT, widths: Sequence[float] | None = None
) -> Iterator[list[Axes]]:
    """Draw into ``count`` panels side by side and write the picture at the end."""
    with house_style():
        figure = Figure(figsize=(WIDTH, height))
        axes = figure.subplots(1, count, squeeze=False, width_ratios=widths)[0]
        yield list(axes)
        save(figure, picture.path, picture.origin)


def threshold(axes: Axes, value: float, text: str, across: bool = True) -> None:
    """Draw a threshold, dashed, with its name."""
    style: dict[str, Any] = {
        "color": QUIET,
        "linewidth": 0.9,
        "linestyle": (0, (5, 3)),
        "zorder": 1,
    }
    if across:
        axes.axhline(value, **style)
        place, shift = ((1, value), (0, 3))
        transform = axes.get_yaxis_transform()
        axes.annotate(
            text, place, xycoords=transform, xytext=shift, textcoords="offset points",
            ha="right", va="bottom", fontsize=7, color=QUIET,
        )  # fmt: skip
    else:
        axes.axvline(value, **style)
        axes.annotate(
            text, (value, 1), xycoords=axes.get_xaxis_transform(), xytext=(0, 3),
            textcoords="offset points", ha="center", va="bottom", fontsize=7, color=QUIET,
        )  # fmt: skip


def bars(axes: Axes, names: Sequence[str], values: Sequence[float], colour: object) -> None:
    """Draw values on a logarithmic axis as dots on stems, one line each, the first on top."""
    floor = min((v for v in values if v > 0), default=1e-17) / 3
    shown = [max(value, floor) for value in values]
    axes.set_xscale("log")
    axes.hlines(names, floor, shown, color=colour, linewidth=1.2)
    axes.plot(shown, names, "o", color=colour, markersize=4)
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)


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
    pulls = {name: f for name, f in figures.items() if name[8:11] in LOCKS}
    colours = dict(zip(LOCKS, sequence(2), strict=True))
    with panels(picture, 2) as (left, right):
        for name, f in pulls.items():
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
    exact, limit = np.array(f.series["exact"]), np.array(f.series["limit"])
    error = np.maximum(np.abs(limit - exact) / exact, 1e-17)
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


def draw_friction(figures: Mapping[str, Figures], picture: Picture) -> None:
    """Draw iterations against the strength, and loops of all laws at one strength."""
    with panels(picture, 3, 2.6) as (left, middle, right):
        for axes, kind in ((left, "slip"), (middle, "spin")):
            chosen = _of(figures, kind)
            for (name, f), colour, mark in zip(
                chosen.items(), sequence(len(chosen)), MARKS, strict=False
            ):
                axes.plot(f.series["strength"], f.series["worst"], mark, color=colour, label=name)
            threshold(axes, 12, "at most 12")
            axes.set_xscale("log")
            axes.set_ylim(0, 14)
            axes.set_title(f"{kind} friction")
        left.set_ylabel("worst iterations of a step")
        left.set_xlabel("strength (N/m²)")
        middle.set_xlabel("strength (N/m)")
        chosen = _of(figures, "slip")
        for (name, f), colour in zip(chosen.items(), sequence(len(chosen)), strict=True):
            at = list(f.series["strength"]).index(1e5)
            x = MILLIMETRE.factor * np.array(f.series["displacement"][at])
            right.plot(x, f.series["force"][at], color=colour, label=name)
        right.set_xlabel("displacement (mm)")
        right.set_ylabel("force (N)")
        right.set_title("slip, 1e5 N/m²")
        right.legend(fontsize=7, title="slope (s/m)", title_fontsize=7)


def _of(figures: Mapping[str, Figures], kind: str) -> dict[str, Figures]:
    """Return the rows of a kind over strengths, by their slopes."""
    start = f"friction-{kind}-"
    return {
        name.removeprefix(start): f
        for name, f in figures.items()
        if name.startswith(start) and "strength" in f.series
    }


#: Largest displacement by the mode in the picture, over the length of the sheet.
MODE_SIZE = 0.15


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
    points = MILLIMETRE.factor * (rest + MODE_SIZE * np.ptp(rest, axis=0).max() * moved)
    mesh = Triangulation(points[:, 0], points[:, 1], cells)
    axes.tripcolor(mesh, size, cmap=fill(), shading="gouraud")
    axes.triplot(mesh, color=QUIET, linewidth=0.2)
    axes.set_aspect("equal")
    axes.grid(visible=False)
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
    axes.set_title(f"mode at {figures.series['load']:.5g} N", fontsize=7.5, fontweight="normal")


#: Part of the mesh of slivers that is drawn, mm.
SLIVERS_SIZE = 50.0
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
    axes.set_xlim(-2, SLIVERS_SIZE)
    axes.set_ylim(-2, SLIVERS_SIZE)
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
            differences = np.maximum(f.series["differences"], 1e-17)
            label = name.removeprefix("scale-")
            axes.plot(QUANTITIES, differences, mark, color=colour, label=label, markersize=5)
        axes.set_yscale("log")
        axes.set_ylim(3e-18, 1e-8)
        threshold(axes, 1e-9, "at most 1e-9")
        axes.set_ylabel("largest relative difference")
        axes.legend(ncols=1, loc="upper left", bbox_to_anchor=(1.0, 1.0))


def draw_long(figures: Mapping[str, Figures], picture: Picture) -> None:
    """Draw change of the loop, imbalance and memory by cycle."""
    (f,) = figures.values()
    _, dark = sequence(2)
    with panels(picture, 3, 2.4) as (first, second, third):
        differences = np.array(f.series["differences"][:-1])
        cycle = np.arange(1, len(differences) + 1)
        first.plot(cycle, np.maximum(differences, 1e-17), ".", color=dark)
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
