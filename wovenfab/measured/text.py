"""The cells of a measured text, whatever its encoding and separator."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from wovenfab.case.errors import case_error
from wovenfab.measured.cells import MeasuredCells, MeasuredRow
from wovenfab.measured.numbers import is_number, plain

BLANKS = " "
#: How cells may be separated, with names for people.
SEPARATORS = {"\t": "tabs", ";": "semicolons", "|": "bars", ",": "commas", BLANKS: "blanks"}
#: First lines by which separators (with as many spread over the rest) and columns are found.
SAMPLE = 300
#: First bytes of files that are no text, and what they are.
OTHERS = {
    b"\xd0\xcf\x11\xe0": "an old Excel workbook (XLS)",
    b"%PDF": "a PDF",
}
#: Marks of an encoding at the start of a file; those of UTF-32 begin with those of UTF-16.
MARKS = {
    b"\xff\xfe\0\0": "utf-32",
    b"\0\0\xfe\xff": "utf-32",
    b"\xff\xfe": "utf-16",
    b"\xfe\xff": "utf-16",
    b"\xef\xbb\xbf": "utf-8-sig",
}
#: Share of zero bytes in every second place above which a file without a mark is UTF-16.
ZEROS = 0.7


def cells_of_text(path: Path, raw: bytes) -> MeasuredCells:
    """Return the cells of a text.

    Args:
        path: The file, for messages.
        raw: What is in it.

    Raises:
        CaseError: It is no text.
    """
    for start, kind in OTHERS.items():
        if raw.startswith(start):
            remedy = "Save the table as CSV (in Excel: Save As, CSV UTF-8), and name that file."
            raise case_error(str(path), f"this is not text, but {kind}", remedy)
    encoding = _encoding(raw)
    text = raw.decode(encoding, errors="replace").lstrip("\ufeff")
    if "\0" in text:
        remedy = "Export it as text, such as CSV: spreadsheets and machines can."
        raise case_error(str(path), "this is not text", remedy)
    if not text.strip():
        raise case_error(str(path), "the file is empty")
    lines = re.split(r"\r\n|\n|\r", text)
    separator = _separator(lines)
    rows = tuple(
        MeasuredRow(number, tuple(_cells(line, separator)), '"' in line)
        for number, line in enumerate(lines, start=1)
    )
    return MeasuredCells(f"text: {encoding}", rows, separator, cut=bool(lines[-1].strip()))


def _encoding(raw: bytes) -> str:
    for mark, encoding in MARKS.items():
        if raw.startswith(mark):
            return encoding
    for first, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        half = raw[first::2]
        if half and half.count(0) > ZEROS * len(half):
            return encoding
    for encoding in ("utf-8", "cp1252"):
        try:
            raw.decode(encoding)
        except UnicodeDecodeError:
            continue
        return encoding
    return "latin-1"


def _separator(text: Sequence[str]) -> str:
    """Return the separator with which the most characters are in cells with numbers."""
    lines = [line for line in text if line.strip()]
    step = max(1, (len(lines) - SAMPLE) // SAMPLE)
    sample = [*lines[:SAMPLE], *lines[SAMPLE::step]]

    def covered(separator: str) -> int:
        count = 0
        for line in sample:
            if separator not in line and separator != BLANKS:
                continue
            found = [cell for cell in _cells(line, separator) if is_number(cell)]
            if len(found) > 1:
                count += sum(len(cell.replace(" ", "")) for cell in found)
        return count

    return max(SEPARATORS, key=covered)


def _cells(line: str, separator: str) -> Iterator[str]:
    if separator == BLANKS:
        # Only blanks and tabs: others, which do not break a line, separate thousands.
        parts = re.split(r"[ \t]+", line.strip(" \t"))
    elif '"' in line:
        try:
            parts = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
        except csv.Error:
            parts = line.split(separator)
    else:
        parts = line.split(separator)
    return map(plain, parts)
