"""Several runs in one picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wovenfab.record.summary import Cycle
from wovenfab.report.run_data import RunData
from wovenfab.report.style import DASHES, MILLIMETRE, QUIET, WIDTH, readable, sequence

#: A run with the name by which readers know it.
Named = tuple[str, RunData]


def loops(runs: Sequence[Named]) -> Figure:
    """Return the figure: force against displacement of all runs."""
    figure = Figure(figsize=(WIDTH, 0.62 * WIDTH))
    axes = figure.add_subplot()
    unit = readable("N", max(float(np.abs(s.history["force_N"]).max()) for _, s in runs))
    for stroke, (_, source) in zip(_strokes(runs), runs, strict=True):
        u, force = source.history["displacement_m"], source.history["force_N"]
        axes.plot(u * MILLIMETRE.factor, force * unit.factor, linewidth=1.2, **stroke)
    axes.axhline(0, color=QUIET, linewidth=0.7, zorder=1)
    axes.set_xlabel(f"displacement ({MILLIMETRE.name})")
    axes.set_ylabel(f"force ({unit.name})")
    _key(figure, axes)
    return figure


def energies(runs: Sequence[Named]) -> Figure:
    """Return the figure: stored and dissipated energy of all runs over time."""
    return _over(
        runs,
        ("energy stored", "J", "time_s", lambda s: s.history["energy_J"]),
        ("energy dissipated", "J", "time_s", lambda s: s.history["dissipated_J"]),
    )


def efforts(runs: Sequence[Named]) -> Figure:
    """Return the figure: energy imbalance, and Newton iterations since the start."""
    return _over(
        runs,
        ("energy imbalance", "J", "time_s", lambda s: s.history["imbalance_J"]),
        ("Newton iterations", "", "step", lambda s: s.history["newton_iterations"].cumsum()),
    )


def cycle_figures(runs: Sequence[Named]) -> Figure:
    """Return the figure: figures of complete cycles against their reversals."""
    wanted: tuple[tuple[str, str, Callable[[Cycle], float | None]], ...] = (
        ("peak force", "N", lambda c: c.peak_force),
        ("secant stiffness", "N/m", lambda c: c.secant_stiffness),
        ("energy dissipated", "J", lambda c: c.dissipated),
        ("loss ratio", "", lambda c: c.loss_ratio),
    )
    figure = Figure(figsize=(WIDTH, 0.75 * WIDTH))
    for axes, (label, unit, value) in zip(figure.subplots(2, 2).flat, wanted, strict=True):
        series = [_series(source, value) for _, source in runs]
        largest = max((abs(y) for points in series for _, y in points), default=0.0)
        shown = readable(unit, largest) if unit else None
        for stroke, points in zip(_strokes(runs), series, strict=True):
            x, y = np.reshape(points, (-1, 2)).T
            y = y * (shown.factor if shown else 1)
            axes.plot(x * MILLIMETRE.factor, y, marker="o", markersize=4, **stroke)
        axes.set_xlabel(f"reversal at ({MILLIMETRE.name})")
        axes.set_ylabel(f"{label} ({shown.name})" if shown else label)
    _key(figure, axes)
    return figure


def _series(source: RunData, value: Callable[[Cycle], float | None]) -> list[tuple[float, float]]:
    """Return reversal (m) and value of each complete cycle that has one."""
    found = [(c.peak_displacement, value(c)) for c in source.cycles if c.complete]
    return [(x, y) for x, y in found if y is not None]


def _over(runs: Sequence[Named], *wanted: tuple[str, str, str, Callable[[RunData], Any]]) -> Figure:
    """Return two pairs of axes with a column of each run against time or step."""
    figure = Figure(figsize=(WIDTH, 0.42 * WIDTH))
    for axes, (label, unit, against, values) in zip(figure.subplots(1, 2), wanted, strict=True):
        series = [values(source) for _, source in runs]
        shown = readable(unit, max(float(np.abs(v).max()) for v in series)) if unit else None
        for stroke, (_, source), y in zip(_strokes(runs), runs, series, strict=True):
            x = source.history[against]
            axes.plot(x, y * (shown.factor if shown else 1), linewidth=1.2, **stroke)
        axes.set_xlabel("time (s)" if against == "time_s" else "step")
        axes.set_ylabel(f"{label} ({shown.name})" if shown else label)
    _key(figure, axes)
    return figure


def _strokes(runs: Sequence[Named]) -> list[dict[str, Any]]:
    """Return colour, line style and label of each run."""
    return [
        {"color": shade, "linestyle": DASHES[i % len(DASHES)], "label": name}
        for i, (shade, (name, _)) in enumerate(zip(sequence(len(runs)), runs, strict=True))
    ]


def _key(figure: Figure, axes: Axes) -> None:
    """Put the key of one pair of axes above all of them."""
    handles, labels = axes.get_legend_handles_labels()
    widest = max(map(len, labels))
    columns = max(1, min(len(labels), 110 // (widest + 8)))
    figure.legend(handles, labels, loc="outside upper left", ncols=columns, fontsize=8)
