"""The axis of intervals can be read, however wide they are."""

from __future__ import annotations

from itertools import pairwise

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from wovenfab.report.fit import draw_intervals
from wovenfab.report.style import WIDTH, house_style
from wovenfab.study.fit.identifiability import ConfidenceInterval


@pytest.mark.parametrize(
    ("low", "high"), [(0.995, 1.002), (0.94, 1.07), (0.7, 1.4), (0.2, 6.0), (0.011, 90.0)]
)
def test_labels_of_intervals_are_several_and_apart(low: float, high: float) -> None:
    names = ("shear.stiffness", "spin_friction.strength")
    intervals = [ConfidenceInterval(n, "N/m", 3.0, 3 * low, 3 * high, 0.1, True) for n in names]
    with house_style():
        figure = Figure(figsize=(WIDTH, 3.0))  # the right one of two columns, as in fit.png
        axes = figure.subplots(1, 2, width_ratios=(3, 2))[1]
        draw_intervals(axes, intervals)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        start, end = axes.get_xlim()
        labels = [
            label.get_window_extent(canvas.get_renderer())
            for label in axes.get_xticklabels()
            if start <= label.get_position()[0] <= end and label.get_text()
        ]
    assert len(labels) >= 2
    assert all(a.x1 + 1 < b.x0 for a, b in pairwise(sorted(labels, key=lambda box: box.x0)))
