"""``python -m benchmarks.accuracy_picture`` draws what accuracy costs in time, for README.md.

The numbers are those of docs/accuracy.md: of the case that README.md shows, one cycle.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from wovenfab.record.results import COMMAND
from wovenfab.report.style import APART, INK, QUIET, house_style, save

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "accuracy.md"
PICTURE = ROOT / "docs" / "pictures" / "accuracy.png"
SECTION = "## Two placements, slip friction\n"
SPACE, BOTH = "**Space**", "**Both together**"
_PER_CENT = re.compile(r"([\d.e-]+) %")
_MARKERS = "osD^v"


@dataclass(frozen=True)
class Measured:
    """A run in a table.

    Attributes:
        method: Elements and mesh, without the size of cells.
        seconds: Wall time, s.
        error: Of the worst quantity; an upper bound if the answer is no better known.
        bound: Whether it is such a bound.
    """

    method: str
    seconds: float
    error: float
    bound: bool


def rows(page: str, table: str) -> Iterator[Measured]:
    """Yield the runs of a table of the section, ``SPACE`` or ``BOTH``."""
    section = page.split(SECTION)[1].split("\n## ")[0]
    for line in section.split(table)[1].split("\n**")[0].splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if errors := [float(e) for cell in cells[6:] for e in _PER_CENT.findall(cell)]:
            method = re.sub(r", [\d.]+ mm.*", "", cells[0])
            bound = any("≤" in cell for cell in cells[6:])
            yield Measured(method, float(cells[4]), max(errors) / 100, bound)


def draw(page: str, path: Path) -> Path:
    """Draw errors against wall times and return the picture."""
    space, both = list(rows(page, SPACE)), list(rows(page, BOTH))
    with house_style():
        figure = Figure(figsize=(5.0, 3.9))
        axes = figure.subplots()
        for number, method in enumerate(dict.fromkeys(run.method for run in space)):
            own = [run for run in space if run.method == method]
            colour, marker = APART[number], _MARKERS[number]
            times, errors = [r.seconds for r in own], [r.error for r in own]
            axes.loglog(times, errors, color=colour, marker=marker, markersize=4.5, label=method)
            bounds = [run for run in own if run.bound]
            axes.loglog([r.seconds for r in bounds], [r.error for r in bounds], color=colour,
                        marker=marker, markersize=4.5, linestyle="none", mfc="white")  # fmt: skip
        axes.loglog([r.seconds for r in both], [r.error for r in both], color=INK, marker="*",
                    markersize=10, linestyle="none", label="mesh and steps, cheapest")  # fmt: skip
        for target in (0.01, 0.001):
            axes.axhline(target, color=QUIET, linewidth=0.6, linestyle=":", zorder=0)
        axes.set_xlabel("wall time (s)")
        axes.set_ylabel("error of the worst of three quantities")
        axes.set_yticks([1e-4, 1e-3, 1e-2, 1e-1], ["0.01 %", "0.1 %", "1 %", "10 %"])
        axes.set_xticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
        axes.set_xticks([], minor=True)
        figure.legend(loc="outside upper center", ncols=2, fontsize=7.5)
        return save(figure, path, dpi=160)


if __name__ == "__main__":
    os.environ[COMMAND] = "make accuracy"  # which makes the page and draws it, too
    print(draw(PAGE.read_text(encoding="utf-8"), PICTURE))
