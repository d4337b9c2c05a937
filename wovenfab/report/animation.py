"""One cycle in motion: the sheet with its yarns, and below it where the loop stands."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from wovenfab.record.fields import StoredFields
from wovenfab.record.results import Provenance
from wovenfab.record.summary import window
from wovenfab.report.field_styles import Scale, colour_bar, scale_of, telling_field
from wovenfab.report.metadata import comment
from wovenfab.report.run_data import RunData, largest
from wovenfab.report.sheet import Sheet, draw_outline, draw_yarns, paint, sheet_at
from wovenfab.report.style import INK, MILLIMETRE, QUIET, WIDTH, YARNS, readable, sequence

#: Name of the file.
ANIMATION = "animation.gif"
#: The cycle takes so long in the animation (s), whatever it took.
DURATION = 5.0
#: Width (pixels).
PIXELS = 900


def animate(source: RunData, stored: StoredFields, path: Path, origin: Provenance) -> Path:
    """Write the last complete cycle, or the whole run, as a GIF that repeats.

    Every frame is a stored time, and stands as long as its share of the cycle.

    Args:
        source: The run.
        stored: Its fields.
        path: The GIF.
        origin: What made it.

    Returns:
        ``path``.
    """
    start, end = _span(source, stored)
    slack = 1e-9 * end
    (shown,) = np.nonzero((stored.times >= start - slack) & (stored.times <= end + slack))
    frames = _frames(source, stored, [int(i) for i in shown], (start, end))
    lasting = np.diff(stored.times[shown]) / (end - start) if len(shown) > 1 else np.ones(1)
    frames = frames[: len(lasting)]  # the last one is the first one of the next round
    frames[0].save(
        path,
        save_all=True,
        append_images=frames[1:],
        duration=[max(20, round(1e3 * DURATION * share)) for share in lasting],
        loop=0,
        comment=comment(origin).encode(),
    )
    return path


def _span(source: RunData, stored: StoredFields) -> tuple[float, float]:
    """Return start and end (s) of what is shown."""
    complete = [cycle for cycle in source.cycles if cycle.complete]
    if complete:
        return complete[-1].start, complete[-1].end
    return float(stored.times[0]), float(stored.times[-1]) or 1.0


def _frames(
    source: RunData, stored: StoredFields, shown: Sequence[int], span: tuple[float, float]
) -> list[Image.Image]:
    """Return a picture of each stored time, given by its place."""
    name = telling_field(stored, largest(source, stored).index)
    scale = None
    if name is not None:
        scale = scale_of(name, stored.units[name], [stored.field(name, i) for i in shown])
    sheets = [sheet_at(source, stored, index) for index in shown]
    places = np.concatenate([sheet.mesh.points + sheet.mean for sheet in sheets])
    low, high = (f(places, axis=0) * MILLIMETRE.factor for f in (np.min, np.max))
    palette = _palette(scale.ramp if scale else None)
    frames = []
    for index, sheet in zip(shown, sheets, strict=True):
        figure, above, below = _axes(high - low)
        values = None if name is None else stored.field(name, index)
        _draw_sheet(figure, above, sheet, values, scale)
        margin = 0.03 * float((high - low).max())
        above.set_xlim(low[0] - margin, high[0] + margin)
        above.set_ylim(low[1] - margin, high[1] + margin)
        above.set_title(fill(source.title, 70))
        _draw_loop(below, source, span, float(stored.times[index]))
        frames.append(_picture(figure).quantize(palette=palette, dither=Image.Dither.NONE))
    return frames


def _axes(size: NDArray[np.float64]) -> tuple[Figure, Axes, Axes]:
    """Return a figure with axes for the sheet and, below, for the loop."""
    high = float(np.clip(WIDTH * size[1] / size[0], 1.0, 6.0))
    figure = Figure(figsize=(WIDTH, high + 3.4))
    figure.set_layout_engine("constrained", w_pad=0.12, h_pad=0.12)
    above, below = figure.subplots(2, 1, height_ratios=[high, 2.0])
    above.set_aspect("equal")
    above.set_axis_off()
    return figure, above, below


def _draw_sheet(
    figure: Figure,
    axes: Axes,
    sheet: Sheet,
    values: NDArray[np.float64] | None,
    scale: Scale | None,
) -> None:
    if values is not None and scale is not None:
        painted = paint(axes, sheet, scale(values), scale.ramp, scale.norm)
        colour_bar(figure, axes, painted, scale)
    draw_outline(axes, sheet)
    draw_yarns(axes, sheet)


def _draw_loop(axes: Axes, source: RunData, span: tuple[float, float], time: float) -> None:
    """Draw all of the loop quietly, this cycle clearly, and where it stands now."""
    unit = readable("N", float(np.abs(source.history["force_N"]).max()))
    history = source.history
    axes.plot(
        history["displacement_m"] * MILLIMETRE.factor,
        history["force_N"] * unit.factor,
        color=QUIET,
        linewidth=0.6,
    )
    cycle = window(history, *span)
    u, force = cycle["displacement_m"] * MILLIMETRE.factor, cycle["force_N"] * unit.factor
    axes.plot(u, force, color=sequence(1)[0])
    now = [np.interp(time, cycle["time_s"], values) for values in (u, force)]
    axes.plot(*now, "o", color=INK, markersize=6)
    axes.set_xlabel(f"displacement ({MILLIMETRE.name})")
    axes.set_ylabel(f"force ({unit.name})")


def _picture(figure: Figure) -> Image.Image:
    data = io.BytesIO()
    with mpl.rc_context({"savefig.bbox": None}):  # all frames of one size
        figure.savefig(data, format="png", dpi=PIXELS / WIDTH)
    return Image.open(data).convert("RGB")


def _palette(ramp: Colormap | None) -> Image.Image:
    """Return the colours of all frames, so that nothing flickers: the field's, grey, yarns'."""
    grey = np.append(np.linspace(0, 0.93, 63), 1)[:, None] * np.ones(3)
    shades = (*map(to_rgb, YARNS), sequence(1)[0][:3])
    lines = [np.linspace(shade, (1, 1, 1), 16) for shade in shades]
    field = [] if ramp is None else [ramp(np.linspace(0, 1, 144))[:, :3]]
    image = Image.new("P", (1, 1))
    image.putpalette(
        np.round(255 * np.concatenate([grey, *lines, *field])).astype(int).ravel().tolist()
    )
    return image
