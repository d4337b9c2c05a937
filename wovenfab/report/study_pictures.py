"""Pictures of studies: the costs of effects, and work-precision diagrams."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import ceil, floor, log10
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, LogFormatter, NullFormatter

from wovenfab.report.style import (
    APART,
    DASHES,
    QUIET,
    WIDTH,
    Values,
    house_style,
    readable,
    save,
    sequence,
    zero_line,
)
from wovenfab.study.accuracy.study import QUANTITIES, TARGETS, Run, Study
from wovenfab.study.effects import Row

#: Sizes and colour of the parts of stacked bars.
Parts = Mapping[str, tuple[Values, Any]]
_Cost = Callable[[Run], float]
_COSTS: dict[str, _Cost] = {
    "unknowns": lambda r: r.measured.unknowns,
    "steps": lambda r: r.measured.steps,
    "wall time (s)": lambda r: r.measured.wall,
    "peak memory (MB)": lambda r: r.measured.memory / 1e6,
}
#: The costs that are shown of each stage.
_SHOWN = {
    "space": ("unknowns", "wall time (s)", "peak memory (MB)"),
    "time": ("steps", "wall time (s)"),
    "both": ("wall time (s)", "peak memory (MB)"),
}
_MARKERS = "osD^vPX"
#: Errors are not drawn below this share, where they are round-off.
_LEAST = 1e-8
#: Smallest ratio of the ends of an axis.
_SPAN = 4.0


def draw_costs(rows: Sequence[Row], path: Path) -> Path:
    """Draw unknowns, compile time and time of a step of each well-posed scene as bars."""
    shown = {row.scene: row.cost for row in rows if row.cost is not None}
    costs, light, dark = list(shown.values()), *sequence(2)
    assembly = np.array([1e3 * c.tangents * c.assembly for c in costs])
    factorisation = np.array([1e3 * c.factorisations * c.factorisation for c in costs])
    steps = np.array([1e3 * c.step for c in costs])
    parts: Parts = {
        "assembly": (assembly, dark),
        "factorisation": (factorisation, light),
        "rest": (steps - assembly - factorisation, QUIET),
    }
    with house_style():
        figure = Figure(figsize=(WIDTH, 0.9 + 0.28 * len(shown)))
        left, middle, right = figure.subplots(1, 3, sharey=True)
        unknowns = {"_": (np.array([c.unknowns / 1e3 for c in costs]), dark)}
        _bars(left, list(shown), "unknowns (thousand)", unknowns)
        compilation = {"_": (np.array([c.compile for c in costs]), dark)}
        _bars(middle, list(shown), "compilation (s)", compilation)
        _bars(right, list(shown), "a step (ms)", parts, "%.0f")
        left.invert_yaxis()
        figure.legend(loc="outside upper right", ncols=3, fontsize=7, columnspacing=1.0)
        return save(figure, path)


def _bars(axes: Axes, names: Sequence[str], title: str, parts: Parts, digits: str = "%.1f") -> None:
    """Draw stacked bars, of each part its sizes and colour, with the sum at the end."""
    left: Values = np.zeros(len(names))
    for label, (sizes, colour) in parts.items():
        bars = axes.barh(names, sizes, 0.65, left, color=colour, label=label)
        left = left + sizes
    axes.bar_label(bars, [digits % total for total in left], padding=2, fontsize=7)
    axes.set_xlabel(title)
    axes.grid(axis="y", visible=False)
    axes.margins(x=0.15)
    axes.tick_params(axis="y", length=0)


def draw_work_precision(study: Study, directory: Path, name: str = "accuracy") -> list[Path]:
    """Draw a diagram for each stage that has runs, log-log, one curve a method.

    Returns the files ``<name>-space.png`` and so on.
    """
    stages = (("space", study.space), ("time", study.time), ("both", study.both))
    return [_draw(study, s, runs, directory / f"{name}-{s}.png") for s, runs in stages if runs]


def _draw(study: Study, stage: str, runs: Sequence[Run], path: Path) -> Path:
    quantities, costs = list(study.best[stage]), _SHOWN[stage]
    with house_style():
        figure = Figure(figsize=(WIDTH, 0.75 + 1.85 * len(quantities)))
        grid = figure.subplots(
            len(quantities), len(costs), sharex="col", sharey="row", squeeze=False
        )
        for row, quantity in zip(grid, quantities, strict=True):
            for axes, cost in zip(row, costs, strict=True):
                _curves(axes, study, stage, runs, quantity, _COSTS[cost])
            title = QUANTITIES[quantity][0].replace(" per cycle", "\nper cycle")
            row[0].set_ylabel(f"error of {title}")
            row[0].yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{100 * y:g} %"))
            row[0].yaxis.set_minor_formatter(_FewPercents())
        for axes, cost in zip(grid[-1], costs, strict=True):
            axes.set_xlabel(cost)
            _ticks(axes, [_COSTS[cost](r) for r in runs])
        handles, labels = grid[0][0].get_legend_handles_labels()
        handles.append(
            Line2D([], [], color=QUIET, linestyle="none", marker="o", markersize=4, mfc="none")
        )
        labels.append("at most: the best answer is no better known")
        figure.legend(handles, labels, loc="outside upper center", ncols=3, fontsize=7.5)
        return save(figure, path)


class _FewPercents(LogFormatter):
    """Labels between powers of ten where these are few."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f"{100 * x:g} %" if super().__call__(x, pos) else ""


