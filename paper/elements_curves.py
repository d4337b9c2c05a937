"""What smooth elements hide, as pictures of curves."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from paper.campaign import JUMPING, REFERENCE, Campaign, Results
from paper.claims import RATIOS
from paper.elements import KINDS, Compared
from paper.loop import WAY
from wovenfab.report.style import APART, DASHES, MILLIMETRE, QUIET, WIDTH, readable

#: Strokes by the kind of elements.
_STROKES: dict[str, dict[str, Any]] = {
    kind: {"color": APART[i], "linestyle": DASHES[i], "linewidth": 1.3}
    for kind, i in zip(KINDS, (1, 2, 0), strict=True)
}
_MARKERS = dict(zip(KINDS, "sDo", strict=True))


def loops(campaign: Campaign, results: Results) -> Figure:
    """Return the figure: the largest cycle of each ratio with all kinds of elements."""
    figure = Figure(figsize=(WIDTH, 0.46 * WIDTH))
    runs = campaign.elements.loops
    for axes, (ratio, base) in zip(figure.subplots(1, len(RATIOS)), RATIOS.items(), strict=True):
        found = {kind: results.loops(runs[kind][base])[-1] for kind in (REFERENCE, *KINDS)}
        unit = readable("N", found[REFERENCE].peak)
        for kind, loop in found.items():
            u = np.concatenate([WAY, WAY[::-1]]) * loop.amplitude * MILLIMETRE.factor
            force = np.concatenate([loop.out, loop.back[::-1]]) * unit.factor
            stroke = _STROKES.get(kind, {"color": "#c8c8c8", "linewidth": 4})
            axes.plot(u, force, label=KINDS.get(kind, "reference: may jump, degree 4"), **stroke)
        axes.set_title(ratio)
        axes.axhline(0, color=QUIET, linewidth=0.7, zorder=1)
        axes.set_xlabel(f"displacement ({MILLIMETRE.name})")
        axes.set_ylabel(f"force ({unit.name})")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def errors(found: Compared) -> Figure:
    """Return the figure: errors of the elastic pull, and the slide across the yarn."""
    figure = Figure(figsize=(WIDTH, 0.48 * WIDTH))
    left, right = figure.subplots(1, 2)
    for kind, label in KINDS.items():
        pulls, line = found.pulls[kind], found.profiles[kind]
        sizes = [abs(pull.error) for pull in pulls]
        style = {"marker": _MARKERS[kind], "markersize": 4, **_STROKES[kind]}
        left.loglog([pull.unknowns for pull in pulls], sizes, **style)
        distance, slid = line.distance, line.slid
        if kind == JUMPING:  # no line joins both sides
            distance, slid = (np.insert(a, len(a) // 2, np.nan) for a in (distance, slid))
        factor = MILLIMETRE.factor
        right.plot(distance * factor, slid * factor, label=label, **_STROKES[kind])
    left.set_title("Elastic pull of 20 mm")
    left.xaxis.set_major_locator(FixedLocator([1e3, 2e3, 5e3, 1e4, 2e4, 5e4]))
    left.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x / 1e3:g}"))
    left.xaxis.set_minor_formatter(NullFormatter())
    left.set_xlabel("unknowns (thousands)")
    left.set_ylabel("error of the force")
    left.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{100 * y:g} %"))
    left.yaxis.set_minor_formatter(NullFormatter())
    right.set_title("Across the yarn through a corner")
    right.axvline(0, color=QUIET, linewidth=0.7, zorder=1)
    right.set_xlabel(f"held | distance ({MILLIMETRE.name}) | free")
    right.set_ylabel(f"slid along itself ({MILLIMETRE.name})")
    figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure
