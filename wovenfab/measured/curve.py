"""Measured curves: force against displacement in the order of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wovenfab.case import units
from wovenfab.case.errors import case_error, describe
from wovenfab.measured.layout import EMPTY, Layout
from wovenfab.measured.names import SI, MeasuredUnit, means, means_strain, name_of, units_in
from wovenfab.measured.numbers import NAMES
from wovenfab.measured.table import MeasuredTable, read_table, short
from wovenfab.measured.text import SEPARATORS

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
#: Units that a remedy shows.
EXAMPLES = {"displacement": "mm", "force": "N", "time": "s"}
#: Fewest rows, and the largest share of rows without numbers.
FEWEST, SKIPPED = 3, 0.1
#: A way back that is less is noise: as a share of the range of the displacement, at least and at
#: most, and as a multiple of the scatter between rows.
WAY_BACK, OF_SCATTER = (0.01, 0.05), 10.0
#: Standard deviation of third differences of noise over that of the noise, and median over it.
THIRD, MEDIAN = 20.0**0.5, 0.6745


@dataclass(frozen=True)
class Column:
    """A column as it was understood.

    Attributes:
        number: From 1.
        title: As written, perhaps empty.
        unit: As written in the header or said by the user.
        factor: SI units of a number in it.
    """

    number: int
    title: str
    unit: str
    factor: float

    def __str__(self) -> str:
        """Return number, title and unit."""
        title = f" {short(self.title)!r}" if self.title else ""
        return f"column {self.number}{title} in {self.unit}"


@dataclass(frozen=True)
class Reading:
    """How a file was read.

    Attributes:
        table: The table of numbers.
        columns: Columns by quantity.
        lines: Line of each row that is used, shape (n,).
        skipped: Lines of rows without a number that is needed, each with the cell.
        notes: Sentences on what was not read, or assumed.
    """

    table: MeasuredTable
    columns: dict[str, Column]
    lines: NDArray[np.intp]
    skipped: tuple[tuple[int, str], ...]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        """Return in a sentence which columns and rows are used."""
        named = ", ".join(f"{quantity} from {c}" for quantity, c in self.columns.items())
        return f"{named}; {self.rows}"

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
    """

    file: Path
    displacement: Array
    force: Array
    time: Array | None = None
    reading: Reading | None = None

    def branches(self) -> list[Rows]:
        """Return the rows of each loading and unloading, reversals in both.

        A branch ends at its extreme where the displacement goes back from it by more than noise
        does, however many rows that takes.
        """
        return [np.arange(a, b + 1) for a, b in pairwise(self._turns)]

    @cached_property
    def is_reversed(self) -> bool:
        """Whether the force is against the displacement from the start, and more and more.

        On the first branch its work is negative and the force falls: no sample at rest does so.
        """
        rows = self.branches()[0]
        u, force = self.displacement[rows], self.force[rows]
        falls = float((u - u.mean()) @ (force - force.mean())) < 0
        return falls and float(np.trapezoid(force, u)) < 0

    @cached_property
    def _turns(self) -> list[int]:
        return turns(self.displacement)


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


def read_measured(path: Path, layout: Layout = EMPTY) -> Measured:
    """Return the curve in a file.

    Args:
        path: The file.
        layout: What the user says of it.

    Raises:
        CaseError: With file, line and remedy.
    """
    table = read_table(path, layout)
    columns: dict[str, Column] = {}
    notes = list(table.notes)
    for quantity in SI:
        found = _column(quantity, table, layout, columns)
        if found is not None:
            columns[quantity] = found
    if not any(table.titles) and len(layout.columns) < 2:
        notes.append("The columns have no names: displacement and force are taken in this order.")
    values = {q: c.factor * table.column(c.number - 1) for q, c in columns.items()}
    needed = np.isfinite(values["displacement"]) & np.isfinite(values["force"])
    if "time" in values and not np.isfinite(values["time"][needed]).all():
        column = columns.pop("time")
        notes.append(f"Column {column.number} ({short(column.title)!r}) is no time in numbers.")
    skipped = _skipped(table, columns, needed)
    u, force = values["displacement"][needed], values["force"][needed]
    lines = np.array([row.line for row in table.rows])[needed]
    time = values["time"][needed] if "time" in columns else None
    if len(u) < FEWEST:
        line = table.rows[-1].line
        message = f"there are only {len(u)} rows of numbers"
        raise case_error(str(path), message, table.names, line)
    if time is not None and (back := np.flatnonzero(np.diff(time) < 0)).size:
        line = int(lines[int(back[0]) + 1])
        remedy = "Name another column as the time, or say which rows to read."
        raise case_error(str(path), "times must increase", remedy, line)
    if not np.ptp(u):
        remedy = f"It is {columns['displacement']}: name another column. {table.names}"
        raise case_error(str(path), "the displacement does not change", remedy)
    reading = Reading(table, columns, lines, skipped, tuple(notes))
    return Measured(path, u, force, time, reading)


