"""Picture and page of a fit: measured and computed curves, and what is known of the parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from wovenfab.measured.curve import Measured
from wovenfab.record.figures import laboratory
from wovenfab.record.results import this_process
from wovenfab.report.models import left_out
from wovenfab.report.page_blocks import Block, PageSection, PageTable, picture, section, write_page
from wovenfab.report.run_data import RunData
from wovenfab.report.style import (
    INK,
    QUIET,
    WIDTH,
    both_ways,
    fill,
    house_style,
    quantity,
    readable,
    save,
    zero_line,
)
from wovenfab.study.fit.fit_file import FieldTest, FigureTest, Fit, MeasuredTest
from wovenfab.study.fit.identifiability import ConfidenceInterval, Identifiability
from wovenfab.study.fit.leave_out import Prediction
from wovenfab.study.fit.objective import Evaluation
from wovenfab.study.fit.response import BranchError, Comparison, compared, curve_of_history
from wovenfab.study.fit.search import Found, Profile

#: Range of an axis over its least value up to which more than powers of ten have labels.
FEW_POWERS = 1e3
PAGE, PICTURE, LAB = "fit.html", "fit.png", "lab.png"


def draw_fit(fit: Fit, found: Found, known: Identifiability, path: Path) -> Path:
    """Draw curves, distances, intervals and trials into one picture; return its path."""
    with house_style():
        figure = Figure(figsize=(WIDTH, 0.8 * WIDTH))
        (upper, right), (lower, last) = figure.subplots(
            2, 2, height_ratios=(2, 1), width_ratios=(3, 2)
        )
        if _curves(fit, found.evaluation):
            draw_curves(upper, fit, found.evaluation)
            draw_distances(lower, fit, found.evaluation)
        else:
            if _figures(fit, found.evaluation):
                draw_figures(upper, fit, found.evaluation)
            else:
                draw_field(upper, *_fields(fit, found.evaluation)[0])
            lower.set_visible(False)
        draw_intervals(right, known.intervals)
        draw_trials(last, found)
        return save(figure, path)


def write_fit_page(
    fit: Fit,
    found: Found,
    known: Identifiability,
    profiles: Sequence[Profile],
    notes: Sequence[str],
    path: Path,
    predictions: Sequence[Prediction] = (),
) -> Path:
    """Write the page of a fit; return its path."""
    figures = [(i.name, _shown(i.value, i.unit)) for i in known.intervals]
    sections = _sections(fit, found, known)
    if profiles:
        sections.insert(-2, section("Profiles", lambda: [_profiles(fit, profiles)]))
    if predictions:
        sections.insert(-1, left_out(fit, {fit.name: predictions}))
    return write_page(path, fit.title or fit.name, notes, figures, sections, this_process())


def measured_figure(
    runs: Sequence[tuple[str, RunData]], measured: Measured
) -> tuple[Figure, list[tuple[str, str]]]:
    """Return the figure of runs over a measured curve, and in words how far each is from it.

    A run that does not turn as often as the measured curve has no distance.

    Args:
        runs: Runs with their names.
        measured: The measured curve.
    """
    found: list[tuple[str, RunData, Comparison | None, str]] = []
    for name, run in runs:
        curve = curve_of_history(run.history["displacement_m"], run.history["force_N"])
        try:
            one = compared(measured, curve)
            words = f"{100 * one.misfit:.2f} % of the largest force from {measured.file.name}"
            words += f"; {one.left_out}" if one.left_out else ""
            found.append((name, run, one, words))
        except BranchError as error:
            found.append((name, run, None, f"no distance: {error}"))
    rows = 2 if any(one for _, _, one, _ in found) else 1
    figure = Figure(figsize=(WIDTH, (0.37 + 0.19 * rows) * WIDTH))
    grid = figure.subplots(rows, 1, sharex=True, squeeze=False, height_ratios=(3, 1)[:rows])
    upper, lower = grid[0, 0], grid[-1, 0]
    unit = readable("N", float(np.abs(measured.force).max()))
    shown = (1e3 * measured.displacement, unit.factor * measured.force)
    plain = measured.file.name.replace("$", r"\$")  # no formula
    upper.plot(*shown, "o", color=QUIET, markersize=3, zorder=3, label=plain)
    for i, (name, run, comparison, _) in enumerate(found):
        colour = f"C{i}"
        label = f"{name}: {100 * comparison.misfit:.2f} %" if comparison else name
        u, f = 1e3 * run.history["displacement_m"], unit.factor * run.history["force_N"]
        upper.plot(u, f, color=colour, label=label)
        if comparison is not None:
            at = 1e3 * measured.displacement[comparison.rows]
            lower.plot(at, 100 * comparison.shares, ".-", color=colour, markersize=3)
            lower.set_ylabel("distance (%)")
    zero_line(lower)
    upper.set_ylabel(f"force ({unit.name})")
    upper.legend(fontsize=7)
    lower.set_xlabel("displacement (mm)")
    return figure, [(name, words) for name, _, _, words in found]


def _sections(fit: Fit, found: Found, known: Identifiability) -> list[PageSection]:
    def drawn(wide: float, high: float, draw: Callable[..., None], *what: Any) -> Figure:
        figure = Figure(figsize=(wide, high))
        draw(figure.subplots(), *what)
        return figure

    def curves() -> list[Block]:
        figure = Figure(figsize=(WIDTH, 0.75 * WIDTH))
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        draw_curves(upper, fit, found.evaluation)
        draw_distances(lower, fit, found.evaluation)
        upper.set_xlabel("")
        return [picture(figure, "Measured (points) and computed force (lines)")]

    def figures() -> list[Block]:
        return [figure_table(test, c) for test, c in _figures(fit, found.evaluation)]

    def parameters() -> list[Block]:
        high = 0.6 + 0.35 * len(known.intervals)
        figure = drawn(0.7 * WIDTH, high, draw_intervals, known.intervals)
        return [interval_table(known), picture(figure, "Intervals of 95 %")]

    def correlations() -> list[Block]:
        figure = drawn(0.6 * WIDTH, 0.5 * WIDTH, draw_correlations, known)
        return [picture(figure, "Correlations"), singular_table(fit, known)]

    def trials() -> list[Block]:
        figure = drawn(0.7 * WIDTH, 0.35 * WIDTH, draw_trials, found)
        return [picture(figure, "Misfit of each trial"), trial_table(fit, found)]

    def fields() -> list[Block]:
        pairs = _fields(fit, found.evaluation)
        figure = Figure(figsize=(WIDTH, 0.5 * WIDTH))
        for axes, pair in zip(figure.subplots(1, len(pairs), squeeze=False)[0], pairs, strict=True):
            draw_field(axes, *pair)
        return [picture(figure, "Measured points at rest, coloured by the distance")]

    measured = [section("Curves", curves)] if _curves(fit, found.evaluation) else []
    measured += [section("Figures", figures)] if _figures(fit, found.evaluation) else []
    measured += [section("Fields", fields)] if _fields(fit, found.evaluation) else []
    return [
        *measured,
        section("Parameters", parameters),
        section("What is known together", correlations),
        section("Search", trials),
    ]


def _profiles(fit: Fit, profiles: Sequence[Profile]) -> Block:
    """Return the figure: rise of the sum of squares over each parameter, all others found anew."""
    units = {u.name: u for u in fit.unknowns}
    figure = Figure(figsize=(WIDTH, 0.4 * WIDTH))
    for axes, one in zip(
        figure.subplots(1, len(profiles), squeeze=False)[0], profiles, strict=True
    ):
        axes.plot(one.values, one.rise, "o-", color=INK, markersize=4)
        axes.axhline(1.0, color=QUIET, linewidth=0.8)
        if units[one.name].by_factors:
            axes.set_xscale("log")
            plain_ticks(axes.xaxis)
        axes.set_xlabel(f"{one.name} ({units[one.name].unit})")
        axes.set_ylabel("rise (1 at 95 %)")
    return picture(figure, "Sum of squares for fixed values, all others found anew")


def draw_curves(axes: Axes, fit: Fit, evaluation: Evaluation) -> None:
    """Draw measured forces as points and computed ones as lines, against the displacement."""
    pairs = _curves(fit, evaluation)
    unit = readable("N", max(float(np.abs(test.measured.force).max()) for test, _ in pairs))
    for i, (test, c) in enumerate(pairs):
        measured, colour = test.measured, f"C{i}"
        for one in test.specimens:
            points = (1e3 * one.displacement, unit.factor * one.force)
            axes.plot(*points, "o", color=QUIET, markersize=3, markerfacecolor="none")
        x = 1e3 * measured.displacement
        axes.plot(x[c.rows], unit.factor * c.computed, color=colour, label=measured.file.stem)
    axes.set_xlabel("displacement (mm)")
    axes.set_ylabel(f"force ({unit.name})")
    axes.legend(fontsize=7)


def draw_distances(axes: Axes, fit: Fit, evaluation: Evaluation) -> None:
    """Draw computed less measured forces over the largest measured one."""
    for i, (test, c) in enumerate(_curves(fit, evaluation)):
        share = 100 * c.shares
        x = 1e3 * test.measured.displacement[c.rows]
        axes.plot(x, share, ".-", color=f"C{i}", linewidth=0.8, markersize=3)
    zero_line(axes)
    axes.set_xlabel("displacement (mm)")
    axes.set_ylabel("distance (%)")


def draw_figures(axes: Axes, fit: Fit, evaluation: Evaluation) -> None:
    """Draw each fitted figure over the measured one, and the errors of these as bars."""
    names: list[str] = []
    for test, c in _figures(fit, evaluation):
        rows = len(names) + c.rows
        axes.errorbar(np.ones(c.rows.size), rows, xerr=test.errors / c.size, fmt="o", color=QUIET,
                      markersize=5, markerfacecolor="none", label="measured")  # fmt: skip
        axes.plot(1 + c.shares, rows, "x", color=INK, label="fitted")
        names += [f"{test.name}: {figure.name}" for figure in test.figures]
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.margins(y=0.2)
    axes.set_xlabel("figure over the measured one, with its error")


def draw_field(axes: Axes, test: FieldTest, comparison: Comparison) -> None:
    """Draw the points of a measured field at rest, coloured by the distance of displacements."""
    on = comparison.resolved.reshape(-1, 2)[:, 0]
    apart = (comparison.computed - comparison.measured).reshape(-1, 2)[on]
    sizes = np.linalg.norm(apart, axis=1)
    unit = readable("m", float(sizes.max(initial=0.0)))
    x, y = 1e3 * test.points[on].T
    dots = axes.scatter(x, y, s=9, c=unit.factor * sizes, cmap=fill(), linewidths=0)
    axes.figure.colorbar(dots, ax=axes, shrink=0.8, label=f"distance ({unit.name})")
    axes.set_title(f"{test.name}, {1e3 * test.at:.4g} mm", fontsize=8)
    axes.set_aspect("equal")
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")


def figure_table(test: FigureTest, comparison: Comparison) -> PageTable:
    """Return the table of the figures of a test: measured, fitted and error."""
    rows = []
    for f, computed in zip(test.figures, comparison.computed, strict=True):
        values = (f.value, computed, f.error)
        shown = [f"{laboratory(value, f.unit)[0]:.4g}" for value in values]
        rows.append(
            [f.name, *shown, laboratory(0.0, f.unit)[1], f"{100 * (computed / f.value - 1):+.2f}"]
        )
    head = ["", "measured", "fitted", "error", "unit", "distance (%)"]
    return PageTable(f"Figures of {test.name} ({test.case.name})", head, rows)


def _curves(fit: Fit, evaluation: Evaluation) -> list[tuple[MeasuredTest, Comparison]]:
    """Return the measured curves of a fit, each with its comparison."""
    pairs = zip(fit.tests, evaluation.comparisons, strict=True)
    return [(test, c) for test, c in pairs if isinstance(test, MeasuredTest)]


def _figures(fit: Fit, evaluation: Evaluation) -> list[tuple[FigureTest, Comparison]]:
    """Return the tests of a fit with measured figures, each with its comparison."""
    pairs = zip(fit.tests, evaluation.comparisons, strict=True)
    return [(test, c) for test, c in pairs if isinstance(test, FigureTest)]


def _fields(fit: Fit, evaluation: Evaluation) -> list[tuple[FieldTest, Comparison]]:
    """Return the measured fields of a fit, each with its comparison."""
    pairs = zip(fit.tests, evaluation.comparisons, strict=True)
    return [(test, c) for test, c in pairs if isinstance(test, FieldTest)]


def draw_intervals(axes: Axes, intervals: Sequence[ConfidenceInterval]) -> None:
    """Draw each interval over its value, those that the curves do not determine in grey."""
    for row, i in enumerate(intervals):
        size = abs(i.value) or 1.0
        low, high = (float(np.clip(end / size, 1e-2, 1e2)) for end in (i.low, i.high))
        colour = INK if i.determined else QUIET
        axes.plot([low, high], [row, row], color=colour, linewidth=2)
        axes.plot([i.value / size], [row], "o", color=colour, markersize=5)
    if all(i.low > 0 for i in intervals):
        axes.set_xscale("log")
        plain_ticks(axes.xaxis)
    axes.set_yticks(range(len(intervals)), [i.name for i in intervals])
    axes.invert_yaxis()
    axes.margins(y=0.2)
    axes.set_xlabel("interval of 95 % over the value")


def plain_ticks(axis: Axis) -> None:
    """Label a logarithmic axis with plain numbers, as many as can be read.

    These are powers of ten, with twice and five times these if few, and a few numbers in equal
    steps on an axis of less than a power of ten.
    """
    low, high = sorted(axis.get_view_interval())
    few = high < FEW_POWERS * low
    powers = LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,))
    axis.set_major_locator(MaxNLocator(3, steps=(1, 2, 5, 10)) if high < 10 * low else powers)
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def draw_correlations(axes: Axes, known: Identifiability) -> None:
    """Draw the correlations as a chart of colours with their numbers."""
    names = [i.name for i in known.intervals]
    image = axes.imshow(known.correlations, cmap=both_ways(), vmin=-1, vmax=1)
    axes.set_xticks(range(len(names)), names, rotation=30, ha="right")
    axes.set_yticks(range(len(names)), names)
    axes.grid(visible=False)
    for (row, column), value in np.ndenumerate(known.correlations.astype(object)):
        shade = "white" if abs(value) > 0.6 else INK  # on a dark ground, on a pale one
        axes.text(column, row, f"{value:+.2f}", ha="center", va="center", fontsize=7, color=shade)
    axes.figure.colorbar(image, ax=axes, shrink=0.8)


def draw_trials(axes: Axes, found: Found) -> None:
    """Draw the misfit of each trial, coarse ones in grey."""
    for coarse, colour in ((True, QUIET), (False, INK)):
        chosen = [t for t in found.trials if t.coarse == coarse and not t.failure]
        axes.plot(
            [t.number for t in chosen], [100 * t.misfit for t in chosen], "o-", color=colour,
            markersize=4, label="coarse" if coarse else "fine",
        )  # fmt: skip
    axes.set_yscale("log")
    plain_ticks(axes.yaxis)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("trial")
    axes.set_ylabel("misfit (%)")
    axes.legend(fontsize=7)


def interval_table(known: Identifiability) -> PageTable:
    """Return the table of parameters with their intervals."""
    rows = [
        [i.name, _shown(i.value, i.unit),
         *([_shown(i.low, i.unit), _shown(i.high, i.unit)] if i.determined else ["", ""]),
         "yes" if i.determined else "no"]
        for i in known.intervals
    ]  # fmt: skip
    return PageTable(
        "Parameters with intervals of 95 %", ["", "value", "from", "to", "known"], rows
    )


def singular_table(fit: Fit, known: Identifiability) -> PageTable:
    """Return the table of singular values with the combination of parameters of each."""
    rows = [
        [f"{s:.3g}", *(f"{part:+.2f}" for part in np.ravel(direction))]
        for s, direction in zip(known.singular_values, known.directions, strict=True)
    ]
    head = ["singular value", *(u.name for u in fit.unknowns)]
    return PageTable("Combinations of parameters, the best known first", head, rows)


def trial_table(fit: Fit, found: Found) -> PageTable:
    """Return the table of trials."""
    rows = [
        [f"{t.number}", f"{t.scale:g}",
         *(f"{t.values[u.name]:.4g}" for u in fit.unknowns),
         t.failure or f"{100 * t.misfit:.3g}", f"{t.seconds:.1f}"]
        for t in found.trials
    ]  # fmt: skip
    head = [
        "",
        "cells, steps",
        *(f"{u.name} ({u.unit})" for u in fit.unknowns),
        "misfit (%)",
        "time (s)",
    ]
    return PageTable("Trials", head, rows)


def _shown(value: float, unit: str) -> str:
    if not np.isfinite(value):
        return "unlimited"
    try:
        return quantity(value, unit)
    except (KeyError, ValueError):
        return f"{value:.4g} {unit}"