def _curves(
    axes: Axes, study: Study, stage: str, runs: Sequence[Run], quantity: str, cost: _Cost
) -> None:
    """Draw one curve a method; hollow if the error is below the uncertainty of the reference."""
    least = max(study.best[stage][quantity].relative, _LEAST)
    for number, method in enumerate(dict.fromkeys(r.setting.method for r in runs)):
        own = [r for r in runs if r.setting.method == method]
        errors = np.array([study.errors(r)[quantity] for r in own])
        costs, shown, hollow = [cost(r) for r in own], np.maximum(errors, least), errors <= least
        style = {"color": APART[number % len(APART)], "markersize": 4.5, "linestyle": "none"}
        style["marker"] = _MARKERS[number % len(_MARKERS)]
        if stage != "both":
            axes.loglog(costs, shown, color=style["color"], linewidth=1.2)
        axes.loglog(costs, np.where(hollow, np.nan, shown), label=method, **style)
        axes.loglog(costs, np.where(hollow, shown, np.nan), markerfacecolor="white", **style)
    for target in TARGETS:
        axes.axhline(target, color=QUIET, linewidth=0.6, linestyle=":", zorder=0)


def _ticks(axes: Axes, costs: Sequence[float]) -> None:
    """Give a logarithmic axis that may span less than a decade a few plain numbers."""
    low, high = min(costs), max(costs)
    middle = (low * high) ** 0.5
    wide = max(high / low * 1.3, _SPAN) ** 0.5
    axes.set_xlim(middle / wide, middle * wide)
    digits = (1.0,) if wide > 6 else (1.0, 2.0, 5.0) if wide > 3 else (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
    decades = range(floor(log10(middle / wide)), ceil(log10(middle * wide)) + 1)
    marks = [digit * 10.0**n for n in decades for digit in digits]
    inside = [mark for mark in marks if middle / wide <= mark <= middle * wide]
    axes.xaxis.set_major_locator(FixedLocator(inside))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def draw_sensitivities(
    columns: Mapping[str, Sequence[float]], values: Mapping[str, float], path: Path
) -> Path:
    """Draw what one per cent more of each parameter changes in force and dissipated energy.

    Args:
        columns: Of ``study.effects.sensitivities``.
        values: Of the parameters by their names, in SI units; 1 for a common factor.
        path: The picture.
    """
    time = np.asarray(columns["time_s"])
    with house_style():
        figure = Figure(figsize=(WIDTH, 0.7 * WIDTH))
        pairs = zip(figure.subplots(2, 1, sharex=True), ("force", "dissipated"), strict=True)
        for axes, what in pairs:
            base = "force_N" if what == "force" else "dissipated_J"
            unit = readable(base[-1], 0.01 * float(np.abs(columns[base]).max()))
            for i, (name, value) in enumerate(values.items()):
                change = 0.01 * value * np.asarray(columns[f"d_{what}/d_{name}"])
                style = DASHES[i // len(APART) % len(DASHES)]
                colour = APART[i % len(APART)]
                axes.plot(
                    time, unit.factor * change, color=colour, linestyle=style, label=shown(name)
                )
            noun = "force" if what == "force" else "dissipated energy"
            axes.set_ylabel(f"change of {noun} ({unit.name})")
            zero_line(axes)
        axes.set_xlabel("time (s)")
        figure.suptitle("One per cent more of each parameter", fontsize=10)
        handles, names = axes.get_legend_handles_labels()
        figure.legend(handles, names, loc="outside right upper", fontsize=7)
        return save(figure, path)


def shown(name: str) -> str:
    """Return the name of a parameter, also where the derivative is by the factor of its values."""
    return name.removeprefix("ln(").removesuffix(")") if name.startswith("ln(") else name
