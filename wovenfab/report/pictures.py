"""All pictures and pages of a results directory, and the animation of a cycle.

``python3 -m wovenfab.report.pictures DIR`` draws those of a run, prints the path of each, and
what failed on stderr.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from textwrap import fill

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from wovenfab.plain_text import one_line, printable
from wovenfab.record.field_file import ERROR, FIELDS, MODE
from wovenfab.record.fields import StoredFields
from wovenfab.record.reading import UnreadableResultsError
from wovenfab.record.results import Provenance, write_whole
from wovenfab.record.summary import window
from wovenfab.report import sheet
from wovenfab.report.curves import force_axes, loop, path
from wovenfab.report.page_blocks import PageSection
from wovenfab.report.run_data import (
    RunData,
    largest,
    open_run_data,
    origin_of,
    stored_of,
    times_between,
)
from wovenfab.report.sheet import draw_outline, draw_yarns, paint, sheet_at
from wovenfab.report.style import (
    INK,
    MILLIMETRE,
    QUIET,
    WIDTH,
    colour_bar,
    few_colours,
    gif_comment,
    house_style,
    main_field,
    save,
    scale_of,
    sequence,
)
from wovenfab.report.yarns import write_viewer, write_yarns

Maker = Callable[[Path], list[Path]]


class ReportError(Exception):
    """Some pictures could not be drawn.

    Attributes:
        drawn: The pictures that could.
        damaged: Whether a file of the results is damaged.
    """

    def __init__(self, message: str, drawn: list[Path], damaged: bool = False) -> None:
        """Keep what was drawn beside the message."""
        super().__init__(message)
        self.drawn, self.damaged = drawn, damaged


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


def draw_page(folder: Path, more: Sequence[PageSection] = ()) -> list[Path]:
    """Write the page of the run, with more sections first."""
    from wovenfab.report.pages import write_run_page

    return [write_run_page(folder, more)]


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


def draw(
    directory: str | Path,
    names: Sequence[str] = PICTURES,
    makers: Mapping[str, Maker] = MAKERS,
) -> list[Path]:
    """Draw some of ``makers`` of a run, finished or not, into its directory; return the files.

    What needs fields is left out if the run has none.

    Raises:
        ReportError: Something failed; the rest is drawn all the same.
    """
    folder = Path(directory)
    drawn: list[Path] = []
    problems: dict[str, list[str]] = {}
    damaged = False
    for name in names:
        try:
            with house_style():
                drawn += makers[name](folder)
        except Exception as error:  # one picture must not cost the others
            reason = one_line(str(error)) or type(error).__name__
            problems.setdefault(reason, []).append(f"no {name}")
            damaged = damaged or isinstance(error, UnreadableResultsError)
    if problems:
        said = (f"{', '.join(lost)}: {reason}" for reason, lost in problems.items())
        raise ReportError("; ".join(said), drawn, damaged)
    return drawn


def main(directory: str) -> int:
    """Draw the pictures of a directory; return the exit code."""
    try:
        drawn, problem = draw(directory), ""
    except ReportError as error:
        drawn, problem = error.drawn, str(error)
    for picture in drawn:
        print(printable(str(picture)))
    print(problem, end="", file=sys.stderr)
    return 1 if problem else 0


#: Name of the file.
ANIMATION = "animation.gif"
#: Duration of the cycle in the animation (s), and width (pixels).
DURATION, PIXELS = 5.0, 600


def animate(source: RunData, stored: StoredFields, target: Path, origin: Provenance) -> Path:
    """Write the last complete cycle, or the whole run, as a GIF that repeats.

    Every frame is a stored time, and stands as long as its share of the cycle. Returns
    ``target``, the GIF with its provenance.
    """
    complete = [(cycle.start, cycle.end) for cycle in source.cycles if cycle.complete]
    span = (float(stored.times[0]), float(stored.times[-1]) or 1.0)
    span = complete[-1] if complete else span
    shown = times_between(stored, *span)
    frames = _frames(source, stored, [int(index) for index in shown], span)
    shares = np.diff(stored.times[shown]) / (span[1] - span[0]) if len(shown) > 1 else np.ones(1)
    frames = frames[: len(shares)]  # the last one is the first one of the next round
    data = io.BytesIO()
    frames[0].save(
        data,
        format="gif",
        save_all=True,
        append_images=frames[1:],
        duration=[max(20, round(1e3 * DURATION * share)) for share in shares],
        loop=0,
        comment=gif_comment(origin),
    )
    write_whole(target, data.getvalue())
    return target


def _frames(
    source: RunData, stored: StoredFields, shown: list[int], span: tuple[float, float]
) -> list[Image.Image]:
    """Return a picture of each stored time, given by its index."""
    name = main_field(stored, largest(source, stored).index)
    values = {i: stored.field(name, i) for i in shown} if name else {}
    scale = scale_of(name, stored.units[name], list(values.values())) if name else None
    sheets = [sheet_at(source, stored, index) for index in shown]
    places = np.concatenate([sheet.points for sheet in sheets]) * MILLIMETRE.factor
    low, high = places.min(axis=0), places.max(axis=0)
    margin = 0.03 * float((high - low).max())
    tall = float(np.clip(WIDTH * (high - low)[1] / (high - low)[0], 1.0, 6.0))
    frames = []
    for index, state in zip(shown, sheets, strict=True):
        figure = Figure(figsize=(WIDTH, tall + 3.4))
        figure.set_layout_engine("constrained", w_pad=0.12, h_pad=0.12)
        above, below = figure.subplots(2, 1, height_ratios=[tall, 2.0])
        if scale is not None:
            painted = paint(above, state, scale(values[index]), scale.ramp, scale.norm)
            colour_bar(figure, above, painted, scale)
        draw_outline(above, state)
        draw_yarns(above, state)
        above.set_aspect("equal")
        above.set_axis_off()
        above.set_xlim(low[0] - margin, high[0] + margin)
        above.set_ylim(low[1] - margin, high[1] + margin)
        above.set_title(fill(source.title, 70))
        _draw_loop(below, source, span, float(stored.times[index]))
        frames.append(few_colours(_picture(figure)))
    return frames


def _draw_loop(axes: Axes, source: RunData, span: tuple[float, float], time: float) -> None:
    """Draw the whole loop thinly, this cycle clearly, and its current point."""
    unit = force_axes(axes, [source])
    axes.plot(*path(source.history, unit), color=QUIET, linewidth=0.6)
    cycle = window(source.history, *span)
    axes.plot(*path(cycle, unit), color=sequence(1)[0])
    point = [np.interp(time, cycle["time_s"], values) for values in path(cycle, unit)]
    axes.plot(*point, "o", color=INK, markersize=6)


def _picture(figure: Figure) -> Image.Image:
    data = io.BytesIO()
    with mpl.rc_context({"savefig.bbox": None}):  # all frames of one size
        figure.savefig(data, format="png", dpi=PIXELS / WIDTH)
    return Image.open(data)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