def in_words(measured: Measured) -> list[str]:
    """Return lines that say how a curve was read and what is in it."""
    reading = measured.reading
    assert reading is not None
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
    u, force = 1e3 * measured.displacement, measured.force
    branches = measured.branches()
    ends = [f"{u[0]:.4g}", *(f"{u[rows[-1]]:.4g}" for rows in branches)]
    shown = ends if len(ends) < 13 else [*ends[:6], "...", *ends[-6:]]
    lines.append(f"branches: {len(branches)} ({' to '.join(shown)} mm)")
    peak = int(np.abs(force).argmax())
    lines.append(
        f"largest force: {force[peak]:.5g} N at {u[peak]:.4g} mm (line {reading.lines[peak]})"
    )
    if measured.is_reversed:
        lines.append(f"note: {reversed_force(measured)}")
    return [*lines, *(f"note: {note}" for note in reading.notes)]


def reversed_force(measured: Measured) -> str:
    """Return in a sentence that the force has the wrong sign, and what to do."""
    unit = measured.reading.columns["force"].unit if measured.reading else "N"
    unit = unit if unit[:1].isalpha() else "N"
    return (
        "the force is against the displacement: on the first branch its work is negative, which no "
        "sample at rest gives. If the machine counts pull as negative, say "
        f"{said('units', 'force', f'-1 {unit}')}"
    )


def said(what: str, quantity: str, value: str) -> str:
    """Return how something is said of a file, in a fit file and on the command line."""
    option = f"--{what} {quantity}={value}"
    quoted = f"'{option}'" if " " in value else option
    return f"'{what}: {{{quantity}: {value}}}' in a fit file, {quoted}"


def _shown(cell: str) -> str:
    return describe(cell) if cell else "nothing"


def _skipped(
    table: MeasuredTable, columns: dict[str, Column], needed: NDArray[np.bool_]
) -> tuple[tuple[int, str], ...]:
    """Return the lines of rows that are skipped, each with the cell that is no number.

    Raises:
        CaseError: They are too many.
    """
    found = []
    for i in np.flatnonzero(~needed):
        row = table.rows[i]
        for quantity in ("displacement", "force"):
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


def _column(
    quantity: str, table: MeasuredTable, layout: Layout, others: dict[str, Column]
) -> Column | None:
    """Return the column of a quantity; None for a time that is not there."""
    given, unit = layout.columns.get(quantity), layout.units.get(quantity)
    path, titles = str(table.file), table.titles
    if given is not None:
        at = _given(quantity, given, table)
    else:
        taken = {c.number - 1 for c in others.values()}
        found = [i for i, t in enumerate(titles) if i not in taken and means(t, quantity)]
        kinds = {i: _unit(table, i, quantity) for i in found}
        fitting = [i for i in found if unit or _fits(kinds[i], quantity)]
        if len(fitting) > 1 and not unit:  # one with a unit, if there is just one
            fitting = [i for i in fitting if kinds[i] is not None] or fitting
        if quantity == "time" and len(fitting) != 1:
            return None
        if not fitting and not any(titles) and table.width == 2:
            fitting = [_in_order(quantity, table)]
        if len(fitting) != 1:
            raise _unknown(quantity, table, found, fitting)
        at = fitting[0]
    if unit is not None:
        return Column(at + 1, titles[at], unit, _factor(quantity, unit, path))
    written = _unit(table, at, quantity)
    same = [u for u in units_in(titles[at], table.units[at]) if u.si == SI[quantity]]
    if len({u.factor for u in same}) > 1:
        texts = " and ".join(dict.fromkeys(repr(u.text) for u in same))
        remedy = f"Say which: {said('units', quantity, same[0].text)}."
        raise case_error(path, f"the header has several units of the {quantity}, {texts}", remedy)
    if written is not None and written.si == SI[quantity]:
        return Column(at + 1, titles[at], written.text, written.factor)
    if quantity == "time":
        return None
    if written is not None:
        raise case_error(path, *_other_kind(quantity, titles[at], written), table.header)
    title = f"'{quantity}_{EXAMPLES[quantity]}'"
    raise case_error(
        path,
        f"the header has no unit of the {quantity}",
        f"Say it: {said('units', quantity, EXAMPLES[quantity])}, or {title} in the header.",
        table.header,
    )


def _in_order(quantity: str, table: MeasuredTable) -> int:
    """Return which of two columns without names a quantity is: by units, or in their order."""
    for at in (0, 1):
        unit = _unit(table, at, quantity)
        if unit is not None and unit.si == SI[quantity]:
            return at
    return 0 if quantity == "displacement" else 1


