"""What the pictures share: panels in the house style, and thresholds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.hard.row import Picture
from wovenfab.report.style import QUIET, WIDTH, house_style, save

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
