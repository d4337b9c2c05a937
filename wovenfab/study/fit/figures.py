"""Figures of a standard test, computed, beside the measured ones, and their derivatives.

A figure is a function of the curve. Its derivative by a parameter is the central difference along
the derivative of the curve: no further run is needed. That of the work is the integral of that of
the force, by the trapezoidal rule.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from wovenfab.record.figures import columns_of, laboratory
from wovenfab.study.fit.fit_file import FigureTest, FitParameter
from wovenfab.study.fit.response import BranchError, Comparison, ResponseCurve

Array = NDArray[np.float64]
#: Change of the force over the largest one for which figures are differentiated.
CHANGE = 1e-5


def figures_compared(
    test: FigureTest, curve: ResponseCurve, unknowns: Sequence[FitParameter]
) -> Comparison:
    """Return measured figures beside those of a computed curve, in SI units.

    Parameters of the machine do not change them: they are of the sample.

    Raises:
        BranchError: The curve does not tell a figure.
    """
    measured = np.array([figure.value for figure in test.figures])
    computed = _values(test, curve.force, curve.work, curve)
    if untold := [f.name for f, v in zip(test.figures, computed, strict=True) if np.isnan(v)]:
        raise BranchError(
            f"the run of {test.case.name} does not tell {', '.join(untold)}: the steps must pass "
            "through what the figure is defined by. Take more steps, the first ones short"
        )
    columns, material = [], 0
    for unknown in unknowns:
        if unknown.target is None:
            columns.append(np.zeros_like(measured))
            continue
        columns.append(_slope(test, curve, curve.slopes[:, material]))
        material += 1
    slopes = np.stack(columns, axis=1)
    rows = np.arange(len(measured))
    return Comparison(rows, measured, computed, slopes, 0.0 * measured, np.abs(measured))


def _slope(test: FigureTest, curve: ResponseCurve, direction: Array) -> Array:
    """Return the derivatives of figures where the force changes along a direction, shape (n,)."""
    size, change = np.abs(curve.force).max(), np.abs(direction).max()
    if not change:
        return np.zeros(len(test.figures))
    h = CHANGE * size / change
    work = cumulative_trapezoid(direction, curve.displacement, initial=0.0)
    ends = (
        _values(test, curve.force + s * direction, curve.work + s * work, curve) for s in (h, -h)
    )
    return np.asarray(np.subtract(*ends) / (2 * h))


def _values(test: FigureTest, force: Array, work: Array, curve: ResponseCurve) -> Array:
    """Return the figures that were measured, of a curve; NaN where it does not tell one."""
    found = test.standard.figures(columns_of(curve.displacement, force, work))
    values = [found[figure.name].value for figure in test.figures]
    return np.array([np.nan if value is None else value for value in values])


def describe_figures(test: FigureTest, comparison: Comparison) -> list[str]:
    """Return a line for each figure: measured and fitted, in the unit of laboratories."""
    lines = []
    for f, computed in zip(test.figures, comparison.computed, strict=True):
        (measured, unit), (fitted, _), (error, _) = (
            laboratory(value, f.unit) for value in (f.value, float(computed), f.error)
        )
        off = 100 * (computed / f.value - 1)
        lines.append(
            f"{test.name}: {f.name} is {fitted:.4g}, measured {measured:.4g} +- {error:.2g} {unit} "
            f"({off:+.2f} %)."
        )
    return lines
