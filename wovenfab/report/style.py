"""The house style of all pictures: sober, readable in print and by the colour-blind."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import Colormap, LinearSegmentedColormap
from matplotlib.figure import Figure

from wovenfab.record.results import Provenance, this_process
from wovenfab.report.metadata import stamp

#: Text width of a two-column page (in).
WIDTH = 7.0
INK = "#1a1a1a"
QUIET = "#8a8a8a"
#: Colours of the two yarn families, apart from each other and from every colour of a field.
YARNS = ("#1a1a1a", "#1f5fa8")

#: Colours of things that have no order, apart for the colour-blind (Okabe and Ito, 2008).
APART = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", INK)
#: Line styles that go with them, for print.
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1.5, 1)), (0, (5, 1.5, 1.5, 1.5)))

_SETTINGS = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 8.0,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#ebebeb",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "lines.solid_capstyle": "round",
    "lines.solid_joinstyle": "round",
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.direction": "out",
    "ytick.direction": "out",
    "legend.frameon": False,
    "legend.title_fontsize": 8.5,
    "legend.fontsize": 8.5,
    "svg.fonttype": "none",
    "svg.hashsalt": "wovenfab",
    "savefig.dpi": 220,
    "savefig.bbox": "tight",
    "savefig.pad_inches": 0.08,
    "figure.constrained_layout.use": True,
}


@dataclass(frozen=True)
class Unit:
    """A unit for reading: ``value in SI * factor`` is the number on the axis."""

    name: str
    factor: float


MILLIMETRE = Unit("mm", 1e3)
DEGREE = Unit("°", 57.29577951308232)


@contextmanager
def house_style() -> Iterator[None]:
    """Draw in the house style, without a display, and leave the user's settings alone."""
    with mpl.rc_context(_SETTINGS):
        yield


def readable(unit: str, largest: float) -> Unit:
    """Return the prefixed unit in which ``largest`` (SI) has one to three leading digits."""
    size = abs(largest)
    for prefix, factor in (("M", 1e-6), ("k", 1e-3), ("", 1.0), ("m", 1e3)):
        if size * factor >= 1:
            return Unit(prefix + unit, factor)
    return Unit("µ" + unit, 1e6) if size > 0 else Unit(unit, 1.0)


def said(value: float, unit: str) -> str:
    """Return a value (SI) as people write it, ``535 N``, with three digits."""
    shown = readable(unit, value)
    number = f"{value * shown.factor:.3g}".replace("-", "\N{MINUS SIGN}")
    return f"{number}\N{NO-BREAK SPACE}{shown.name}"


def sequence(count: int) -> list[tuple[float, ...]]:
    """Return ``count`` colours from light to dark; the last one is the same for any count."""
    ramp = mpl.colormaps["viridis_r"]
    return [
        tuple(ramp(1 - 0.18 - 0.62 * (count - 1 - i) / max(count - 1, 1))) for i in range(count)
    ]


def fill() -> Colormap:
    """Return the map of fields: nothing is pale, much is strong, never as dark as a yarn."""
    ramp = mpl.colormaps["YlOrBr"]
    return LinearSegmentedColormap.from_list("fill", [ramp(0.74 * i / 63) for i in range(64)])


def both_ways() -> Colormap:
    """Return the map of fields with a sign: nothing is white, neither end as dark as a yarn."""
    ramp, shares = mpl.colormaps["RdBu_r"], np.linspace(0.14, 0.86, 65)
    return LinearSegmentedColormap.from_list("both ways", [ramp(share) for share in shares])


def save(figure: Figure, path: Path, origin: Provenance | None = None) -> Path:
    """Write a figure such that equal data give equal files; return ``path``.

    Args:
        figure: The figure.
        path: The file, ``.png`` or ``.svg``.
        origin: What made the data, which the file tells; this process if None.
    """
    figure.savefig(path, metadata=stamp(path.suffix, origin or this_process()))
    return path
