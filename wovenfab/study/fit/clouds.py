"""Measured fields of displacements beside the computed ones, and their derivatives.

A displacement at a point is linear in the unknowns of the sheet: its derivative by a parameter is
the same evaluation of the derivative of the state, which the tangent-linear equations give. Of two
families the mean is compared.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from wovenfab.study.fit.fit_file import FieldTest, FitParameter
from wovenfab.study.fit.response import BranchError, Comparison, ResponseCurve

Array = NDArray[np.float64]
#: Share of the points of a cloud that must lie on the sheet.
LEAST = 0.5


def field_compared(
    test: FieldTest, curve: ResponseCurve, unknowns: Sequence[FitParameter]
) -> Comparison:
    """Return measured displacements beside those of a run, m: x and y of each point in turn.

    Points beside the sheet do not count: no step could resolve them. Parameters of the machine do
    not change the field.

    Raises:
        BranchError: Most points lie beside the sheet.
    """
    values = curve.fields[test.key]
    beside = np.isnan(values[:, :, 0])
    if np.count_nonzero(~beside[:, 0]) < LEAST * len(beside):
        count = np.count_nonzero(~beside[:, 0])
        raise BranchError(
            f"{test.name}: {count} of {len(beside)} points lie on the sheet of {test.case.name}: x "
            "and y must be positions at rest in the sheet's coordinates"
        )
    measured = test.displacements.ravel()
    off = beside.ravel()
    computed = np.where(off, measured, values[:, :, 0].ravel())
    material = np.where(off[:, None], 0.0, values[:, :, 1:].reshape(len(off), -1))
    columns: list[Array] = []
    number = 0
    for unknown in unknowns:
        if unknown.target is None:
            columns.append(np.zeros(len(off)))
            continue
        columns.append(material[:, number])
        number += 1
    # Both components together are then apart by a share of the largest displacement.
    size = np.full(len(off), np.linalg.norm(test.displacements, axis=1).max() / np.sqrt(2))
    rows = np.arange(len(off))
    unresolved = np.where(off, np.inf, 0.0)
    slopes = np.stack(columns, axis=1)
    return Comparison(rows, measured, computed, slopes, unresolved, size, of_field=True)


def describe_field(test: FieldTest, comparison: Comparison) -> str:
    """Return in a sentence how near the computed field is, and what its points count for."""
    on = comparison.resolved
    distance = float(np.sqrt(2 * np.mean((comparison.computed - comparison.measured)[on] ** 2)))
    count, beside = np.count_nonzero(on) // 2, np.count_nonzero(~on) // 2
    left_out = f", {beside} lie beside the sheet" if beside else ""
    return (
        f"{test.name}: displacements at {1e3 * test.at:.4g} mm are followed within "
        f"{1e3 * distance:.3g} mm ({100 * comparison.misfit:.2g} % of the largest; "
        f"stated error {1e3 * np.sqrt(2) * test.error:.3g} mm). Its {count} points count as "
        f"{test.share * count:.0f}{left_out}."
    )
