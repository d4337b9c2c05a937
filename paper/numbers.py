"""The numbers beside each figure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from paper.campaign import Results
from paper.claim import digits
from paper.figures import Panel, PaperFigure

#: Rows of a table, the first one its headings.
Table = list[list[str]]


def numbers(figure: PaperFigure, results: Results) -> Table:
    """Return the figures of a figure as a table."""
    if figure.kind == "program":
        return _program(results, figure.panels[0])
    if figure.kind == "loops":
        return _loops(results, figure.panels)
    return _sheets(results, figure.panels)


def _program(results: Results, panel: Panel) -> Table:
    history, cycles = results.history(panel.run), results.summary(panel.run)["cycles"]
    time, u = history["time_s"], history["displacement_m"]
    rows = [["cycle", "amplitude (mm)", "duration (s)", "largest velocity (m/s)"]]
    for number, cycle in enumerate(cycles, 1):
        inside = (time >= cycle["start_s"]) & (time <= cycle["end_s"])
        amplitude, duration = float(u[inside].max()), cycle["end_s"] - cycle["start_s"]
        # of the program A/2 (1 - cos(2 pi t/T)) itself, which differences would fall short of
        fastest = np.pi * amplitude / duration
        rows.append([str(number), *(digits(v) for v in (1e3 * amplitude, duration, fastest))])
    return rows


def _loops(results: Results, panels: Sequence[Panel]) -> Table:
    heads = ["", "unknowns", "peak force (N)", "lost in the largest cycle (J)"]
    rows = [[*heads, "energy imbalance (J)", "nonlinearity"]]
    for panel in panels:
        summary, loop = results.summary(panel.run), results.loops(panel.run)[-1]
        worst = summary["worst_imbalance_J"]
        told = (digits(v) for v in (loop.peak, loop.dissipated, worst, loop.nonlinearity))
        rows.append([panel.label, str(summary["unknowns"]), *told])
    return rows


def _sheets(results: Results, panels: Sequence[Panel]) -> Table:
    rows = [["", "mean", "99.5 % of the sheet stay below", "largest"]]
    for panel in panels:
        field = results.field(panel.run, panel.field)
        factor, unit = _UNITS[panel.field]
        values = (field.mean(), field.size(), float(field.values.max()))
        rows.append([panel.label, *(f"{digits(factor * value)} {unit}" for value in values)])
    return rows


_UNITS = {
    "beta": (1e3, "mm"),
    "curvature_1": (1.0, "1/m"),
    "curvature_2": (1.0, "1/m"),
    "shear_angle": (float(np.degrees(1.0)), "°"),
}
