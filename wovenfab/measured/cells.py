"""The cells of a measured file, whether they are from a text or from a sheet of a workbook."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from wovenfab.case.errors import case_error

#: Largest file (bytes).
LARGEST = 50_000_000


@dataclass(frozen=True)
class MeasuredRow:
    """A line of a text, or a row of a sheet.

    Attributes:
        line: Its number, from 1.
        cells: Its cells.
        quoted: Whether quotation marks tell its cells apart.
    """

    line: int
    cells: tuple[str, ...]
    quoted: bool = False

    def cell(self, at: int) -> str:
        """Return the cell of a column, from 0; empty where the line has no such column."""
        return self.cells[at] if at < len(self.cells) else ""


@dataclass(frozen=True)
class MeasuredCells:
    """All cells of a text or of a sheet.

    Attributes:
        origin: What they are from, in words.
        rows: All lines, also empty ones; the first one has the number 1.
        separator: What separates them in a text; empty in a workbook.
        cut: Whether the last line has no end, as in a text whose writing was interrupted.
        sheet: Name of the sheet; empty for a text.
    """

    origin: str
    rows: tuple[MeasuredRow, ...]
    separator: str = ""
    cut: bool = False
    sheet: str = ""


def read_bytes(path: Path) -> bytes:
    """Return what is in a file.

    Raises:
        CaseError: It cannot be read, is too large, or is no ordinary file: a pipe may never end.
    """
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise case_error(str(path), "this is not an ordinary file")
        with path.open("rb") as file:
            raw = file.read(LARGEST + 1)
    except OSError as error:
        raise case_error(str(path), f"the file cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise case_error(str(path), "the file cannot be read: its name is not possible") from error
    if len(raw) > LARGEST:
        raise case_error(str(path), "this is too large for a measured file (more than 50 MB)")
    return raw
