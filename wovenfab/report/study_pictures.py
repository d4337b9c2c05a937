"""The chart of what each effect costs.

Work-precision diagrams: the error that is left against what it costs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil, floor, log10
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from wovenfab.report.style import INK, QUIET, WIDTH, house_style, save, sequence
from wovenfab.study.accuracy.study import QUANTITIES, TARGETS, Run, Study
from wovenfab.study.effects import Row


def draw_costs(rows: Sequence[Row], path: Path) -> Path:
    """Draw compile time, time of a step and unknowns of each scene as bars.

    Args:
        rows: The study; scenes that are not well posed are left out.
        path: The PNG file.
    """
    shown = [(row.scene, row.cost) for row in rows if row.cost is not None]
    names = [scene for scene, _ in shown]
    with house_style():
        figure = Figure(figsize=(WIDTH, 0.9 + 0.28 * len(shown)))
        axes = figure.subplots(1, 3, sharey=True)
        light, dark = sequence(2)
        _bars(axes[0], names, [c.unknowns / 1e3 for _, c in shown], "unknowns (thousand)", dark)
        _bars(axes[1], names, [c.compile for _, c in shown], "compilation (s)", dark)
        parts = (
            (c.tangents * c.assembly, c.factorisations * c.factorisation, c.step) for _, c in shown
        )
        _stack(axes[2], names, [tuple(1e3 * t for t in part) for part in parts], (dark, light))
        axes[0].invert_yaxis()
        figure.legend(loc="outside upper right", ncols=3, fontsize=7, columnspacing=1.0)
        return save(figure, path)


def _bars(
    axes: Axes, names: Sequence[str], sizes: Sequence[float], label: str, colour: tuple[float, ...]
) -> None:
    bars = axes.barh(names, sizes, color=colour, height=0.65)
    axes.bar_label(bars, fmt="%.1f", padding=2, fontsize=7)
    _finish(axes, label)


def _stack(
    axes: Axes,
    names: Sequence[str],
    parts: Sequence[tuple[float, ...]],
    colours: tuple[tuple[float, ...], tuple[float, ...]],
) -> None:
    """Draw assembly, factorisation and the rest of a step, ms."""
    assembly, factorisation, step = zip(*parts, strict=True)
    rest = [s - a - f for a, f, s in parts]
    both = [a + f for a, f, _ in parts]
    axes.barh(names, assembly, color=colours[0], height=0.65, label="assembly")
    axes.barh(
        names, factorisation, left=assembly, color=colours[1], height=0.65, label="factorisation"
    )
    bars = axes.barh(names, rest, left=both, color=QUIET, height=0.65, label="rest")
    axes.bar_label(bars, labels=[f"{s:.0f}" for s in step], padding=2, fontsize=7)
    _finish(axes, "a step (ms)")


def _finish(axes: Axes, label: str) -> None:
    axes.set_xlabel(label)
    axes.grid(axis="y", visible=False)
    axes.margins(x=0.15)
    axes.tick_params(axis="y", length=0)


#: What a run costs.
_Cost = Callable[[Run], float]
_COSTS: dict[str, _Cost] = {
    "unknowns": lambda r: r.measured.unknowns,
    "steps": lambda r: r.measured.steps,
    "wall time (s)": lambda r: r.measured.wall,
    "peak memory (MB)": lambda r: r.measured.memory / 1e6,
}
_SHOWN = {
    "space": ("unknowns", "wall time (s)", "peak memory (MB)"),
    "time": ("steps", "wall time (s)"),
    "both": ("wall time (s)", "peak memory (MB)"),
}
#: Curves without an order, apart for the colour-blind (Okabe and Ito, 2008) and in print.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", INK)
_MARKERS = "osD^vPX"
#: Errors are not drawn below this share, where they are round-off.
_LEAST = 1e-8
#: An axis shows at least so many times its smallest value.
_SPAN = 4.0


def draw_work_precision(found: Study, directory: Path, name: str = "accuracy") -> list[Path]:
    """Draw a diagram for each stage that has runs, log-log, one curve a method.

    Args:
        found: The study.
        directory: Where the PNG files go.
        name: How their names begin.

    Returns:
        The files, ``<name>-space.png`` and so on.
    """
    stages = (("space", found.space), ("time", found.time), ("both", found.both))
    return [_draw(found, s, runs, directory / f"{name}-{s}.png") for s, runs in stages if runs]


def _draw(found: Study, stage: str, runs: Sequence[Run], path: Path) -> Path:
    quantities, costs = list(found.best[stage]), _SHOWN[stage]
    with house_style():
        figure = Figure(figsize=(WIDTH, 0.75 + 1.85 * len(quantities)))
        grid = figure.subplots(
            len(quantities), len(costs), sharex="col", sharey="row", squeeze=False
        )
        for row, quantity in zip(grid, quantities, strict=True):
            for axes, cost in zip(row, costs, strict=True):
                _curves(axes, found, stage, runs, quantity, _COSTS[cost])
            title = QUANTITIES[quantity][0].replace(" per cycle", "\nper cycle")
            row[0].set_ylabel(f"error of {title}")
            row[0].yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{100 * y:g} %"))
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


def _curves(
    axes: Axes, found: Study, stage: str, runs: Sequence[Run], quantity: str, cost: _Cost
) -> None:
    """Draw one curve a method; hollow where the best answer is no better known than the run."""
    least = max(found.best[stage][quantity].relative, _LEAST)
    for number, method in enumerate(dict.fromkeys(r.setting.method for r in runs)):
        mine = [r for r in runs if r.setting.method == method]
        errors = [found.errors(r)[quantity] for r in mine]
        costs = [cost(r) for r in mine]
        colour, marker = _COLOURS[number % len(_COLOURS)], _MARKERS[number % len(_MARKERS)]
        if stage != "both":
            axes.loglog(costs, [max(e, least) for e in errors], color=colour, linewidth=1.2)
        for hollow in (False, True):
            axes.loglog(
                costs,
                [max(e, least) if (e <= least) is hollow else float("nan") for e in errors],
                color=colour,
                marker=marker,
                linestyle="none",
                markersize=4.5,
                markerfacecolor="white" if hollow else colour,
                label=None if hollow else method,
            )
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
