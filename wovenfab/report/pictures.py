"""All pictures and pages of a results directory.

``python3 -m wovenfab.report.pictures DIR`` draws those of a run, prints the path of each, and
what failed on stderr.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from wovenfab.record.field_file import ERROR, FIELDS, MODE
from wovenfab.record.fields import StoredFields
from wovenfab.report import sheet
from wovenfab.report.animation import ANIMATION, animate
from wovenfab.report.curves import loop
from wovenfab.report.run_data import RunData, open_run_data, origin_of, stored_of
from wovenfab.report.style import house_style, save
from wovenfab.report.yarns import write_viewer, write_yarns

Maker = Callable[[Path], list[Path]]


class ReportError(Exception):
    """Some pictures could not be drawn.

    Attributes:
        drawn: The pictures that could.
    """

    def __init__(self, message: str, drawn: list[Path]) -> None:
        """Keep what was drawn beside the message."""
        super().__init__(message)
        self.drawn = drawn


def draw_loop(folder: Path) -> list[Path]:
    """Draw the loop as PNG and as SVG."""
    figure, origin = loop(open_run_data(folder)), origin_of(folder)
    return [save(figure, folder / f"loop.{kind}", origin) for kind in ("png", "svg")]


def picture_of(
    series: str, name: str, figure_of: Callable[[RunData, StoredFields], Figure]
) -> Maker:
    """Return what draws a figure of a series of fields, if the run stored it."""

    def make(folder: Path) -> list[Path]:
        stored = stored_of(folder, series)
        if stored is None:
            return []
        figure = figure_of(open_run_data(folder), stored)
        return [save(figure, folder / f"{name}.png", origin_of(folder))]

    return make


def draw_page(folder: Path) -> list[Path]:
    """Write the page of the run."""
    from wovenfab.report.pages import write_run_page

    return [write_run_page(folder)]


def make_yarns(folder: Path) -> list[Path]:
    """Write the yarns and the script that shows them in ParaView, if there are fields."""
    source, stored = open_run_data(folder), stored_of(folder)
    if stored is None or source.fibres is None:
        return []
    return [*write_yarns(source, stored), write_viewer(folder)]


def draw_animation(folder: Path) -> list[Path]:
    """Draw one cycle in motion."""
    stored = stored_of(folder)
    if stored is None:
        raise ValueError("the run wrote no fields")
    return [animate(open_run_data(folder), stored, folder / ANIMATION, origin_of(folder))]


#: What can be drawn of a run, each from its directory.
MAKERS: dict[str, Maker] = {
    "picture of loop": draw_loop,
    "picture of deformed": picture_of(FIELDS, "deformed", sheet.deformed),
    "picture of mode": picture_of(MODE, MODE, sheet.mode),
    "picture of error": picture_of(ERROR, ERROR, sheet.error),
    "page": draw_page,
    "yarns for ParaView": make_yarns,
    "animation": draw_animation,
}
#: What a run draws at its end.
PICTURES = ("picture of loop", "picture of deformed", "picture of mode", "picture of error")
#: What a report draws.
REPORT = (*PICTURES, "page", "yarns for ParaView")


def draw(directory: str | Path, names: Sequence[str] = PICTURES) -> list[Path]:
    """Draw some of ``MAKERS`` of a run, finished or not, into its directory; return the files.

    What needs fields is left out if the run has none.

    Raises:
        ReportError: Something failed; the rest is drawn all the same.
    """
    folder = Path(directory)
    drawn: list[Path] = []
    problems: list[str] = []
    for name in names:
        try:
            with house_style():
                drawn += MAKERS[name](folder)
        except Exception as error:  # one picture must not cost the others
            reason = " ".join(str(error).split()) or type(error).__name__
            problems.append(f"no {name}: {reason}")
    if problems:
        raise ReportError("; ".join(problems), drawn)
    return drawn


def main(directory: str) -> int:
    """Draw the pictures of a directory; return the exit code."""
    try:
        drawn, problem = draw(directory), ""
    except ReportError as error:
        drawn, problem = error.drawn, str(error)
    for path in drawn:
        print(path)
    print(problem, end="", file=sys.stderr)
    return 1 if problem else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
