"""The history of one run or of several as curves and bars."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from textwrap import fill as wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from wovenfab.record.summary import Cycle, window
from wovenfab.report.run_data import RunData, spread
from wovenfab.report.style import (
    APART,
    DASHES,
    DISPLACEMENT,
    INK,
    MILLIMETRE,
    QUIET,
    WIDTH,
    Unit,
    Values,
    millimetres,
    readable,
    seconds,
    sequence,
    zero_line,
)

#: Of more cycles, pictures show some one by one: nobody could tell them apart.
MOST_CYCLES = 32
History = Mapping[str, Values]
#: A run with the name by which readers know it.
Named = tuple[str, RunData]


def loop(source: RunData) -> Figure:
    """Return the figure: force against displacement, with the energy lost in each cycle."""
    figure = Figure(figsize=(0.85 * WIDTH, 0.58 * WIDTH))
    axes = figure.add_subplot()
    unit = force_axes(axes, [source])
    _draw_cycles(axes, source, unit)
    zero_line(axes)
    start = tuple(values[0] for values in path(source.history, unit))
    axes.plot(*start, "o", color=INK, markersize=4, zorder=9)
    axes.annotate(
        "start", start, textcoords="offset points", xytext=(-5, 4), ha="right", fontsize=8
    )
    axes.set_title(wrap(source.title, 62))
    axes.margins(x=0.08, y=0.06)
    return figure


def loops(runs: Sequence[Named]) -> Figure:
    """Return the figure: force against displacement of all runs."""
    figure = Figure(figsize=(WIDTH, 0.62 * WIDTH))
    axes = figure.add_subplot()
    unit = force_axes(axes, [source for _, source in runs])
    strokes = _strokes([name for name, _ in runs], sequence(len(runs)))
    for name, source in runs:
        axes.plot(*path(source.history, unit), linewidth=1.2, label=name, **strokes[name])
    zero_line(axes)
    _key(figure, axes)
    return figure


def force_axes(axes: Axes, sources: Sequence[RunData]) -> Unit:
    """Label axes of force against displacement; return the unit of force that suits all runs."""
    largest = max(float(np.abs(source.history["force_N"]).max()) for source in sources)
    unit = readable("N", largest)
    axes.set_xlabel(DISPLACEMENT)
    axes.set_ylabel(f"force ({unit.name})")
    return unit


def path(history: History, unit: Unit) -> tuple[Values, Values]:
    """Return displacement (mm) and force (``unit``)."""
    return history["displacement_m"] * MILLIMETRE.factor, history["force_N"] * unit.factor


def parts(history: History, kind: str) -> dict[str, Values]:
    """Return the columns of a kind, ``energy`` or ``dissipated`` (J), by effect.

    An effect that never has any is left out.
    """
    start, end = f"{kind}_", "_J"
    named = {
        column.removeprefix(start).removesuffix(end): values
        for column, values in history.items()
        if column.startswith(start) and column.endswith(end) and column != f"{kind}_J"
    }
    return {name: values for name, values in named.items() if np.any(values)}


def program(source: RunData) -> Figure:
    """Return the figure: displacement of the programs and velocity over time; dotted the second."""
    history, time = source.history, source.history["time_s"]
    names = [n for n in ("displacement_m", "second_displacement_m") if n in history]
    speeds = [np.diff(history[name]) / np.diff(time) for name in names]
    unit = readable("m/s", float(np.abs(speeds).max(initial=0.0)))
    figure = Figure(figsize=(WIDTH, 0.3 * WIDTH))
    left, right = figure.subplots(1, 2)
    for name, speed, style in zip(names, speeds, "-:", strict=False):
        left.plot(time, history[name] * MILLIMETRE.factor, style, color=INK)
        right.plot((time[1:] + time[:-1]) / 2, speed * unit.factor, style, color=INK)
    left.set_ylabel(DISPLACEMENT)
    right.set_ylabel(f"velocity ({unit.name})")
    for axes in (left, right):
        axes.set_xlabel("time (s)")
        zero_line(axes)
    return figure


def energies(source: RunData) -> Figure:
    """Return the figure: stored and dissipated energy by effect over time."""
    time, strokes = source.history["time_s"], _strokes_of_effects(source.history)
    figure = Figure(figsize=(WIDTH, 0.38 * WIDTH))
    for axes, kind, title in zip(
        figure.subplots(1, 2),
        ("energy", "dissipated"),
        ("stored now", "dissipated since the start"),
        strict=True,
    ):
        by_effect = parts(source.history, kind)
        total = source.history[f"{kind}_J"]
        unit = readable("J", float(np.abs(total).max()))
        if len(by_effect) > 1:
            axes.plot(time, total * unit.factor, color=QUIET, linewidth=2.4, label="together")
        for name in sorted(by_effect, key=lambda name: -float(np.abs(by_effect[name]).max())):
            label = name.replace("_", " ")
            axes.plot(time, by_effect[name] * unit.factor, label=label, **strokes[name])
        axes.set_title(title, fontsize=9)
        zero_line(axes)
        if by_effect:
            axes.legend(loc="upper left")
            axes.set(xlabel="time (s)", ylabel=f"energy ({unit.name})")
        else:
            axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", color=QUIET)
            axes.set(xticks=[], yticks=[])
    return figure


def losses(source: RunData) -> Figure:
    """Return the figure: dissipated energy by effect, and imbalance, of each cycle."""
    numbers, cycles = zip(*shown_cycles(source), strict=True)
    history = source.history
    names = [f"{i}" if c.complete else f"{i}*" for i, c in zip(numbers, cycles, strict=True)]
    figure = Figure(figsize=(WIDTH, 0.34 * WIDTH))
    left, right = figure.subplots(1, 2)
    unit = readable("J", max(c.dissipated for c in cycles))
    bottom, strokes = np.zeros(len(cycles)), _strokes_of_effects(history)
    windows = [window(history, cycle.start, cycle.end) for cycle in cycles]
    for name in parts(history, "dissipated"):
        columns = [part[f"dissipated_{name}_J"] for part in windows]
        lost = unit.factor * np.array([column[-1] - column[0] for column in columns])
        label = name.replace("_", " ")
        left.bar(names, lost, 0.6, bottom, color=strokes[name]["color"], label=label)
        bottom += lost
    left.set_ylabel(f"energy dissipated ({unit.name})")
    if left.containers:
        left.bar_label(left.containers[-1], [f"{b:.3g}" for b in bottom], padding=2, fontsize=8)
        left.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2)
    small = readable("J", max(abs(c.imbalance) for c in cycles))
    bars = right.bar(names, [c.imbalance * small.factor for c in cycles], 0.6, color=QUIET)
    right.bar_label(bars, [_share(c) for c in cycles], padding=2, fontsize=8)
    right.axhline(0, color=INK, linewidth=0.7)
    right.set_ylabel(f"energy imbalance ({small.name})")
    for axes in (left, right):
        axes.set_xlabel("cycle" if all(c.complete for c in cycles) else "cycle (* not finished)")
        axes.grid(axis="x", visible=False)
        axes.margins(y=0.18)
        axes.set_xlim(-0.6, max(len(cycles), 4) - 0.4)
    return figure


def solver(source: RunData) -> Figure:
    """Return the figure: Newton iterations and length of each step, wall time by phase."""
    step, length = source.history["step"][1:], np.diff(source.history["time_s"])
    figure = Figure(figsize=(WIDTH, 0.3 * WIDTH))
    left, middle, right = figure.subplots(1, 3)
    unit = readable("s", float(length.max(initial=0.0)))
    for axes, values, label in (
        (left, source.history["newton_iterations"][1:], "Newton iterations"),
        (middle, length * unit.factor, f"length of step ({unit.name})"),
    ):
        axes.step(step, values, where="mid", color=INK, linewidth=1)
        axes.set_ylim(bottom=0)
        axes.set(xlabel="step", ylabel=label)
    left.yaxis.get_major_locator().set_params(integer=True)
    spent: Mapping[str, float] = source.summary.get("wall_time_s", {})
    shown = {k: v for k, v in spent.items() if v >= 0.005 * sum(spent.values())}
    bars = right.barh(list(shown), list(shown.values()), 0.6, color=APART[0])
    right.bar_label(bars, [seconds(value) for value in shown.values()], padding=2, fontsize=8)
    right.set_xlabel("wall time (s)")
    right.grid(axis="y", visible=False)
    right.margins(x=0.25)
    right.invert_yaxis()
    return figure


def energies_of_runs(runs: Sequence[Named]) -> Figure:
    """Return the figure: stored and dissipated energy of all runs over time."""
    return _compared(
        runs,
        ("energy stored", "J", "time (s)", lambda run: _columns(run, "time_s", "energy_J")),
        ("energy dissipated", "J", "time (s)", lambda run: _columns(run, "time_s", "dissipated_J")),
    )


def imbalance_and_iterations(runs: Sequence[Named]) -> Figure:
    """Return the figure: energy imbalance, and Newton iterations since the start."""
    return _compared(
        runs,
        ("energy imbalance", "J", "time (s)", lambda run: _columns(run, "time_s", "imbalance_J")),
        ("Newton iterations", "", "step", _iterations),
    )


def cycle_figures(runs: Sequence[Named]) -> Figure:
    """Return the figure: figures of complete cycles against their reversals."""
    reversal = f"reversal at ({MILLIMETRE.name})"
    return _compared(
        runs,
        ("peak force", "N", reversal, lambda run: _figures(run, "peak_force")),
        ("secant stiffness", "N/m", reversal, lambda run: _figures(run, "secant_stiffness")),
        ("energy dissipated", "J", reversal, lambda run: _figures(run, "dissipated")),
        ("loss ratio", "", reversal, lambda run: _figures(run, "loss_ratio")),
        marker="o",
        markersize=4,
    )


def _columns(run: RunData, against: str, name: str) -> tuple[Values, Values]:
    return run.history[against], run.history[name]


def _iterations(run: RunData) -> tuple[Values, Values]:
    return run.history["step"], run.history["newton_iterations"].cumsum()


def _figures(run: RunData, name: str) -> tuple[Values, Values]:
    """Return reversal (mm) and a figure of each complete cycle that has it."""
    cycles = [c for c in run.cycles if c.complete and getattr(c, name) is not None]
    reversals = np.array([c.peak_displacement for c in cycles]) * MILLIMETRE.factor
    return reversals, np.array([getattr(c, name) for c in cycles])


def _compared(
    runs: Sequence[Named],
    *quantities: tuple[str, str, str, Callable[[RunData], tuple[Values, Values]]],
    **style: Any,
) -> Figure:
    """Return the figure: quantities (label, SI unit, label of abscissa, values) of all runs."""
    rows = len(quantities) // 2
    figure = Figure(figsize=(WIDTH, (0.09 + 0.33 * rows) * WIDTH))
    strokes = _strokes([name for name, _ in runs], sequence(len(runs)))
    for axes, (label, unit, abscissa, values) in zip(
        figure.subplots(rows, 2).flat, quantities, strict=True
    ):
        series = {name: values(source) for name, source in runs}
        largest = max(float(np.abs(y).max(initial=0.0)) for _, y in series.values())
        shown = readable(unit, largest) if unit else Unit("", 1.0)
        for name, (x, y) in series.items():
            stroke = {"linewidth": 1.2, "label": name, **strokes[name]}
            axes.plot(x, y * shown.factor, **stroke, **style)
        axes.set_xlabel(abscissa)
        axes.set_ylabel(f"{label} ({shown.name})" if shown.name else label)
    _key(figure, axes)
    return figure


def _draw_cycles(axes: Axes, source: RunData, unit: Unit) -> None:
    """Draw each cycle, or the whole history in one colour if no cycle is known.

    Cycles follow each other closely, so earlier ones lie on top of later, longer ones.
    """
    if not source.cycles:
        lost = float(source.history["dissipated_J"][-1])
        axes.plot(*path(source.history, unit), color=sequence(1)[0], zorder=3)
        if lost > 0:
            text = f"energy dissipated: {_in_unit(lost, readable('J', lost))}"
            axes.legend([axes.lines[-1]], [text])
        return
    most = max(cycle.dissipated for cycle in source.cycles)
    energy = readable("J", most) if most > 0 else None
    count, shown = len(source.cycles), shown_cycles(source)
    for part in [source.history] if len(shown) < count else _outside_cycles(source):
        axes.plot(*path(part, unit), color=QUIET, linewidth=0.8, zorder=2)
    for (number, cycle), shade in zip(shown, sequence(len(shown)), strict=True):
        values = path(window(source.history, cycle.start, cycle.end), unit)
        label, order = _label(number, cycle, energy), 8 - 5 * number / count
        axes.plot(*values, color=shade, label=label, zorder=order)
        if number == count:
            _draw_sense(axes, *values, shade)
    title = "cycle" if energy is None else "energy dissipated in cycle"
    axes.legend(
        title=title if len(shown) == count else f"{title}, {len(shown)} of {count}",
        loc="upper left",
        alignment="left",
        ncols=1 + (len(shown) - 1) // 8,
    )


def shown_cycles(source: RunData) -> Sequence[tuple[int, Cycle]]:
    """Return the cycles that pictures show one by one, each with its number."""
    return spread(list(enumerate(source.cycles, 1)), MOST_CYCLES)


def _outside_cycles(source: RunData) -> Iterator[History]:
    """Yield the parts of the history before, between and after the cycles."""
    time = source.history["time_s"]
    bounds = [time[0], *(t for cycle in source.cycles for t in (cycle.start, cycle.end)), time[-1]]
    for start, end in zip(bounds[::2], bounds[1::2], strict=True):
        if end - start > 1e-9 * (time[-1] - time[0]):
            yield window(source.history, start, end)


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
    text = f"{number} ({millimetres(cycle.peak_displacement)})"
    if energy is not None:
        text += f": {_in_unit(cycle.dissipated, energy)}"
    return text if cycle.complete else f"{text}, not finished"


def _in_unit(value: float, unit: Unit) -> str:
    return f"{value * unit.factor:.3g} {unit.name}"


def _share(cycle: Cycle) -> str:
    """Return the imbalance of a cycle in per cent of its dissipated and stored energy."""
    size = abs(cycle.dissipated) + abs(cycle.stored_at_peak)
    return f"{100 * cycle.imbalance / size:.1f} %".replace("-", "\N{MINUS SIGN}") if size else ""


def _strokes(names: Sequence[str], colours: Sequence[Any] = APART) -> dict[str, dict[str, Any]]:
    """Return colour and line style by name, for runs or for the effects of one run."""
    return {
        name: {"color": colours[i % len(colours)], "linestyle": DASHES[i % len(DASHES)]}
        for i, name in enumerate(names)
    }


def _strokes_of_effects(history: History) -> dict[str, dict[str, Any]]:
    return _strokes(list({**parts(history, "energy"), **parts(history, "dissipated")}))


def _key(figure: Figure, axes: Axes) -> None:
    """Put the key of one pair of axes above all of them."""
    handles, labels = axes.get_legend_handles_labels()
    widest = max(map(len, labels))
    columns = max(1, min(len(labels), 110 // (widest + 8)))
    figure.legend(handles, labels, loc="outside upper left", ncols=columns, fontsize=8)
