"""One cycle in motion: the sheet with its yarns, and below it the current point of the loop."""

from __future__ import annotations

import io
from pathlib import Path
from textwrap import fill

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, to_rgb
from matplotlib.figure import Figure
from PIL import Image

from wovenfab.record.fields import StoredFields
from wovenfab.record.results import Provenance
from wovenfab.record.summary import window
from wovenfab.report.curves import force_axes, path
from wovenfab.report.run_data import RunData, largest, times_between
from wovenfab.report.sheet import draw_outline, draw_yarns, paint, sheet_at
from wovenfab.report.style import (
    INK,
    MILLIMETRE,
    QUIET,
    WIDTH,
    YARNS,
    colour_bar,
    gif_comment,
    main_field,
    scale_of,
    sequence,
)

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
    frames[0].save(
        target,
        save_all=True,
        append_images=frames[1:],
        duration=[max(20, round(1e3 * DURATION * share)) for share in shares],
        loop=0,
        comment=gif_comment(origin),
    )
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
    palette = _palette(scale.ramp if scale else None)
    frames = []
    for index, sheet in zip(shown, sheets, strict=True):
        figure = Figure(figsize=(WIDTH, tall + 3.4))
        figure.set_layout_engine("constrained", w_pad=0.12, h_pad=0.12)
        above, below = figure.subplots(2, 1, height_ratios=[tall, 2.0])
        if scale is not None:
            painted = paint(above, sheet, scale(values[index]), scale.ramp, scale.norm)
            colour_bar(figure, above, painted, scale)
        draw_outline(above, sheet)
        draw_yarns(above, sheet)
        above.set_aspect("equal")
        above.set_axis_off()
        above.set_xlim(low[0] - margin, high[0] + margin)
        above.set_ylim(low[1] - margin, high[1] + margin)
        above.set_title(fill(source.title, 70))
        _draw_loop(below, source, span, float(stored.times[index]))
        frames.append(_picture(figure).quantize(palette=palette, dither=Image.Dither.NONE))
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
    return Image.open(data).convert("RGB")


def _palette(ramp: Colormap | None) -> Image.Image:
    """Return the colours of all frames, the same in all: grey, the yarns' and the field's."""
    grey = np.append(np.linspace(0, 0.93, 31), 1)[:, None] * np.ones(3)
    shades = (*map(to_rgb, YARNS), sequence(1)[0][:3])
    lines = [np.linspace(shade, (1, 1, 1), 8) for shade in shades]
    field = [] if ramp is None else [ramp(np.linspace(0, 1, 72))[:, :3]]
    image = Image.new("P", (1, 1))
    image.putpalette(
        np.round(255 * np.concatenate([grey, *lines, *field])).astype(int).ravel().tolist()
    )
    return image
