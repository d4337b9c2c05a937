"""Tables of displacements or forces against time, from CSV files, and the thinning of long ones."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from pydantic import ValidationInfo

from wovenfab.case.csv_file import read_csv
from wovenfab.case.errors import describe, one_of, value_error

COLUMNS, FORCE = ("time_s", "displacement_m"), "force_N"


@dataclass(frozen=True)
class Samples:
    """A displacement program as measured or computed elsewhere.

    Attributes:
        file: The CSV file it was read from.
        times: Strictly increasing, from the start of the segment, s.
        values: Displacements (m), or forces (N) where ``force`` is true; one for each time.
        rows: Number of rows of the file; more than there are times where it was thinned.
        force: Whether the column is force_N.
    """

    file: Path
    times: tuple[float, ...]
    values: tuple[float, ...]
    rows: int
    force: bool = False


def read_samples(value: Any, info: ValidationInfo) -> Samples:
    """Return the contents of a CSV file with the columns time_s and displacement_m or force_N.

    A tolerance that is read before thins them.
    """
    table = read_csv(value, info)
    force = FORCE in table.titles
    if force and COLUMNS[1] in table.titles:
        raise value_error(f"{value}:1: there are both {COLUMNS[1]} and {FORCE}", "Leave out one.")
    columns = (COLUMNS[0], FORCE) if force else COLUMNS
    if missing := [c for c in columns if c not in table.titles]:
        raise value_error(
            f"{value}:1: there is no column {one_of(missing)}",
            f"The first line must be '{','.join(columns)}'.",
        )
    rows = [_row(row, table.place(i), columns) for i, row in enumerate(table.rows)]
    if not rows:
        raise value_error(f"{value}: the table is empty")
    if rows[0][0] < 0:
        raise value_error(f"{value}:2: times must not be negative, got {rows[0][0]}")
    times, values, places = zip(*rows, strict=True)
    for before, time, place in zip(times, times[1:], places[1:], strict=False):
        if time <= before:
            raise value_error(f"{place}: times must increase, got {time} after {before}")
    if tolerance := info.data.get("tolerance"):
        if force:
            raise value_error(
                f"{value}: a tolerance is a length, and the column is {FORCE}", "Leave it out."
            )
        corners = thinned(list(zip(times, values, strict=True)), tolerance)
        times, values = zip(*corners, strict=True)
    return Samples(table.path, times, values, len(rows), force)


def _row(row: Mapping[str, Any], place: str, columns: Iterable[str]) -> tuple[float, float, str]:
    values = []
    for column in columns:
        try:
            value = float(row[column] or "")
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            got = describe(row[column] or None)
            raise value_error(f"{place}: {column} must be a finite number, got {got}")
        values.append(value)
    return values[0], values[1], place


Point = tuple[float, float]


def thinned(rows: Sequence[Point], tolerance: float) -> list[Point]:
    """Return the corners of the fewest straight pieces that are close to rows, in linear time.

    Both ends, and the rows where the motion reverses by more than the tolerance, are corners.

    Args:
        rows: Times, strictly increasing, and displacements.
        tolerance: Largest distance of the displacements at any time.
    """
    turns = _turns([displacement for _, displacement in rows], tolerance)
    parts = (_straightened(rows[a : b + 1], tolerance) for a, b in pairwise(turns))
    return [rows[0], *(corner for part in parts for corner in part)]


def _turns(values: Sequence[float], least: float) -> list[int]:
    """Return which values are the ends, or where the way turns back by more than ``least``."""
    found, ahead = {0, len(values) - 1}, 0
    farthest = {1: 0, -1: 0}  # the highest and the lowest value since the last turn
    for i, value in enumerate(values):
        farthest = {s: i if s * value > s * values[far] else far for s, far in farthest.items()}
        for s, far in farthest.items():
            if ahead != -s and s * (values[far] - value) > least:
                found.add(far)
                ahead, farthest = -s, {s: far, -s: i}
                break
    return sorted(found)


def _straightened(rows: Sequence[Point], tolerance: float) -> list[Point]:
    """Return the corners after the first row of the fewest straight pieces between two rows.

    Each piece passes gates about the rows and goes as far as any line can. H. Imai, M. Iri: An
    optimal algorithm for approximating a piecewise linear function. J. Inf. Process. 9 (1986).
    Below, side 1 is above the rows, side -1 below them.
    """
    first, *_, last = rows
    # Of each side: hull of what lines must not cross, and the steepest line to that side that is
    # possible, by where it touches the other side, then this one, and its slope.
    hulls = {side: deque([first]) for side in (1, -1)}
    steepest = {side: (first, first, side * math.inf) for side in (1, -1)}
    gate, pieces, windows = {1: first, -1: first}, [], []
    for t, displacement in rows[1:]:
        width = 0.0 if t == last[0] else tolerance
        before, gate = gate, {side: (t, displacement + side * width) for side in (1, -1)}
        over = {s: s * (_at(steepest[-s], t) - gate[s][1]) for s in (1, -1)}
        s = max(over, key=over.__getitem__)
        if over[s] > 1e-9 * tolerance:  # no line passes: the last one leaves on this side
            foot, tip, slope = line = steepest[-s]
            room = s * (before[s][1] - _at(line, before[s][0]))
            u, v, share = before[s], gate[s], room / (room + over[s])
            leaves = u[0] + share * (v[0] - u[0]), u[1] + share * (v[1] - u[1])
            pieces.append((foot, slope))
            windows.append((tip[0], leaves[0]))
            while hulls[-s][0] != tip:
                hulls[-s].popleft()
            hulls[s] = deque([leaves])
            steepest = {s: (tip, leaves, slope), -s: (leaves, leaves, -s * math.inf)}
        for s in (1, -1):
            if s * (_at(steepest[s], t) - gate[s][1]) > 0:
                other = hulls[-s]
                while (
                    len(other) > 1
                    and s * (_rise(other[1], gate[s]) - _rise(other[0], gate[s])) <= 0
                ):
                    other.popleft()
                steepest[s] = other[0], gate[s], _rise(other[0], gate[s])
        for s in (1, -1):
            own = hulls[s]
            while len(own) > 1 and s * (_rise(own[-1], gate[s]) - _rise(own[-2], own[-1])) < 0:
                own.pop()
            own.append(gate[s])
    pieces.append((last, steepest[1][2]))
    corners = []
    for ((t, u1), a), ((t2, u2), b), window in zip(pieces, pieces[1:], windows, strict=False):
        low, high = window
        meet = min(max((u2 - b * t2 - u1 + a * t) / (a - b), low), high)
        corners.append((meet, u1 + a * (meet - t)))
    return [*corners, last]


def _at(line: tuple[Point, Point, float], t: float) -> float:
    return line[0][1] + line[2] * (t - line[0][0])


def _rise(a: Point, b: Point) -> float:
    return (b[1] - a[1]) / (b[0] - a[0])
