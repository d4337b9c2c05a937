"""Pictures of studies: the costs of effects, and what accuracy costs in time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import ceil, floor, log10
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from wovenfab.measured.curve import Measured
from wovenfab.report.style import (
    APART,
    DASHES,
    DISPLACEMENT,
    INK,
    MILLIMETRE,
    QUIET,
    WIDTH,
    Values,
    house_style,
    readable,
    save,
    sequence,
    zero_line,
)
from wovenfab.study.accuracy import Priced, Study
from wovenfab.study.effects import EffectRow
from wovenfab.study.fit.prediction import QUANTITIES
from wovenfab.study.fit.response import curve_of_history

#: Sizes and colour of the parts of stacked bars.
Parts = Mapping[str, tuple[Values, Any]]
_MARKERS = "osD"
#: Errors are not drawn below this share, where they are round-off.
_LEAST = 1e-8
#: Smallest ratio of the ends of an axis.
_SPAN = 4.0


def draw_costs(rows: Sequence[EffectRow], path: Path) -> Path:
    """Draw unknowns, compile time and time of a step of each well-posed scene as bars."""
    shown = {row.scene: row.cost for row in rows if row.cost is not None}
    costs, light, dark = list(shown.values()), *sequence(2)
    assembly = np.array([1e3 * c.tangents * c.assembly for c in costs])
    factorisation = np.array([1e3 * c.factorisations * c.factorisation for c in costs])
    steps = np.array([1e3 * c.step for c in costs])
    parts: Parts = {
        "assembly": (assembly, dark),
        "factorisation": (factorisation, light),
        "rest": (steps - assembly - factorisation, QUIET),
    }
    with house_style():
        figure = Figure(figsize=(WIDTH, 0.9 + 0.28 * len(shown)))
        left, middle, right = figure.subplots(1, 3, sharey=True)
        unknowns = {"_": (np.array([c.unknowns / 1e3 for c in costs]), dark)}
        _bars(left, list(shown), "unknowns (thousand)", unknowns)
        compilation = {"_": (np.array([c.compile for c in costs]), dark)}
        _bars(middle, list(shown), "compilation (s)", compilation)
        _bars(right, list(shown), "a step (ms)", parts, "%.0f")
        left.invert_yaxis()
        figure.legend(loc="outside upper right", ncols=3, fontsize=7, columnspacing=1.0)
        return save(figure, path)


def _bars(axes: Axes, names: Sequence[str], title: str, parts: Parts, digits: str = "%.1f") -> None:
    """Draw stacked bars, of each part its sizes and colour, with the sum at the end."""
    left: Values = np.zeros(len(names))
    for label, (sizes, colour) in parts.items():
        bars = axes.barh(names, sizes, 0.65, left, color=colour, label=label)
        left = left + sizes
    axes.bar_label(bars, [digits % total for total in left], padding=2, fontsize=7)
    axes.set_xlabel(title)
    axes.grid(axis="y", visible=False)
    axes.margins(x=0.15)
    axes.tick_params(axis="y", length=0)


def draw_accuracy(study: Study, path: Path) -> Path:
    """Draw errors against times: a curve for each degree, and the runs for an accuracy.

    A bar goes up from the error of such a run to the error that it states. Hollow markers are no
    better known than the finer answer; a line joins the runs than which none is both faster and
    more accurate.
    """
    least = max(study.doubt, _LEAST)

    def points(runs: Sequence[Priced]) -> tuple[Values, Values]:
        errors = np.array([max(run.error, least) for run in runs])
        return np.array([run.seconds for run in runs]), errors

    with house_style():
        figure = Figure(figsize=(WIDTH, 0.7 * WIDTH))
        axes = figure.subplots()
        by_doubling = [run for run in study.runs if run.accuracy is None]
        for number, degree in enumerate(sorted({run.degree for run in by_doubling})):
            own = [run for run in by_doubling if run.degree == degree]
            style = {"color": APART[number], "marker": _MARKERS[number], "markersize": 4.5}
            axes.loglog(*points(own), label=f"degree {degree}, by doubling", **style)
            vague = [run for run in own if run.error <= study.doubt]
            axes.loglog(*points(vague), linestyle="none", mfc="white", **style)
        asked = [run for run in study.runs if run.accuracy is not None]
        times, errors = points(asked)
        stated = np.array([max(run.stated or e, e) for run, e in zip(asked, errors, strict=True)])
        axes.errorbar(
            times, errors, np.array([0 * errors, stated - errors]), color=INK, capsize=3,
            marker="*", markersize=10, linestyle="none", label="accuracy asked for; bar: as stated",
        )  # fmt: skip
        vague = [run for run in asked if run.error <= study.doubt]
        axes.loglog(*points(vague), "*", color=INK, mfc="white", markersize=10, zorder=3)
        for number, (run, time, error) in enumerate(zip(asked, times, errors, strict=True)):
            beside = (5, -10 if number % 2 else 3)  # two may have the same elements and steps
            axes.annotate(
                f"{100 * (run.accuracy or 0.0):g} %", (time, error), beside,
                textcoords="offset points", fontsize=7,
            )  # fmt: skip
        axes.loglog(
            *points(study.efficient), color=QUIET, linewidth=4, alpha=0.4, zorder=0,
            label="none is faster and more accurate",
        )  # fmt: skip
        axes.set_xlabel("wall time of mesh and steps (s)")
        axes.set_ylabel("error of the worst figure")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{100 * y:g} %"))
        axes.yaxis.set_minor_formatter(NullFormatter())
        _ticks(axes, [run.seconds for run in study.runs])
        figure.legend(loc="outside upper center", ncols=2, fontsize=7.5)
        return save(figure, path)


def _ticks(axes: Axes, costs: Sequence[float]) -> None:
    """Give a logarithmic axis that may span less than a decade a few plain numbers."""
    low, high = min(costs), max(costs)
    middle = (low * high) ** 0.5
    wide = max(high / low * 1.3, _SPAN) ** 0.5
    axes.set_xlim(middle / wide, middle * wide)
    digits = (1.0,) if wide > 6 else (1.0, 2.0, 5.0) if wide > 3 else (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
    decades = range(floor(log10(middle / wide)), ceil(log10(middle * wide)) + 1)
    marks = [digit * 10.0**n for n in decades for digit in digits]
    inside = [mark for mark in marks if middle / wide <= mark <= middle * wide]
    axes.xaxis.set_major_locator(FixedLocator(inside))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def draw_sensitivities(
    columns: Mapping[str, Sequence[float]], values: Mapping[str, float], path: Path
) -> Path:
    """Draw what one per cent more of each parameter changes in force and dissipated energy.

    Args:
        columns: Of ``study.effects.sensitivities``.
        values: Of the parameters by their names, in SI units; 1 for a common factor.
        path: The picture.
    """
    time = np.asarray(columns["time_s"])
    with house_style():
        figure = Figure(figsize=(WIDTH, 0.7 * WIDTH))
        pairs = zip(figure.subplots(2, 1, sharex=True), ("force", "dissipated"), strict=True)
        for axes, what in pairs:
            base = "force_N" if what == "force" else "dissipated_J"
            unit = readable(base[-1], 0.01 * float(np.abs(columns[base]).max()))
            for i, (name, value) in enumerate(values.items()):
                change = 0.01 * value * np.asarray(columns[f"d_{what}/d_{name}"])
                style = DASHES[i // len(APART) % len(DASHES)]
                colour = APART[i % len(APART)]
                axes.plot(
                    time, unit.factor * change, color=colour, linestyle=style, label=shown(name)
                )
            noun = "force" if what == "force" else "dissipated energy"
            axes.set_ylabel(f"change of {noun} ({unit.name})")
            zero_line(axes)
        axes.set_xlabel("time (s)")
        figure.suptitle("One per cent more of each parameter", fontsize=10)
        handles, names = axes.get_legend_handles_labels()
        figure.legend(handles, names, loc="outside right upper", fontsize=7)
        return save(figure, path)


def draw_bands(
    columns: Mapping[str, Sequence[float]], path: Path, measured: Measured | None = None
) -> Path:
    """Draw predicted force and dissipated energy with their bands of 95 % over the displacement.

    Args:
        columns: Of ``study.fit.prediction.with_band``.
        path: The picture.
        measured: A curve whose forces are drawn, too.
    """
    u = np.asarray(columns["displacement_m"])
    turns = curve_of_history(u, np.asarray(columns["force_N"])).turns
    with house_style():
        figure = Figure(figsize=(WIDTH, 0.7 * WIDTH))
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        for axes, (name, (_, *ends)) in zip((upper, lower), QUANTITIES.items(), strict=True):
            unit = readable(name[-1], float(np.abs(columns[name]).max()))
            value, low, high = (unit.factor * np.asarray(columns[k]) for k in (name, *ends))
            for first, last in pairwise(turns):
                branch = slice(first, last + 1)
                axes.fill_between(
                    MILLIMETRE.factor * u[branch], low[branch], high[branch],
                    where=np.isfinite(low[branch]), color=APART[0], alpha=0.25, linewidth=0,
                    label="band of 95 %" if first == 0 else None,
                )  # fmt: skip
            axes.plot(MILLIMETRE.factor * u, value, color=APART[0], label="prediction")
            noun = "force" if name == "force_N" else "dissipated energy"
            axes.set_ylabel(f"{noun} ({unit.name})")
            if measured is not None and axes is upper:
                points = MILLIMETRE.factor * measured.displacement, unit.factor * measured.force
                plain = measured.file.name.replace("$", r"\$")  # no formula
                axes.plot(*points, "o", color=QUIET, markersize=3, mfc="none", label=plain)
        upper.legend(fontsize=7)
        lower.set_xlabel(DISPLACEMENT)
        return save(figure, path)


def shown(name: str) -> str:
    """Return the name of a parameter, also where the derivative is by the factor of its values."""
    return name.removeprefix("ln(").removesuffix(")") if name.startswith("ln(") else name
