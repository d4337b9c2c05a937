"""The table of numbers in a measured file: its header and its rows.

A file may begin with a report and with other tables. The table that counts is the longest block of
rows with numbers; its header is what stands above it, up to the block before.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wovenfab.case.errors import case_error
from wovenfab.measured.cells import MeasuredCells, MeasuredRow, read_bytes
from wovenfab.measured.layout import Layout
from wovenfab.measured.names import is_unit, unit_of
from wovenfab.measured.numbers import (
    COMMA,
    NAMES,
    POINT,
    decimals,
    evidence,
    is_number,
    number,
    thousands,
)
from wovenfab.measured.text import BLANKS, SAMPLE, SEPARATORS, cells_of_text
from wovenfab.measured.workbook import cells_of_workbook, is_workbook

Array = NDArray[np.float64]
#: Fewest rows of a second table that is asked for, and its size over that of the longest one.
SECOND, COMPARABLE = 3, 0.5
#: A cell that stands for a number that is missing.
_MISSING = re.compile(
    r"#.*|[-\u2013\u2014*.?]+|[-+]?inf(inity)?|n\.?/?a\.?|nan|nv|null|none|overflow|err(or)?"
    r"|[-+]?1\.#\w+",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class MeasuredTable:
    """The numbers of a file, not yet understood.

    Attributes:
        file: The file.
        origin: What its cells are from, in words.
        separator: Of the cells; empty in a workbook.
        decimal: Decimal sign.
        thousands: What separates thousands; empty if nothing does.
        titles: Names of the columns, perhaps empty; one for each.
        units: What may be the unit of each column in lines of units alone, best first.
        header: Line of the names; None if there is none.
        rows: Rows of numbers, and those between them that lack some.
        notes: Sentences on what else is in the file.
    """

    file: Path
    origin: str
    separator: str
    decimal: str
    thousands: str
    titles: tuple[str, ...]
    units: tuple[tuple[str, ...], ...]
    header: int | None
    rows: tuple[MeasuredRow, ...]
    notes: tuple[str, ...]

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.titles)

    def column_value(self, row: MeasuredRow, at: int) -> float:
        """Return the number of a row in a column, from 0; nan where there is none."""
        return number(row.cell(at), self.decimal)

    def column(self, at: int) -> Array:
        """Return the numbers of a column, from 0, shape (rows,); nan where there is none."""
        return np.array([number(row.cell(at), self.decimal) for row in self.rows])

    @property
    def names(self) -> str:
        """The columns in a sentence, for messages."""
        shown = [f"{i} {short(t)!r}" for i, t in enumerate(self.titles, 1) if t]
        if not shown:
            return f"There are {self.width} columns and no names: give their numbers, from 1."
        more = f" and {len(shown) - 12} more" if len(shown) > 12 else ""
        return f"The columns are {', '.join(shown[:12])}{more}."


@dataclass
class _Block:
    """Rows of numbers below each other."""

    head: list[MeasuredRow]  # lines above, up to the block before
    rows: list[MeasuredRow]
    count: int  # rows with two numbers at least
    gap: int = 0  # number of rows above the last empty line
    headers: list[int] = field(default_factory=list)  # lines that repeat the head

    @property
    def titled(self) -> bool:
        """Whether a line with several words stands above."""
        return any(sum(map(bool, row.cells)) > 1 for row in self.head)

    def __str__(self) -> str:
        return f"lines {self.rows[0].line} to {self.rows[-1].line}"


def read_table(path: Path, layout: Layout) -> MeasuredTable:
    """Return the table of numbers in a file.

    Raises:
        CaseError: With file and line: no numbers, or several readings.
    """
    cells, blocks, footer, unread = _longest(_sheets(path, layout))
    separator = cells.separator
    if layout.rows:
        first, last = layout.rows
        blocks = [b for b in (_within(b, first, last) for b in blocks) if b.count]
    if not blocks:
        where = f" in lines {layout.rows[0]} to {layout.rows[1]}" if layout.rows else ""
        remedy = "Export the table as text, with plain numbers and the units in the header."
        remedy = "Name the lines with numbers." if where else remedy
        raise case_error(str(path), f"there is no row with two numbers{where}", remedy)
    block, notes = _chosen(blocks, path, layout)
    notes += unread
    if not layout.rows:
        notes += _without_summary(block)
    if block.headers:
        notes.append(f"Lines that repeat the header are skipped: {_listed(block.headers)}.")
    width = max(len(row.cells) for row in block.rows)
    title = _title_row(block, separator)
    decimal = layout.decimal or _decimal(block, separator, path, width)
    titles = _titles(title, separator, width, path, layout, block)
    data, note = _without_cut_number(block.rows, cells, decimal)
    columns = [[row.cell(at) for row in data] for at in range(width)]
    groups = {sign for cells in columns if (sign := thousands(cells, decimal))}
    # Units stand below the names, sometimes above them or below the table.
    below = [row for row in block.head if title is None or row.line > title.line]
    above = [row for row in block.head if title is not None and row.line < title.line]
    beside = [row for row in (*above[::-1], *footer) if len(row.cells) - row.cells.count("") > 1]
    lines = [row for row in (*below, *beside) if _units_alone(row)]
    units = tuple(
        tuple(row.cell(at) for row in lines if row.cell(at).strip()) for at in range(width)
    )
    head = None if title is None else title.line
    return MeasuredTable(
        path, cells.origin, separator, decimal, " or ".join(sorted(groups)), titles, units,
        head, tuple(data), (*notes, *note),
    )  # fmt: skip


def _sheets(path: Path, layout: Layout) -> tuple[MeasuredCells, ...]:
    """Return the cells of a text, or of each sheet of a workbook that counts."""
    raw = read_bytes(path)
    if is_workbook(path, raw):
        return cells_of_workbook(path, raw, layout.sheet)
    if layout.sheet:
        message = f"there is no sheet {layout.sheet!r}: this is no workbook"
        raise case_error(str(path), message, "Leave out 'sheet' or --sheet.")
    return (cells_of_text(path, raw),)


def _longest(
    sheets: Sequence[MeasuredCells],
) -> tuple[MeasuredCells, list[_Block], list[MeasuredRow], list[str]]:
    """Return the cells with the longest block, their blocks and last lines, and notes on others."""
    found = [(cells, *_blocks(cells.rows)) for cells in sheets]
    counts = [max((block.count for block in blocks), default=0) for _, blocks, _ in found]
    most = counts.index(max(counts))
    notes = [
        f"The sheet {cells.sheet!r} ({count} rows of numbers) is not read: 'sheet' in a fit file "
        "or --sheet names another one."
        for i, (cells, count) in enumerate(zip(sheets, counts, strict=True))
        if i != most and count > COMPARABLE * counts[most]
    ]
    return *found[most], notes


def _listed(lines: Sequence[int]) -> str:
    more = f" and {len(lines) - 12} more" if len(lines) > 12 else ""
    return ", ".join(map(str, lines[:12])) + more


def is_missing(cell: str) -> bool:
    """Return whether a cell is empty or says that its number is missing (NaN, #VALUE!, ---)."""
    return not cell or _MISSING.fullmatch(cell) is not None


def short(text: str) -> str:
    """Return a text of at most 40 characters."""
    return text if len(text) <= 40 else f"{text[:37]}..."


def _blocks(rows: Sequence[MeasuredRow]) -> tuple[list[_Block], list[MeasuredRow]]:
    """Return the blocks of rows with numbers, and the lines below the last one."""
    blocks: list[_Block] = []
    text: list[MeasuredRow] = []
    open_block = empty = False
    for row in rows:
        filled = [cell for cell in row.cells if cell]
        found = sum(map(is_number, filled))
        if not filled:
            empty = True
            continue
        if found > 1:
            if not open_block:
                blocks.append(_Block(text, [], 0))
                text, open_block = [], True
            elif empty:
                blocks[-1].gap = len(blocks[-1].rows)
            blocks[-1].rows.append(row)
            blocks[-1].count += 1
            empty = False
        elif open_block and (
            all(is_missing(cell) or is_number(cell) for cell in filled)
            or (found and not _is_word(filled[0]))
        ):
            blocks[-1].rows.append(row)
        elif open_block and any(_same(row, head) for head in blocks[-1].head):
            blocks[-1].headers.append(row.line)
        else:  # also a label with a number, such as a mean
            text.append(row)
            open_block = False
    return blocks, text


def _is_word(cell: str) -> bool:
    return sum(map(str.isalpha, cell)) > 1 and not is_missing(cell)


def _same(row: MeasuredRow, other: MeasuredRow) -> bool:
    return [c.casefold() for c in row.cells if c] == [c.casefold() for c in other.cells if c]


def _within(block: _Block, first: int, last: int) -> _Block:
    rows = [row for row in block.rows if first <= row.line <= last]
    count = sum(sum(map(is_number, row.cells)) > 1 for row in rows)
    return _Block(block.head, rows, count, headers=[n for n in block.headers if first <= n <= last])


def _chosen(blocks: list[_Block], path: Path, layout: Layout) -> tuple[_Block, list[str]]:
    """Return the block that counts, and sentences on others."""
    block = max(blocks, key=lambda b: b.count)
    if layout.rows:  # all of them
        rows = [row for b in blocks for row in b.rows]
        headers = [line for b in blocks for line in b.headers]
        return _Block(block.head, rows, sum(b.count for b in blocks), headers=headers), []
    notes = []
    titles = [row for row in block.head if sum(map(bool, row.cells)) > 1]
    for other in blocks:
        if other is block or other.count < SECOND:
            continue
        same = other.titled and titles and any(_same(titles[-1], row) for row in other.head)
        later = blocks.index(other) > 0
        if other.count > COMPARABLE * block.count or same or (later and not other.titled):
            line = max(other.rows[0].line, block.rows[0].line)
            one, two = sorted((block, other), key=lambda b: b.rows[0].line)
            first, last = one.rows[0].line, two.rows[-1].line
            raise case_error(
                str(path),
                f"there are two tables of numbers, {one} and {two}",
                f"Say which lines: 'rows: {one.rows[0].line}-{one.rows[-1].line}' in a fit file or "
                f"--rows; {first}-{last} takes both as one.",
                line,
            )
        notes.append(f"Another table ({other}) is not read.")
    return block, notes


def _without_summary(block: _Block) -> list[str]:
    """Take away one or two rows below an empty line, such as means, and say so."""
    if not block.gap or not 0 < len(block.rows) - block.gap < SECOND < block.gap:
        return []
    first, last = block.rows[block.gap].line, block.rows[-1].line
    del block.rows[block.gap :]
    lines = f"Line {first}" if first == last else f"Lines {first} and {last}"
    verb = "is" if first == last else "are"
    return [f"{lines} below an empty line {verb} not read; 'rows' or --rows would include them."]


def _title_row(block: _Block, separator: str) -> MeasuredRow | None:
    """Return the line with the names of the columns; None if there is none."""
    words = [row for row in block.head if not _units_alone(row)]
    if not words:
        return None
    numbers = min(_numeric(block), 2) if separator == BLANKS else _numeric(block)
    return next(
        (row for row in reversed(words) if sum(map(bool, row.cells)) >= numbers),
        next((row for row in reversed(words) if sum(map(bool, row.cells)) > 1), None),
    )


def _numeric(block: _Block) -> int:
    """Return the usual number of numbers in a row."""
    counts = Counter(sum(map(is_number, row.cells)) for row in block.rows[:SAMPLE])
    return counts.most_common(1)[0][0]


def _last_number(block: _Block) -> int:
    """Return the usual number, from 1, of the last column with a number."""
    last = (
        max((i for i, c in enumerate(row.cells, 1) if is_number(c)), default=0)
        for row in block.rows[:SAMPLE]
    )
    return Counter(last).most_common(1)[0][0]


def _units_alone(row: MeasuredRow) -> bool:
    cells = [cell for cell in row.cells if cell and not is_missing(cell)]
    return bool(cells) and all(is_unit(cell) for cell in cells)


def _titles(
    row: MeasuredRow | None, separator: str, width: int, path: Path, layout: Layout, block: _Block
) -> tuple[str, ...]:
    """Return the names of the columns."""
    numbers = {str(q) for q, c in layout.columns.items() if isinstance(c, int)}
    found = [] if row is None else list(row.cells)
    if row is not None and separator == BLANKS and len(found) != width:
        found = _joined(row.cells, width) or ["?"] * width  # whose they are cannot be told
    while found and not found[-1]:
        found.pop()
    filled = _last_number(block)
    if 1 < len(found) < filled and len(numbers) < 2:
        remedy = "Give the numbers of the columns, or a name to each."
        if separator in (COMMA, BLANKS):
            what = "decimals or thousands" if separator == COMMA else "thousands"
            remedy = (
                f"If {SEPARATORS[separator]} are in the numbers, too, for {what}, save the table "
                "with semicolons or tabs between the columns. Else give the numbers of the columns."
            )
        message = f"{filled} numbers stand below {len(found)} names"
        raise case_error(str(path), message, remedy, block.rows[0].line)
    full = (r for r in block.rows[:-1] if separator == BLANKS and all(map(is_number, r.cells)))
    if len(widths := {len(r.cells) for r in full}) > 1:
        low, high = min(widths), max(widths)
        raise case_error(
            str(path),
            f"rows have {low} to {high} numbers: blanks separate columns and perhaps thousands",
            "Save the table with semicolons or tabs between the columns.",
            next(r.line for r in block.rows if len(r.cells) == high),
        )
    return tuple([*found, *[""] * width][:width])


def _joined(cells: Sequence[str], width: int) -> list[str]:
    """Return names of columns that blanks separate, with their units in one cell; else none."""
    line = re.sub(r"\s*/\s*", "/", re.sub(r"\s+(?=[\[(])", "\u00a0", " ".join(cells)))
    found = line.split(" ")
    pairs = list(zip(found[::2], found[1::2], strict=False))
    if len(found) == 2 * width and all(unit_of(unit) for _, unit in pairs):
        return [f"{name} [{unit}]" for name, unit in pairs]
    return found if len(found) == width else []


def _decimal(block: _Block, separator: str, path: Path, width: int) -> str:
    """Return the decimal sign that all columns settle together."""
    found = evidence([[row.cell(at) for row in block.rows] for at in range(width)])
    if found.decimal:
        return found.decimal
    say = "Say it: 'decimal: \",\"' or 'decimal: \".\"' in a fit file, --decimal comma or point."
    if found.mixed:
        words = " and ".join(
            f"{cell!r} (line {block.rows[i].line}) a decimal {NAMES[sign]}"
            for sign, (i, cell) in found.needed.items()
        )
        line = block.rows[next(iter(found.needed.values()))[0]].line
        message = f"the decimal sign is not the same everywhere: {words}"
        raise case_error(str(path), message, say, line)
    assert found.either is not None
    i, cell = found.either
    row = block.rows[i]
    if separator == COMMA and not row.quoted:
        return POINT  # where commas separate cells, decimals have points
    readings = " or ".join(
        f"{number(cell, sign):g} with a decimal {name}" for sign, name in NAMES.items()
    )
    raise case_error(
        str(path), f"{cell!r} is {readings}, and no other number tells which", say, row.line
    )


def _without_cut_number(
    rows: Sequence[MeasuredRow], cells: MeasuredCells, decimal: str
) -> tuple[Sequence[MeasuredRow], list[str]]:
    """Return rows without a last one whose last number is cut, and a sentence on that.

    It is cut where the file ends without the end of a line, and it has fewer decimals than all
    other numbers of its column, which have the same number of decimals.
    """
    last = rows[-1]
    if not cells.cut or last.line != len(cells.rows) or len(rows) < 2 * SECOND:
        return rows, []
    at = len(last.cells) - 1
    counts = {decimals(row.cell(at), decimal) for row in rows[:-1] if is_number(row.cell(at))}
    if len(counts) == 1 and decimals(last.cell(at), decimal) < counts.pop():
        note = f"Line {last.line} is not read: the file ends within it."
        return rows[:-1], [note]
    return rows, []
