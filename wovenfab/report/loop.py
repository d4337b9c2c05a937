"""The force-displacement loop, each cycle in a shade of its own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from wovenfab.record.summary import Cycle, window
from wovenfab.report.run_data import RunData
from wovenfab.report.style import INK, MILLIMETRE, QUIET, WIDTH, Unit, readable, sequence

Values = NDArray[np.float64]


def loop(source: RunData) -> Figure:
    """Return the figure: force against displacement, with the energy lost in each cycle."""
    figure = Figure(figsize=(0.85 * WIDTH, 0.58 * WIDTH))
    axes = figure.add_subplot()
    u, force = source.history["displacement_m"], source.history["force_N"]
    unit = readable("N", float(np.abs(force).max()))
    _draw_cycles(axes, source, unit)
    axes.axhline(0, color=QUIET, linewidth=0.7, zorder=1)
    start = (u[0] * MILLIMETRE.factor, force[0] * unit.factor)
    axes.plot(*start, "o", color=INK, markersize=4, zorder=9)
    axes.annotate(
        "start", start, textcoords="offset points", xytext=(-5, 4), ha="right", fontsize=8
    )
    axes.set_title(fill(source.title, 62))
    axes.set_xlabel(f"displacement ({MILLIMETRE.name})")
    axes.set_ylabel(f"force ({unit.name})")
    axes.margins(x=0.08, y=0.06)
    return figure


def _draw_cycles(axes: Axes, source: RunData, unit: Unit) -> None:
    """Draw each cycle, or the whole history in one colour where no cycle is known.

    Cycles follow each other closely, so earlier ones lie on top of later, longer ones.
    """
    if not source.cycles:
        lost = float(source.history["dissipated_J"][-1])
        axes.plot(*_path(source.history, unit), color=sequence(1)[0], zorder=3)
        if lost > 0:
            axes.legend(
                [axes.lines[-1]], [f"energy dissipated: {_quantity(lost, readable('J', lost))}"]
            )
        return
    most = max(cycle.dissipated for cycle in source.cycles)
    energy = readable("J", most) if most > 0 else None
    count = len(source.cycles)
    for part in _rest(source):
        axes.plot(*_path(part, unit), color=QUIET, linewidth=0.8, zorder=2)
    for number, (cycle, shade) in enumerate(zip(source.cycles, sequence(count), strict=True), 1):
        path = _path(window(source.history, cycle.start, cycle.end), unit)
        label, order = _label(number, cycle, energy), 8 - 5 * number / count
        axes.plot(*path, color=shade, label=label, zorder=order)
        if number == count:
            _draw_sense(axes, *path, shade)
    axes.legend(
        title="cycle" if energy is None else "energy dissipated in cycle",
        loc="upper left",
        alignment="left",
        ncols=1 + (count - 1) // 8,
    )


def _rest(source: RunData) -> Iterator[Mapping[str, Values]]:
    """Yield the parts of the history before, between and after the cycles."""
    time = source.history["time_s"]
    bounds = [time[0], *(t for cycle in source.cycles for t in (cycle.start, cycle.end)), time[-1]]
    for start, end in zip(bounds[::2], bounds[1::2], strict=True):
        if end - start > 1e-9 * (time[-1] - time[0]):
            yield window(source.history, start, end)


def _path(part: Mapping[str, Values], unit: Unit) -> tuple[Values, Values]:
    return part["displacement_m"] * MILLIMETRE.factor, part["force_N"] * unit.factor


def _draw_sense(axes: Axes, u: Values, force: Values, shade: tuple[float, ...]) -> None:
    """Put an arrow head on the way out and on the way back."""
    turn = int(np.abs(u).argmax())
    for first, last in ((0, turn), (turn, len(u) - 1)):
        way = np.abs(np.diff(u[first : last + 1])).cumsum()
        if len(way) < 4:
            continue
        at = first + int(np.searchsorted(way, (0.75 if first == 0 else 0.25) * way[-1]))
        style = {"arrowstyle": "-|>", "color": shade, "mutation_scale": 14, "linewidth": 0}
        tip, tail = ((u[i], force[i]) for i in (at + 1, at))
        axes.annotate("", tip, tail, arrowprops=style, zorder=9)


def _label(number: int, cycle: Cycle, energy: Unit | None) -> str:
    text = f"{number} ({cycle.peak_displacement * MILLIMETRE.factor:.3g} mm)"
    if energy is not None:
        text += f": {_quantity(cycle.dissipated, energy)}"
    return text if cycle.complete else f"{text}, not finished"


def _quantity(value: float, unit: Unit) -> str:
    return f"{value * unit.factor:.3g} {unit.name}"
