"""Page of several fits beside each other, and the pictures of tests that were left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from wovenfab.record.results import this_process
from wovenfab.report.page_blocks import (
    Block,
    PageSection,
    PageTable,
    picture,
    section,
    write_page,
)
from wovenfab.report.style import QUIET, WIDTH, readable, zero_line
from wovenfab.study.fit.fit_file import Fit, MeasuredTest
from wovenfab.study.fit.leave_out import FittedModel, Prediction, misfit, of_same_tests

PAGE = "models.html"


def write_models_page(models: Mapping[str, FittedModel], notes: Sequence[str], path: Path) -> Path:
    """Write the page that compares several fits, by their names; return its path."""
    sections = [section("Fits", lambda: [_fits(models)])]
    predictions = {name: m.predictions for name, m in models.items() if m.predictions}
    if predictions and of_same_tests(predictions):
        fit = next(iter(models.values())).fit
        sections.append(left_out(fit, predictions))
    # The tables of the notes are those of the page.
    said = [note for note in notes if note.endswith(".")]
    return write_page(path, "Models compared", said, [], sections, this_process())


def left_out(fit: Fit, models: Mapping[str, Sequence[Prediction]]) -> PageSection:
    """Return the section of left-out tests: misfits and curves, as each model predicts them.

    Args:
        fit: A fit with these tests.
        models: Predictions of each experiment, by the names of models.
    """

    def table() -> list[Block]:
        rows = [
            [
                name,
                *(f"{100 * share:.2f}" for one in predictions for share in one.misfits),
                f"{100 * misfit(predictions):.2f}",
            ]
            for name, predictions in models.items()
        ]
        names = [name for one in next(iter(models.values())) for name in one.names]
        return [PageTable("Misfit where a test was left out (%)", ["", *names, "all"], rows)]

    def values() -> list[Block]:
        return [_values(name, predictions) for name, predictions in models.items()]

    def curves() -> list[Block]:
        tests = [n for n, test in enumerate(fit.tests) if isinstance(test, MeasuredTest)]
        if not tests:
            return []
        figure = draw_left_out(fit, models, tests)
        return [
            picture(figure, "Measured forces (points) that no model was given, and predictions")
        ]

    return section("Tests left out", table, curves, values)


def draw_left_out(
    fit: Fit, models: Mapping[str, Sequence[Prediction]], tests: Sequence[int]
) -> Figure:
    """Return the figure of measured curves and what each model predicts of them.

    Args:
        fit: The fit.
        models: Predictions by the names of models.
        tests: Numbers of the tests that are drawn, which have curves.
    """
    figure = Figure(figsize=(WIDTH, 0.6 * WIDTH))
    grid = figure.subplots(2, len(tests), sharex="col", squeeze=False, height_ratios=(3, 1))
    for (upper, lower), number in zip(grid.T, tests, strict=True):
        test = fit.tests[number]
        assert isinstance(test, MeasuredTest)
        unit = readable("N", float(np.abs(test.measured.force).max()))
        x = 1e3 * test.measured.displacement
        points = unit.factor * test.measured.force
        upper.plot(x, points, "o", color=QUIET, markersize=3, markerfacecolor="none")
        for i, (name, predictions) in enumerate(models.items()):
            one = next(p for p in predictions if number in p.tests)
            c = one.evaluation.comparisons[one.tests.index(number)]
            label = f"{name}: {100 * c.misfit:.2f} %"
            upper.plot(x[c.rows], unit.factor * c.computed, color=f"C{i}", label=label)
            lower.plot(x[c.rows], 100 * c.shares, color=f"C{i}", linewidth=0.8)
        zero_line(lower)
        upper.set_title(test.name, fontsize=8)
        upper.set_ylabel(f"force ({unit.name})")
        upper.legend(fontsize=6)
        lower.set_xlabel("displacement (mm)")
        lower.set_ylabel("distance (%)")
    return figure


def _fits(models: Mapping[str, FittedModel]) -> PageTable:
    """Return the table of fits to all tests; misfits are of each test where all have the same."""
    names = {tuple(test.name for test in m.fit.tests) for m in models.values()}
    rows = []
    for name, m in models.items():
        known, misfits = m.known, [one.misfit for one in m.known.misfits]
        if len(names) > 1:
            misfits = [float(np.sqrt(np.mean(np.square(misfits))))]
        sure = sum(i.determined for i in known.intervals)
        shares = (f"{100 * share:.2f}" for share in misfits)
        rows.append([name, f"{len(known.intervals)}", f"{sure}", *shares, f"{known.bic:.1f}"])
    tests = next(iter(names)) if len(names) == 1 else ["misfit"]
    head = ["", "parameters", "determined", *tests, "BIC"]
    return PageTable("Fits to all tests, with their misfits (%)", head, rows)


def _values(name: str, predictions: Sequence[Prediction]) -> PageTable:
    """Return the table of what a model's parameters are without each experiment."""
    intervals = predictions[0].known.intervals
    rows = [
        [
            ", ".join(one.names),
            *(f"{i.value:.4g}{'' if i.determined else '*'}" for i in one.known.intervals),
        ]
        for one in predictions
    ]
    unsure = any(not i.determined for one in predictions for i in one.known.intervals)
    head = ["without", *(f"{i.name} ({i.unit})" for i in intervals)]
    return PageTable(f"Parameters of {name}{' (* not determined)' if unsure else ''}", head, rows)
