"""CSV files that a case names: a line of titles, and rows below it."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationInfo

from wovenfab.case.document import existing_file, folder_of
from wovenfab.case.errors import value_error


@dataclass(frozen=True)
class CsvFile:
    """The cells of a CSV file.

    Attributes:
        path: The file.
        name: As the case has it.
        titles: The first line.
        lines: Number of the last line of each row in the file.
        rows: The cells of each row by title; None where a row has too few.
    """

    path: Path
    name: str
    titles: tuple[str, ...]
    lines: tuple[int, ...]
    rows: tuple[Mapping[str, Any], ...]

    def place(self, row: int) -> str:
        """Return file and line of a row, from 0, for messages."""
        return f"{self.name}:{self.lines[row]}"


def read_csv(value: Any, info: ValidationInfo) -> CsvFile:
    """Return the cells of a CSV file with commas; an error of pydantic if it is none."""
    path = existing_file(value, folder_of(info), (".csv",))
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            table = csv.DictReader(stream)
            table.fieldnames = titles = [c.strip() for c in table.fieldnames or ()]
            rows = [(table.line_num, row) for row in table]
    except (UnicodeDecodeError, csv.Error) as error:
        raise value_error(
            f"{value}: this is not a text file with comma-separated values"
        ) from error
    except OSError as error:
        raise value_error(f"{value}: the file cannot be read: {error.strerror}") from error
    lines, cells = zip(*rows, strict=True) if rows else ((), ())
    return CsvFile(path, str(value), tuple(titles), lines, cells)
