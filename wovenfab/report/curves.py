"""What a run's history shows besides the loop, as curves and bars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from wovenfab.record.summary import Cycle, window
from wovenfab.report.run_data import RunData
from wovenfab.report.style import APART, DASHES, INK, MILLIMETRE, QUIET, WIDTH, readable

Values = NDArray[np.float64]
History = Mapping[str, Values]


def parts(history: History, kind: str) -> dict[str, Values]:
    """Return the columns of a kind, ``energy`` or ``dissipated`` (J), by effect.

    An effect that never has any is left out.
    """
    start, end = f"{kind}_", "_J"
    named = {
        column.removeprefix(start).removesuffix(end): values
        for column, values in history.items()
        if column.startswith(start) and column.endswith(end) and column != f"{kind}_J"
    }
    return {name: values for name, values in named.items() if np.any(values)}


def program(source: RunData) -> Figure:
    """Return the figure: displacement of the program and its velocity over time."""
    time, u = source.history["time_s"], source.history["displacement_m"]
    figure = Figure(figsize=(WIDTH, 0.3 * WIDTH))
    left, right = figure.subplots(1, 2)
    left.plot(time, u * MILLIMETRE.factor, color=INK)
    left.set_ylabel(f"displacement ({MILLIMETRE.name})")
    speed = np.diff(u) / np.diff(time)
    unit = readable("m/s", float(np.abs(speed).max(initial=0.0)))
    right.plot((time[1:] + time[:-1]) / 2, speed * unit.factor, color=INK)
    right.set_ylabel(f"velocity ({unit.name})")
    for axes in (left, right):
        _over_time(axes)
    return figure


def energies(source: RunData) -> Figure:
    """Return the figure: stored and dissipated energy by effect over time."""
    time, strokes = source.history["time_s"], _strokes(source.history)
    figure = Figure(figsize=(WIDTH, 0.38 * WIDTH))
    for axes, kind, title in zip(
        figure.subplots(1, 2),
        ("energy", "dissipated"),
        ("stored now", "dissipated since the start"),
        strict=True,
    ):
        found = parts(source.history, kind)
        total = source.history[f"{kind}_J"]
        unit = readable("J", float(np.abs(total).max()))
        if len(found) > 1:
            axes.plot(time, total * unit.factor, color=QUIET, linewidth=2.4, label="together")
        ranked = sorted(found, key=lambda name: -float(np.abs(found[name]).max()))
        for name in ranked:
            axes.plot(time, found[name] * unit.factor, label=_words(name), **strokes[name])
        axes.set_title(title, fontsize=9)
        axes.set_ylabel(f"energy ({unit.name})")
        _over_time(axes)
        if found:
            axes.legend(loc="upper left")
        else:
            axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", color=QUIET)
            axes.set(xticks=[], yticks=[], xlabel="", ylabel="")
    return figure


def losses(source: RunData) -> Figure:
    """Return the figure: dissipated energy by effect, and imbalance, of each cycle."""
    found = source.cycles
    names = [f"{i}" if c.complete else f"{i}*" for i, c in enumerate(found, 1)]
    figure = Figure(figsize=(WIDTH, 0.34 * WIDTH))
    left, right = figure.subplots(1, 2)
    unit = readable("J", max(c.dissipated for c in found))
    bottom = np.zeros(len(found))
    strokes = _strokes(source.history)
    for name in parts(source.history, "dissipated"):
        lost = unit.factor * _gains(source.history, f"dissipated_{name}_J", found)
        left.bar(names, lost, 0.6, bottom, color=strokes[name]["color"], label=_words(name))
        bottom += lost
    left.set_ylabel(f"energy dissipated ({unit.name})")
    if left.containers:
        left.bar_label(left.containers[-1], [f"{b:.3g}" for b in bottom], padding=2, fontsize=8)
        left.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
    small = readable("J", max(abs(c.imbalance) for c in found))
    bars = right.bar(names, [c.imbalance * small.factor for c in found], 0.6, color=QUIET)
    right.bar_label(bars, [_share(c) for c in found], padding=2, fontsize=8)
    right.axhline(0, color=INK, linewidth=0.7)
    right.set_ylabel(f"energy imbalance ({small.name})")
    for axes in (left, right):
        axes.set_xlabel("cycle" if all(c.complete for c in found) else "cycle (* not finished)")
        axes.grid(axis="x", visible=False)
        axes.margins(y=0.18)
        axes.set_xlim(-0.6, max(len(found), 4) - 0.4)
    return figure


def solver(source: RunData, seconds: Mapping[str, float]) -> Figure:
    """Return the figure: Newton iterations and length of each step, wall time by phase.

    Args:
        source: The run.
        seconds: Wall time of each phase (s); may be empty.
    """
    step, time = source.history["step"][1:], source.history["time_s"]
    figure = Figure(figsize=(WIDTH, 0.3 * WIDTH))
    left, middle, right = figure.subplots(1, 3)
    left.step(step, source.history["newton_iterations"][1:], where="mid", color=INK, linewidth=1)
    left.set_ylabel("Newton iterations")
    left.set_ylim(bottom=0)
    left.yaxis.get_major_locator().set_params(integer=True)
    length = np.diff(time)
    unit = readable("s", float(length.max(initial=0.0)))
    middle.step(step, length * unit.factor, where="mid", color=INK, linewidth=1)
    middle.set_ylabel(f"length of step ({unit.name})")
    middle.set_ylim(bottom=0)
    for axes in (left, middle):
        axes.set_xlabel("step")
    least = 0.005 * sum(seconds.values())
    shown = {name: value for name, value in seconds.items() if value >= least}
    bars = right.barh(list(shown), list(shown.values()), 0.6, color=APART[0])
    right.bar_label(bars, fmt="%.2g", padding=2, fontsize=8)
    right.set_xlabel("wall time (s)")
    right.grid(axis="y", visible=False)
    right.margins(x=0.18)
    right.invert_yaxis()
    return figure


def _gains(history: History, column: str, found: Sequence[Cycle]) -> Values:
    """Return how much a column grew in each cycle."""
    ways = [window(history, cycle.start, cycle.end)[column] for cycle in found]
    return np.array([way[-1] - way[0] for way in ways])


def _share(cycle: Cycle) -> str:
    """Return the imbalance of a cycle against what moved in it: its loss and its store."""
    size = abs(cycle.dissipated) + abs(cycle.stored_at_peak)
    return f"{100 * cycle.imbalance / size:.1f} %".replace("-", "\N{MINUS SIGN}") if size else ""


def _strokes(history: History) -> dict[str, dict[str, Any]]:
    """Return colour and line style of each effect, the same in all pictures of a run."""
    names = [*parts(history, "energy"), *parts(history, "dissipated")]
    return {
        name: {"color": APART[i % len(APART)], "linestyle": DASHES[i % len(DASHES)]}
        for i, name in enumerate(names)
    }


def _words(effect: str) -> str:
    return effect.replace("_", " ")


def _over_time(axes: Axes) -> None:
    axes.set_xlabel("time (s)")
    axes.axhline(0, color=QUIET, linewidth=0.7, zorder=1)
