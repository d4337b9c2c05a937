"""Measured curves and clouds of points, as machines write them: text with headers of any kind.

Separators are comma, semicolon, tab or blanks; numbers have a decimal point or comma. What stands
above the first row of numbers is the header, from which names and units of the columns come.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wovenfab.case import units
from wovenfab.case.errors import describe, refusal

Array = NDArray[np.float64]
#: Number and cells of each line.
Lines = list[tuple[int, list[str]]]
#: SI units of the quantities, and words by which their columns are known.
QUANTITIES = {
    "displacement": ("m", ("displacement", "extension", "crosshead", "stroke", "travel", "weg")),
    "force": ("N", ("force", "load", "kraft")),
    "time": ("s", ("time", "zeit", "temps")),
}
#: Units that a remedy shows.
EXAMPLES = {"m": "mm", "N": "N", "s": "s"}
#: Names of the columns of a cloud of points.
CLOUD = {
    "x": ("x", "x0"),
    "y": ("y", "y0"),
    "ux": ("ux", "u_x", "u", "dx"),
    "uy": ("uy", "u_y", "v", "dy"),
}
#: How cells may be separated; None for blanks.
SEPARATORS = ("\t", ";", ",", None)
#: Largest file (bytes), and fewest rows.
LARGEST, FEWEST = 50_000_000, 3
_UNIT_AT_END = re.compile(
    r"^(?P<name>.*?)[\s_]*(?:[(\[/]\s*(?P<a>[^()\[\]]*?)\s*[)\]]?|_(?P<b>\w+))$"
)


@dataclass(frozen=True)
class Measured:
    """A measured curve in the order of time.

    Attributes:
        file: Where it is from.
        displacement: m, shape (n,).
        force: N, shape (n,).
        time: s, shape (n,), or None.
    """

    file: Path
    displacement: Array
    force: Array
    time: Array | None = None

    def branches(self) -> list[NDArray[np.intp]]:
        """Return the rows of each loading and unloading, reversals in both.

        A way back of less than a hundredth of the whole range is taken for noise.
        """
        u = self.displacement
        least = 0.01 * float(np.ptp(u))
        turns, extreme, sign = [0], 0, 0.0
        for i in range(1, len(u)):
            way = u[i] - u[extreme]
            if sign == 0 and abs(way) > least:
                sign = np.sign(way)
            if sign * way >= 0:
                extreme = i
            elif sign and -sign * way > least:
                turns.append(extreme)
                extreme, sign = i, -sign
        return [np.arange(a, b + 1) for a, b in pairwise([*turns, len(u) - 1])]


def read_measured(
    path: Path,
    columns: Mapping[str, str | int] | None = None,
    given_units: Mapping[str, str] | None = None,
) -> Measured:
    """Return the curve in a file.

    Args:
        path: The file.
        columns: Name or number (from 1) of the columns of displacement, force and time, where
            the header does not tell.
        given_units: Units of these, where the header does not tell.

    Raises:
        CaseError: With file and line.
    """
    header, data, titles = _table(path)
    width, chosen, factors = len(data[0][1]), {}, {}
    for quantity, (unit, _) in QUANTITIES.items():
        at = _column(quantity, (columns or {}).get(quantity), titles, path, width)
        if at is not None:
            chosen[quantity] = at
            said = f"'units: {{{quantity}: {EXAMPLES[unit]}}}' in a fit file"
            remedy = f"Say it: {said}, or {_title(quantity)} in the header."
            given = (given_units or {}).get(quantity)
            factors[quantity] = _factor(quantity, unit, at, titles, header, given, remedy, path)
    values = {
        quantity: np.array([_value(cells, at, line, quantity, path) for line, cells in data])
        for quantity, at in chosen.items()
    }
    if len(data) < FEWEST:
        raise refusal(str(path), f"there are only {len(data)} rows of numbers", "", data[-1][0])
    si = {quantity: factors[quantity] * v for quantity, v in values.items()}
    time = si.get("time")
    if time is not None and (back := np.flatnonzero(np.diff(time) <= 0)).size:
        line = data[int(back[0]) + 1][0]
        raise refusal(str(path), "times must increase", "Name another column, or none.", line)
    if not np.ptp(si["displacement"]):
        raise refusal(str(path), "the displacement does not change", "Name another column.")
    return Measured(path, si["displacement"], si["force"], time)


def read_cloud(path: Path) -> tuple[Array, Array]:
    """Return a cloud of measured points, as digital image correlation gives it.

    The header has columns x, y, ux and uy (or u and v) with their units. Rows in which one of
    them is empty or NaN, where the correlation was lost, are left out.

    Args:
        path: The file.

    Returns:
        Reference positions and displacements, shape (n, 2) each, m.

    Raises:
        CaseError: With file and line.
    """
    header, data, titles = _table(path)
    remedy = "The header is like 'x (mm),y (mm),ux (mm),uy (mm)'."
    columns = []
    for name, words in CLOUD.items():
        found = [i for i, t in enumerate(titles) if {t.strip().lower(), _name(t)} & {*words}]
        if len(found) != 1:
            what = "no column" if not found else "more than one column"
            line = header[-1][0] if header else None
            raise refusal(str(path), f"there is {what} {name!r}", remedy, line)
        at = found[0]
        factor = _factor(name, "m", at, titles, header, None, remedy, path)
        columns.append([factor * _or_nan(cells, at, line, name, path) for line, cells in data])
    rows = np.array(columns).T
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows):
        raise refusal(str(path), "there is no row with a position and a displacement", remedy)
    return rows[:, :2], rows[:, 2:]


def _or_nan(cells: Sequence[str], at: int, line: int, name: str, path: Path) -> float:
    cell = cells[at] if at < len(cells) else ""
    lost = cell.strip().lower() in ("", "nan")
    return np.nan if lost else _value(cells, at, line, name, path)


def _table(
    path: Path,
) -> tuple[list[tuple[int, list[str]]], list[tuple[int, list[str]]], list[str]]:
    """Return header and data of a file, line by line with their numbers, and the titles."""
    rows = _rows(_text(path), path)
    first = next((i for i, (_, cells) in enumerate(rows) if _numbers(cells)), None)
    if first is None:
        raise refusal(str(path), "there is no row with two numbers", "Export the table as text.")
    return rows[:first], rows[first:], _titles(rows[:first], len(rows[first][1]))


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > LARGEST:
            raise refusal(str(path), "this is too large for a measured curve (more than 50 MB)")
        raw = path.read_bytes()
    except OSError as error:
        raise refusal(str(path), f"the file cannot be read: {error.strerror}") from error
    if b"\0" in raw:
        remedy = "Export it as text, such as CSV: spreadsheets and machines can."
        raise refusal(str(path), "this is not text", remedy)
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("cp1252", errors="replace")


def _rows(text: str, path: Path) -> list[tuple[int, list[str]]]:
    """Return line number and cells of each line that is not empty."""
    lines = [(n, line) for n, line in enumerate(text.splitlines(), start=1) if line.strip()]
    if not lines:
        raise refusal(str(path), "the file is empty")
    splits = [[(n, _cells(line, s)) for n, line in lines] for s in SEPARATORS]
    return max(splits, key=lambda rows: sum(_numbers(cells) for _, cells in rows))


def _cells(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.split()
    try:
        cells = next(csv.reader(StringIO(line), delimiter=separator), [])
    except csv.Error:
        cells = line.split(separator)
    return [cell.strip() for cell in cells]


def _numbers(cells: Sequence[str]) -> bool:
    """Return whether at least two cells are numbers, and none is a word."""
    known = [_number(cell) is not None for cell in cells if cell]
    return len(known) >= 2 and all(known)


def _number(cell: str) -> float | None:
    """Return the number in a cell, with a decimal point or comma."""
    text = cell.strip().strip("\"'")
    if text.count(",") == 1 and "." not in text:
        text = text.replace(",", ".")
    try:
        value = float(text)
    except ValueError:
        return None
    return value if "_" not in text else None


def _value(cells: Sequence[str], at: int, line: int, quantity: str, path: Path) -> float:
    cell = cells[at] if at < len(cells) else ""
    value = _number(cell)
    if value is None or not np.isfinite(value):
        got = describe(cell) if cell else "nothing"
        message = f"{quantity} (column {at + 1}) must be a finite number, got {got}"
        raise refusal(str(path), message, "Remove the row, or correct it.", line)
    return value


def _titles(header: Sequence[tuple[int, list[str]]], width: int) -> list[str]:
    """Return the names of the columns: the last line of the header that is not of units alone."""
    rows = [cells for _, cells in header if len(cells) >= width]
    words = [cells for cells in rows if not all(_is_unit(c) for c in cells if c)]
    return (words or rows or [[""] * width])[-1][:width]


def _is_unit(text: str) -> bool:
    try:
        units.in_si(text.strip("()[] "))
    except ValueError:
        return False
    return True


def _title(quantity: str) -> str:
    """Return a title that tells a quantity and its unit."""
    return f"'{quantity}_{EXAMPLES[QUANTITIES[quantity][0]]}'"


def _name(title: str) -> str:
    """Return a title without its unit, in small letters."""
    match = _UNIT_AT_END.match(title)
    return (match["name"] if match else title).strip().lower()


def _column(
    quantity: str, given: str | int | None, titles: Sequence[str], path: Path, width: int
) -> int | None:
    """Return the number of a column, from 0; None for a time that is not there."""
    shown = [t for t in titles if t]
    names = f"There are {width} columns and no names: give their numbers, from 1."
    if shown:
        names = f"The columns are {', '.join(map(repr, shown))}."
    if isinstance(given, int):
        if not 1 <= given <= width:
            raise refusal(str(path), f"there is no column {given} for the {quantity}", names)
        return given - 1
    if given is not None:
        for i, title in enumerate(titles):
            if given.strip().lower() in (title.strip().lower(), _name(title)):
                return i
        raise refusal(str(path), f"there is no column {given!r} for the {quantity}", names)
    words = QUANTITIES[quantity][1]
    found = [i for i, title in enumerate(titles) if any(word in title.lower() for word in words)]
    if len(found) == 1:
        return found[0]
    if quantity == "time":
        return None
    if not found and width == 2 and not any(_known(t) for t in titles):
        return 0 if quantity == "displacement" else 1
    which = "more than one column may be" if found else "no column is known as"
    named = f"'columns: {{{quantity}: ...}}' in a fit file, or {_title(quantity)} in the header"
    remedy = f"Name it: {named}. {names}"
    raise refusal(str(path), f"{which} the {quantity}", remedy)


def _known(title: str) -> bool:
    return any(word in title.lower() for _, words in QUANTITIES.values() for word in words)


def _factor(
    quantity: str,
    unit: str,
    at: int,
    titles: Sequence[str],
    header: Sequence[tuple[int, list[str]]],
    given: str | None,
    remedy: str,
    path: Path,
) -> float:
    """Return how many SI units the unit of a column is."""
    for text in (given,) if given else _candidates(at, titles, header):
        try:
            return units.parse(f"1 {text}", unit)
        except ValueError as error:
            if given:
                message = f"the unit of the {quantity} must be {units.kind(unit)}, got {error}"
                raise refusal(str(path), message) from error
    raise refusal(str(path), f"the header has no unit of the {quantity}", remedy)


def _candidates(
    at: int, titles: Sequence[str], header: Sequence[tuple[int, list[str]]]
) -> Iterator[str]:
    """Yield what may be the unit of a column: in its title, or below it."""
    match = _UNIT_AT_END.match(titles[at])
    if match and (text := match["a"] or match["b"]):
        yield text
    if titles[at]:
        yield titles[at].split()[-1].strip("()[]")
    for _, cells in header:
        if at < len(cells):
            yield cells[at].strip("()[] ")