def _given(quantity: str, given: str | int, table: MeasuredTable) -> int:
    """Return the number, from 0, of a column that the user names."""
    path = str(table.file)
    if isinstance(given, int):
        if not 1 <= given <= table.width:
            message = f"there is no column {given} for the {quantity}"
            raise case_error(path, message, table.names, table.header)
        return given - 1
    word = given.strip().casefold()
    for name in (str.casefold, lambda title: name_of(title).casefold()):
        found = [i for i, title in enumerate(table.titles) if name(title).strip() == word]
        if len(found) > 1:
            numbers = ", ".join(str(i + 1) for i in found)
            message = f"the columns {numbers} have the name {given!r}"
            remedy = f"Give a number: {said('columns', quantity, str(found[0] + 1))}."
            raise case_error(path, message, remedy, table.header)
        if found:
            return found[0]
    message = f"there is no column {given!r} for the {quantity}"
    raise case_error(path, message, table.names, table.header)


def _unit(table: MeasuredTable, at: int, quantity: str) -> MeasuredUnit | None:
    """Return the unit of a column: of the kind of a quantity if there is one, else another."""
    found = list(units_in(table.titles[at], table.units[at]))
    return next((u for u in found if u.si == SI[quantity]), next(iter(found), None))


def _fits(unit: MeasuredUnit | None, quantity: str) -> bool:
    return unit is None or unit.si == SI[quantity]


def _factor(quantity: str, unit: str, path: str) -> float:
    """Return how many SI units a unit is that the user gives, perhaps with a number."""
    text = unit if unit.strip()[:1] in tuple("+-.0123456789") else f"1 {unit}"
    known = {"kp": "kgf"}
    text = " ".join(known.get(word, word) for word in text.split(" "))
    try:
        factor = units.parse(text, SI[quantity])
        if not text.strip(" +-.0123456789eE"):
            raise ValueError(f"{unit!r} without a unit")
    except ValueError as error:
        kind = units.kind(SI[quantity])
        raise case_error(path, f"the unit of the {quantity} must be {kind}, got {error}") from error
    if not factor:
        raise case_error(path, f"the unit of the {quantity} must not be zero, got {unit!r}")
    return factor


def _unknown(
    quantity: str, table: MeasuredTable, found: Sequence[int], fitting: Sequence[int]
) -> Exception:
    """Return the error of a quantity without a column, or with several."""
    path, titles = str(table.file), table.titles
    if not fitting and found:
        unit = _unit(table, found[0], quantity)
        assert unit is not None
        return case_error(path, *_other_kind(quantity, titles[found[0]], unit), table.header)
    if not fitting and quantity == "displacement":
        for at, title in enumerate(titles):
            unit = _unit(table, at, quantity)
            if means_strain(title) or (unit is not None and unit.si == "an angle"):
                kind = unit or MeasuredUnit("", "a ratio", 0.0)
                return case_error(path, *_other_kind(quantity, title, kind), table.header)
    which = "more than one column may be" if fitting else "no column is known as"
    example = fitting[0] + 1 if fitting else min(table.width, 2)
    named = f"{said('columns', quantity, str(example))}, or '{quantity}_{EXAMPLES[quantity]}'"
    remedy = f"Name it: {named} in the header. {table.names}"
    return case_error(path, f"{which} the {quantity}", remedy, table.header)


def _other_kind(quantity: str, title: str, unit: MeasuredUnit) -> tuple[str, str]:
    """Return message and remedy for a column whose unit does not measure its quantity."""
    kinds = {"m": "a length", "N": "a force", "s": "a time"}
    kind = kinds.get(unit.si, unit.si)
    message = f"{short(title)!r} is {kind}, and no {'length' if quantity != 'force' else 'force'}"
    match quantity, kind:
        case "displacement", "a ratio":
            remedy = (
                "A strain times the length of the sample is a displacement: for per cent of 230 mm "
                f"say {said('units', quantity, '2.3 mm')}, and name the column."
            )
        case "displacement", "an angle":
            remedy = (
                "An angle is no displacement of the machine: give the travel of the grips, of a "
                "picture frame that of the crosshead, and its force."
            )
        case "force", "a force per length":
            factor = units.in_si(unit.text.replace("gf", "force_gram").replace("kp", "kgf"))[0]
            remedy = (
                f"Times the width of the sample it is a force: for 100 mm say "
                f"{said('units', quantity, f'{0.1 * factor:.6g} N')}."
            )
        case "force", "a force per area":
            factor = units.in_si(unit.text)[0]
            remedy = (
                "Times the cross-section of the sample it is a force: for 100 mm by 0.5 mm say "
                f"{said('units', quantity, f'{5e-5 * factor:.6g} N')}."
            )
        case "force", "a mass":
            weight = {"g": "gf", "gr": "gf", "kg": "kgf", "oz": "ozf"}.get(unit.text.casefold())
            weight = weight or "lbf"
            remedy = f"If its weight is meant, say {said('units', quantity, weight)}."
        case _:
            say = said("units", quantity, EXAMPLES[quantity])
            remedy = f"Name another column, or say the unit: {say}."
    return message, remedy
