"""The picture of a family of hard cases: what each row took, and how near it came."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wovenfab.hard.row import Figures
from wovenfab.report.style import INK, WIDTH, YARNS, house_style, save


def draw_rows(figures: Mapping[str, Figures], path: Path) -> Path:
    """Draw iterations a step and the smallest admissibility margin of each row.

    Args:
        figures: What each row gave, by its name.
        path: The PNG file.

    Returns:
        The file.
    """
    margins = {name: f.margin for name, f in figures.items() if f.margin is not None}
    with house_style():
        figure = Figure(figsize=(WIDTH, 1.4 + 0.28 * len(figures)))
        panels = figure.subplots(1, 2 if margins else 1, sharey=True, squeeze=False)[0]
        names = list(figures)
        panels[0].barh(names, [figures[n].worst for n in names], color=YARNS[1], label="worst")
        panels[0].plot([figures[n].mean for n in names], names, "o", color=INK, label="mean")
        panels[0].set_xlabel("Newton iterations of a step")
        panels[0].legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2)
        panels[0].invert_yaxis()
        if margins:
            _margins(panels[1], margins)
        return save(figure, path)


def _margins(axes: Axes, margins: Mapping[str, float]) -> None:
    axes.plot(list(margins.values()), list(margins), "o", color=INK)
    axes.set_xscale("log")
    axes.set_xlabel("smallest sine between the families")
