"""Work-precision diagrams: the error that is left against what it costs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wovenfab.report.style import INK, QUIET, WIDTH, house_style, save
from wovenfab.study.accuracy import TARGETS
from wovenfab.study.accuracy_result import Run, Study
from wovenfab.study.accuracy_table import QUANTITIES

#: What a run costs, with the label of its axis.
_WALL: tuple[str, Callable[[Run], float]] = ("wall time (s)", lambda r: r.measured.wall)
_MEMORY: tuple[str, Callable[[Run], float]] = (
    "peak memory (MB)",
    lambda r: r.measured.memory / 1e6,
)
_UNKNOWNS: tuple[str, Callable[[Run], float]] = ("unknowns", lambda r: r.measured.unknowns)
_STEPS: tuple[str, Callable[[Run], float]] = ("steps", lambda r: r.measured.steps)

COSTS = {"space": (_UNKNOWNS, _WALL, _MEMORY), "time": (_STEPS, _WALL), "both": (_WALL, _MEMORY)}
#: Curves without an order, apart for the colour-blind (Okabe and Ito, 2008) and in print.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", INK)
_MARKERS = "osD^vPX"
#: Errors are not drawn below this share, where they are round-off.
_LEAST = 1e-8


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
    return [
        _draw(found, stage, runs, directory / f"{name}-{stage}.png")
        for stage, runs in stages
        if runs
    ]


def _draw(found: Study, stage: str, runs: Sequence[Run], path: Path) -> Path:
    quantities, costs = list(found.best[stage]), COSTS[stage]
    with house_style():
        size = (WIDTH, 0.55 + 1.95 * len(quantities))
        figure = Figure(figsize=size)
        grid = figure.subplots(
            len(quantities), len(costs), sharex="col", sharey="row", squeeze=False
        )
        for row, quantity in zip(grid, quantities, strict=True):
            for axes, (_, cost) in zip(row, costs, strict=True):
                _curves(axes, found, stage, runs, quantity, cost)
            row[0].set_ylabel(f"error of {QUANTITIES[quantity][0]}".replace(" energy", "\nenergy"))
        for axes, (label, _) in zip(grid[-1], costs, strict=True):
            axes.set_xlabel(label)
        handles, labels = grid[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=3, fontsize=7.5)
        return save(figure, path)


def _curves(
    axes: Axes,
    found: Study,
    stage: str,
    runs: Sequence[Run],
    quantity: str,
    cost: Callable[[Run], float],
) -> None:
    """Draw one curve a method, and grey where the best answer is no better known."""
    known = found.best[stage][quantity].relative
    methods = list(dict.fromkeys(r.setting.method for r in runs))
    for number, method in enumerate(methods):
        mine = [r for r in runs if r.setting.method == method]
        errors = [max(found.errors(r)[quantity], _LEAST) for r in mine]
        points = [(cost(r), e) for r, e in zip(mine, errors, strict=True) if e > _LEAST]
        axes.loglog(
            [x for x, _ in points],
            [y for _, y in points],
            marker=_MARKERS[number % len(_MARKERS)],
            color=_COLOURS[number % len(_COLOURS)],
            linestyle="none" if stage == "both" else "-",
            markersize=4,
            linewidth=1.2,
            label=method,
        )
    low = axes.get_ylim()[0]
    if known > low:
        axes.axhspan(low, known, color=QUIET, alpha=0.25, linewidth=0)
        axes.set_ylim(bottom=low)
    for target in TARGETS:
        axes.axhline(target, color=QUIET, linewidth=0.6, linestyle=":", zorder=0)
