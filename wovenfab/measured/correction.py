"""Corrections of a measured curve: drift, zero, where the test begins, and one cycle of several."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wovenfab.case.errors import case_error
from wovenfab.measured.curve import FEWEST, Measured

Array = NDArray[np.float64]
#: Share of the way to one side that the way to the other side of the start has at least where a
#: test goes to both sides.
BOTH_SIDES = 0.25


@dataclass(frozen=True)
class Correction:
    """What is corrected, in this order.

    Attributes:
        drift: Number of rows at each end of the record at which the sample is at rest without
            force: between them the zero of the force drifts evenly in time. 0 for no correction.
        zero: Number of rows at the start, at rest, whose mean force and displacement are zero.
        preload: Force (N) from whose first reaching the displacement counts; rows before it are
            left out. 0 for no correction.
        cycle: Number of the cycle that counts, from 1; 0 for the whole record.
    """

    drift: int = 0
    zero: int = 0
    preload: float = 0.0
    cycle: int = 0


def corrected(measured: Measured, correction: Correction) -> Measured:
    """Return a curve with its corrections.

    Raises:
        CaseError: The curve has too few rows or cycles, or does not reach the preload.
    """
    if correction.drift:
        measured = without_drift(measured, correction.drift)
    if correction.zero:
        measured = zeroed(measured, correction.zero)
    if correction.preload:
        measured = from_preload(measured, correction.preload)
    return one_cycle(measured, correction.cycle) if correction.cycle else measured


def without_drift(measured: Measured, rows: int) -> Measured:
    """Return a curve without the straight drift of the force between its ends at rest.

    The drift is even in time; in the number of rows where there is no time.
    """
    _require(measured, 2 * rows, f"'drift: {rows}' needs as many rows at rest at each end")
    count = len(measured.force)
    time = np.arange(float(count)) if measured.time is None else measured.time
    start, end = slice(0, rows), slice(count - rows, count)
    first, last = (float(time[part].mean()) for part in (start, end))
    low, high = (float(measured.force[part].mean()) for part in (start, end))
    rate = (high - low) / (last - first) if last > first else 0.0
    return replace(measured, force=measured.force - low - rate * (time - first))


def zeroed(measured: Measured, rows: int) -> Measured:
    """Return a curve whose first rows have a mean force and displacement of zero."""
    _require(measured, rows, f"'zero: {rows}' needs as many rows at rest at the start")
    u, force = measured.displacement, measured.force
    return replace(measured, displacement=u - u[:rows].mean(), force=force - force[:rows].mean())


def from_preload(measured: Measured, preload: float) -> Measured:
    """Return a curve whose displacement counts from where the force first reaches a preload (N)."""
    u, force = measured.displacement, measured.force
    reached = np.flatnonzero(force >= preload)
    if not reached.size:
        message = f"the force does not reach the preload of {preload:g} N"
        remedy = f"The largest one is {force.max():.4g} N."
        raise case_error(str(measured.file), message, remedy)
    first = int(reached[0])
    origin = float(u[first])
    if first:
        origin = float(np.interp(preload, force[first - 1 : first + 1], u[first - 1 : first + 1]))
    _require(measured, first + FEWEST, "the preload leaves too few rows")
    part = _part(measured, first, len(u) - 1)
    return replace(part, displacement=part.displacement - origin)


def one_cycle(measured: Measured, number: int) -> Measured:
    """Return one cycle of a curve, from 1.

    A cycle of a test that goes to one side is a loading and an unloading. Of a test that goes to
    both sides it begins where the displacement passes its first value in the first direction.
    """
    u = measured.displacement
    ends = [int(rows[0]) for rows in measured.branches()] + [len(u) - 1]
    way = (u - u[0]) * np.sign(u[ends[1]] - u[0])
    if way.min() > -BOTH_SIDES * way.max():
        starts = ends[::2]
    else:
        # The first branch begins at the start, each second one after it passes it.
        rising = [(ends[i], ends[i + 1]) for i in range(2, len(ends) - 1, 2)]
        passed = (a + np.flatnonzero(way[a : b + 1] >= 0) for a, b in rising)
        last = rising[-1][1] if rising else 0
        starts = [0, *(int(rows[0]) if rows.size else last for rows in passed)]
    if number > len(starts) - 1:
        remedy = "A cycle ends where the next one begins, or where the sample is back at its start."
        message = f"there is no cycle {number}: the curve has {len(starts) - 1}"
        raise case_error(str(measured.file), message, remedy)
    return replace(_part(measured, starts[number - 1], starts[number]), cycle=number)


def _part(measured: Measured, first: int, last: int) -> Measured:
    """Return the rows of a curve from the first one to the last one."""
    rows = slice(first, last + 1)
    time = None if measured.time is None else measured.time[rows]
    return replace(
        measured,
        displacement=measured.displacement[rows],
        force=measured.force[rows],
        time=time,
    )


def _require(measured: Measured, rows: int, message: str) -> None:
    if len(measured.force) < rows:
        remedy = f"The curve has {len(measured.force)}."
        raise case_error(str(measured.file), message, remedy)
