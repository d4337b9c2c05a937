"""Measured curves: force against displacement in the order of time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wovenfab.case.errors import case_error, describe
from wovenfab.case.specimen import ShearTest
from wovenfab.measured.columns import OF, OVER, MeasuredColumn, columns_of, setting_text
from wovenfab.measured.layout import EMPTY, Layout
from wovenfab.measured.names import SI
from wovenfab.measured.numbers import NAMES
from wovenfab.measured.table import MeasuredTable, read_table, short
from wovenfab.measured.text import SEPARATORS

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
#: Fewest rows, and the largest share of rows without numbers.
FEWEST, SKIPPED = 3, 0.1
#: A way back that is less is noise: as a share of the range of the displacement, at least and at
#: most, and as a multiple of the scatter between rows.
WAY_BACK, OF_SCATTER = (0.01, 0.05), 10.0
#: Standard deviation of third differences of noise over that of the noise, and median over it.
THIRD, MEDIAN = 20.0**0.5, 0.6745


@dataclass(frozen=True)
class Reading:
    """How a file was read.

    Attributes:
        table: The table of numbers.
        columns: Columns by quantity.
        values: Their numbers in SI units, shape (n,) each.
        lines: Line of each row that is used, shape (n,).
        skipped: Lines of rows without a number that is needed, each with the cell.
        notes: Sentences on what was not read, or assumed.
    """

    table: MeasuredTable
    columns: dict[str, MeasuredColumn]
    values: dict[str, Array]
    lines: NDArray[np.intp]
    skipped: tuple[tuple[int, str], ...]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        """Return in a sentence which columns and rows are used."""
        named = ", ".join(f"{quantity} from {c}" for quantity, c in self.columns.items())
        return f"{named}; {self.rows}"

    @property
    def over(self) -> str:
        """The quantity that the other one is measured over: displacement or angle."""
        return next(q for q in OVER if q in self.columns)

    @property
    def of(self) -> str:
        """The quantity that is measured: force or shear_force."""
        return next(q for q in OF if q in self.columns)

    @property
    def rows(self) -> str:
        """Rows used and skipped, in words."""
        used = f"{len(self.lines)} rows (lines {self.lines[0]} to {self.lines[-1]})"
        if not self.skipped:
            return used
        shown = ", ".join(f"{n} has {_shown(cell)}" for n, cell in self.skipped[:3])
        more = ", ..." if len(self.skipped) > 3 else ""
        return f"{used}, {len(self.skipped)} skipped (line {shown}{more})"


@dataclass(frozen=True)
class Measured:
    """A measured curve in the order of time.

    Attributes:
        file: Where it is from.
        displacement: m, shape (n,).
        force: N, shape (n,).
        time: s, shape (n,), or None.
        reading: How the file was read; None for a curve that is from none.
        cycle: Which cycle of the record it is, from 1; 0 if it is all of it.
        reversals: Rows at which it reverses, with the first and the last one; found if empty.
    """

    file: Path
    displacement: Array
    force: Array
    time: Array | None = None
    reading: Reading | None = None
    cycle: int = 0
    reversals: tuple[int, ...] = ()

    def branches(self) -> list[Rows]:
        """Return the rows of each loading and unloading, reversals in both.

        A branch ends at its extreme where the displacement goes back from it by more than noise
        does, however many rows that takes.
        """
        return [np.arange(a, b + 1) for a, b in pairwise(self._turns)]

    @cached_property
    def is_reversed(self) -> bool:
        """Whether the force is against the displacement, as :func:`is_reversed` says."""
        return is_reversed(self.displacement, self.force)

    @cached_property
    def _turns(self) -> list[int]:
        return [*self.reversals] or turns(self.displacement)


def is_reversed(displacement: Array, force: Array) -> bool:
    """Return whether a force is against the displacement from the start, and more and more.

    On the first branch its work is negative and the force falls: no sample at rest does so.
    """
    rows = slice(0, turns(displacement)[1] + 1)
    u, force = displacement[rows], force[rows]
    falls = float((u - u.mean()) @ (force - force.mean())) < 0
    return falls and float(np.trapezoid(force, u)) < 0


def turns(displacement: Array) -> list[int]:
    """Return the rows at which a displacement reverses, with the first and the last one."""
    least = _least_way_back(displacement)
    u: list[float] = [float(value) for value in displacement]
    found, sign = [0], 0
    high = low = 0  # extremes since the last reversal
    for i in range(1, len(u)):
        if u[i] > u[high]:
            high = i
        if u[i] < u[low]:
            low = i
        if sign >= 0 and u[high] - u[i] > least:
            if sign > 0:
                found.append(high)
            sign, low, high = -1, i, i
        elif sign <= 0 and u[i] - u[low] > least:
            if sign < 0:
                found.append(low)
            sign, low, high = 1, i, i
    return [*found, len(u) - 1]


def _least_way_back(displacement: Array) -> float:
    """Return the way back (m) from which on a displacement has reversed."""
    extent = float(np.ptp(displacement))
    third = np.diff(displacement, 3)
    scatter = float(np.median(np.abs(third))) / (MEDIAN * THIRD) if third.size else 0.0
    low, high = (share * extent for share in WAY_BACK)
    return float(np.clip(OF_SCATTER * scatter, low, high))


def read_measured(path: Path, layout: Layout = EMPTY, test: ShearTest | None = None) -> Measured:
    """Return the curve in a file.

    A shear angle and a normalised shear force become displacement and force of the test.

    Args:
        path: The file.
        layout: What the user says of it.
        test: The test that was made; None if it is neither a bias extension nor a picture frame.

    Raises:
        CaseError: With file, line and remedy.
    """
    reading = read_curve(path, layout)
    x, y = reading.values[reading.over], reading.values[reading.of]
    if (reading.over, reading.of) != (OVER[0], OF[0]):
        if test is None:
            raise case_error(str(path), *_no_shear_test(reading), reading.table.header)
        try:
            angle = test.angle_at(x) if reading.over == "displacement" else x
            if not (np.abs(angle) < np.pi / 2).all():
                raise ValueError("shear angles must be between -90 and 90 degrees")
            force = test.force_at(angle, y) if reading.of == "shear_force" else y
            x, y = test.displacement_at(angle), force
        except ValueError as error:
            raise case_error(str(path), str(error)) from error
    return Measured(path, x, y, reading.values.get("time"), reading)


def read_curve(path: Path, layout: Layout = EMPTY) -> Reading:
    """Return the columns of a curve in a file, as they are there.

    Args:
        path: The file.
        layout: What the user says of it.

    Raises:
        CaseError: With file, line and remedy.
    """
    table = read_table(path, layout)
    columns = columns_of(table, layout)
    over, of = (next(q for q in pair if q in columns) for pair in (OVER, OF))
    notes = list(table.notes)
    if not any(table.titles) and len(layout.columns) < 2:
        notes.append("The columns have no names: displacement and force are taken in this order.")
    values = {q: c.factor * table.column(c.number - 1) for q, c in columns.items()}
    needed = np.isfinite(values[over]) & np.isfinite(values[of])
    if "time" in values and not np.isfinite(values["time"][needed]).all():
        column = columns.pop("time")
        notes.append(f"Column {column.number} ({short(column.title)!r}) is no time in numbers.")
    skipped = _skipped(table, columns, (over, of), needed)
    values = {q: values[q][needed] for q in columns}
    lines = np.array([row.line for row in table.rows])[needed]
    if len(lines) < FEWEST:
        line = table.rows[-1].line
        message = f"there are only {len(lines)} rows of numbers"
        raise case_error(str(path), message, table.names, line)
    time = values.get("time")
    if time is not None and (back := np.flatnonzero(np.diff(time) < 0)).size:
        line = int(lines[int(back[0]) + 1])
        remedy = "Name another column as the time, or say which rows to read."
        raise case_error(str(path), "times must increase", remedy, line)
    if not np.ptp(values[over]):
        remedy = f"It is {columns[over]}: name another column. {table.names}"
        raise case_error(str(path), f"the {over} does not change", remedy)
    return Reading(table, columns, values, lines, skipped, tuple(notes))


def _no_shear_test(reading: Reading) -> tuple[str, str]:
    """Return message and remedy for an angle or a shear force of a test that is no shear test."""
    name = reading.over if reading.over == "angle" else reading.of
    kind = "is an angle" if name == "angle" else "is a shear force per length"
    title = short(reading.columns[name].title)
    return (
        f"{title!r} {kind}, which is compared in a bias extension (a rectangle at least twice as "
        "long as wide, yarns at 45 degrees) or a picture frame",
        "A fit does that where the case is one. Else give the travel of the grips or of the "
        "crosshead, and its force.",
    )


def describe_reading(reading: Reading) -> list[str]:
    """Return lines that say how a curve was read and what is in it."""
    table = reading.table
    groups = f", thousands separated by {table.thousands!r}" if table.thousands else ""
    header = "no names of columns" if table.header is None else f"names in line {table.header}"
    between = f" separated by {SEPARATORS[table.separator]}" if table.separator else ""
    lines = [
        f"{table.origin}, {table.width} columns{between}, decimal {NAMES[table.decimal]}{groups}, "
        f"{header}",
        *(f"{quantity}: {column}" for quantity, column in reading.columns.items()),
        f"rows: {reading.rows}",
    ]
    x, y = reading.values[reading.over], reading.values[reading.of]
    unit, size = ("deg", np.degrees(1.0)) if reading.over == "angle" else ("mm", 1e3)
    ends = [f"{size * x[at]:.4g}" for at in turns(x)]
    shown = ends if len(ends) < 13 else [*ends[:6], "...", *ends[-6:]]
    lines.append(f"branches: {len(ends) - 1} ({' to '.join(shown)} {unit})")
    peak = int(np.abs(y).argmax())
    lines.append(
        f"largest force: {y[peak]:.5g} {SI[reading.of]} at {size * x[peak]:.4g} {unit} (line "
        f"{reading.lines[peak]})"
    )
    if is_reversed(x, y):
        lines.append(f"note: {reversed_force(reading)}")
    return [*lines, *(f"note: {note}" for note in reading.notes)]


def reversed_force(reading: Reading | None) -> str:
    """Return in a sentence that the force has the wrong sign, and what to do."""
    of = reading.of if reading else "force"
    unit = reading.columns[of].unit if reading else "N"
    unit = unit if unit[:1].isalpha() else SI[of]
    return (
        "the force is against the displacement: on the first branch its work is negative, which no "
        "sample at rest gives. If the machine counts pull as negative, say "
        f"{setting_text('units', of, f'-1 {unit}')}"
    )


def _shown(cell: str) -> str:
    return describe(cell) if cell else "nothing"


def _skipped(
    table: MeasuredTable,
    columns: dict[str, MeasuredColumn],
    quantities: tuple[str, str],
    needed: NDArray[np.bool_],
) -> tuple[tuple[int, str], ...]:
    """Return the lines of rows that are skipped, each with the cell that is no number.

    Raises:
        CaseError: They are too many.
    """
    found = []
    for i in np.flatnonzero(~needed):
        row = table.rows[i]
        for quantity in quantities:
            at = columns[quantity].number - 1
            if not np.isfinite(table.column_value(row, at)):
                found.append((row.line, quantity, at, row.cell(at)))
                break
    if len(found) > SKIPPED * len(needed):
        line, quantity, at, cell = found[0]
        message = f"{quantity} (column {at + 1}) must be a finite number, got {_shown(cell)}"
        many = f", and so in {len(found)} of {len(needed)} rows" if len(found) > 1 else ""
        remedy = (
            f"Up to {100 * SKIPPED:.0f} % of the rows are skipped for that: name another column, "
            "say which rows to read, or correct them."
        )
        raise case_error(str(table.file), message + many, remedy, line)
    return tuple((line, cell) for line, _, _, cell in found)
