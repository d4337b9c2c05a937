"""The cells of a workbook (XLSX), as text that the reader of tables understands.

A number is written without a decimal sign, 1.5 as ``15e-1``: it is read as it is, whatever the
decimal sign of numbers that the workbook holds as text.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from decimal import Decimal
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

from wovenfab.case.errors import CaseError, case_error, describe, near_miss
from wovenfab.lacking import load
from wovenfab.measured.cells import MeasuredCells, MeasuredRow
from wovenfab.measured.numbers import is_number, plain

#: Names of workbooks.
SUFFIXES = (".xlsx", ".xlsm")
#: First bytes of a zip archive, which a workbook is, and of what holds an encrypted one.
ZIP, ENCRYPTED = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"
#: Largest size of what is compressed in it (bytes): a small file may hold much more.
LARGEST = 200_000_000
#: Most rows of all sheets, and columns of each, that are read.
ROWS, COLUMNS = 1_000_000, 256
#: Parts by which other archives are known.
OTHERS = {
    "xl/workbook.bin": "a binary workbook (XLSB)",
    "content.xml": "a document of LibreOffice (ODS)",
    "word/document.xml": "a text document (DOCX)",
}
SAVE = "Save it as XLSX or CSV in a spreadsheet program, and name that file."


def is_workbook(path: Path, raw: bytes) -> bool:
    """Return whether a file is a workbook by its name, or an archive by its first bytes."""
    return path.suffix.lower() in SUFFIXES or raw.startswith(ZIP)


def cells_of_workbook(path: Path, raw: bytes, sheet: str = "") -> tuple[MeasuredCells, ...]:
    """Return the cells of the sheets of a workbook.

    Formulas count by their stored values. Hidden sheets count only by their name.

    Args:
        path: The file, for messages.
        raw: What is in it.
        sheet: Name of the only sheet that counts; empty for all that are shown.

    Raises:
        CaseError: It is no workbook, is damaged, encrypted or too large, or lacks the sheet.
        LackingError: The module that reads workbooks is not installed.
    """
    _check(path, raw)
    openpyxl = load("openpyxl", "openpyxl", "a workbook")
    try:
        with warnings.catch_warnings():  # on styles, which do not matter here
            warnings.simplefilter("ignore")
            book = openpyxl.load_workbook(BytesIO(raw), read_only=True, data_only=True)
            found: list[MeasuredCells] = []
            for chosen in _chosen(book.worksheets, sheet, path):
                left = ROWS - sum(len(cells.rows) for cells in found)
                rows = tuple(_rows(chosen, left, path))
                origin = f"workbook: sheet {chosen.title!r}"
                found.append(MeasuredCells(origin, rows, sheet=chosen.title))
            if not any(sum(map(is_number, r.cells)) > 1 for cells in found for r in cells.rows):
                formulas = openpyxl.load_workbook(BytesIO(raw), read_only=True)
                written = (_rows(formulas[cells.sheet], ROWS, path) for cells in found)
                if any(c.startswith("=") for rows in written for row in rows for c in row.cells):
                    remedy = "Open it in a spreadsheet program and save it: that computes them."
                    message = "the formulas of the workbook have no stored values"
                    raise case_error(str(path), message, remedy)
    except CaseError:
        raise
    except Exception as error:  # of a damaged file, of any kind: zip, zlib, XML, missing parts
        raise case_error(str(path), f"the workbook is damaged: {_reason(error)}", SAVE) from error
    return tuple(found)


def _check(path: Path, raw: bytes) -> None:
    """Make sure that a file is a workbook that can be read within limits.

    Raises:
        CaseError: It is not.
    """
    if raw.startswith(ENCRYPTED):
        secret = "EncryptedPackage".encode("utf-16-le") in raw
        kind = "is encrypted" if secret else "is an old one (XLS)"
        remedy = "Save it without a password." if secret else SAVE
        raise case_error(str(path), f"this workbook {kind}", remedy)
    if not raw.startswith(ZIP):
        remedy = "If it is text, let its name end in .csv."
        raise case_error(str(path), "this is no workbook (XLSX), as its name says", remedy)
    try:
        with ZipFile(BytesIO(raw)) as archive:
            parts = archive.infolist()
    except (BadZipFile, ValueError, NotImplementedError, OSError) as error:
        message = f"this is not text, and no whole workbook: {_reason(error)}"
        raise case_error(str(path), message, SAVE) from error
    names = {part.filename for part in parts}
    if "xl/workbook.xml" not in names:
        kind = next((kind for name, kind in OTHERS.items() if name in names), "another archive")
        message = f"this is not text, and no workbook (XLSX), but {kind}"
        raise case_error(str(path), message, SAVE)
    if any(part.flag_bits & 1 for part in parts):
        raise case_error(str(path), "this workbook is encrypted", "Save it without a password.")
    if sum(part.file_size for part in parts) > LARGEST:  # zipfile reads no more than it says
        message = f"the workbook is too large: more than {LARGEST / 1e6:.0f} MB are packed in it"
        raise case_error(str(path), message, "Save the sheet with the measured curve alone.")


def _chosen(sheets: list[Any], name: str, path: Path) -> list[Any]:
    """Return the sheets that count.

    Raises:
        CaseError: There are none.
    """
    shown = [s for s in sheets if s.sheet_state == "visible"]
    if not name:
        if not shown:
            message = "the workbook has no sheet with cells that is shown"
            raise case_error(str(path), message, "Name one: 'sheet: NAME' or --sheet.")
        return shown
    found = [s for s in sheets if s.title.strip().casefold() == name.strip().casefold()]
    if not found:
        titles = [s.title for s in sheets]
        remedy = near_miss(name, titles) or f"It has {', '.join(map(describe, titles))}."
        raise case_error(str(path), f"the workbook has no sheet {name!r}", remedy)
    return found


def _rows(sheet: Any, most: int, path: Path) -> Iterator[MeasuredRow]:
    """Yield the rows of a sheet.

    Raises:
        CaseError: They are too many.
    """
    sheet.reset_dimensions()  # what the file says of its size may be false
    values = sheet.iter_rows(max_row=most + 1, max_col=COLUMNS, values_only=True)
    for line, row in enumerate(values, start=1):
        if line > most:
            message = f"the sheets have more than {ROWS} rows up to {sheet.title!r}"
            raise case_error(str(path), message, "Save the sheet with the measured curve alone.")
        width = len(row) if row.count(None) < len(row) else 0
        while width and row[width - 1] is None:
            width -= 1
        yield MeasuredRow(line, tuple(map(_cell, row[:width])))


def _cell(value: Any) -> str:
    """Return the text of a cell; dates and times as ISO 8601 has them, with a blank."""
    if value is None:
        return ""
    if isinstance(value, int | float) and not isinstance(value, bool):
        sign, digits, exponent = Decimal(repr(value)).as_tuple()
        if isinstance(exponent, int):  # neither infinite nor nan
            return f"{'-' * sign}{''.join(map(str, digits))}e{exponent}"
    return plain(" ".join(str(value).split()))  # a name may be broken into lines


def _reason(error: Exception) -> str:
    """Return in one line what an error says."""
    said = " ".join(str(error).split())
    return describe(said) if said else type(error).__name__
