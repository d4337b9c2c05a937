"""Picture of sharp friction."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from benchmarks.hard.pictures.panels import MARKS, panels, threshold
from benchmarks.hard.row import Figures, Picture
from wovenfab.report.style import MILLIMETRE, sequence


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
