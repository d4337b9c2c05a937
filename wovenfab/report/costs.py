"""The chart of what each effect costs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wovenfab.report.style import QUIET, WIDTH, house_style, save, sequence
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
