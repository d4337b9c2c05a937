"""Files that a case names, relative to the folder of the file that names them."""

from __future__ import annotations

import csv
import math
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationInfo

from .problems import describe, one_of, wrong

#: Key of a value that names a file, wherever it stands in a case.
FILE = "file"
#: Key that chooses among the laws of an effect.
LAW = "law"
COLUMNS = ("time_s", "displacement_m")


class FileName(str):
    """The name of a file, which remembers the folder of the file in which it stands."""

    folder: Path

    def __new__(cls, text: str, folder: Path) -> FileName:
        """Keep the folder beside the text."""
        name = super().__new__(cls, text)
        name.folder = folder
        return name


@dataclass(frozen=True)
class Samples:
    """A displacement program as measured or computed elsewhere.

    Attributes:
        file: The CSV file it was read from.
        times: Strictly increasing, from the start of the segment, s.
        displacements: One for each time, m.
    """

    file: Path
    times: tuple[float, ...]
    displacements: tuple[float, ...]


def existing_file(value: Any, folder: Path, suffixes: tuple[str, ...]) -> Path:
    """Return the absolute path of a file that a case names.

    Args:
        value: The text in the case.
        folder: Where the case lies, for a name that does not know its own folder.
        suffixes: Allowed ends of the name.
    """
    folder = value.folder if isinstance(value, FileName) else folder
    if not isinstance(value, str) or not value:
        raise wrong(f"expected the name of a file, got {describe(value)}")
    if Path(value).suffix not in suffixes:
        raise wrong(f"expected a file that ends in {one_of(suffixes)}, got {describe(value)}")
    with suppress(OSError, ValueError):  # such as a name that is too long
        path = (folder / value).resolve()
        if path.is_file():
            return path
    raise wrong(f"there is no file {describe(value)}", "Names are relative to the case file.")


def folder_of(info: ValidationInfo) -> Path:
    """Return where the case lies that is being read."""
    folder: Path = (info.context or {})["folder"]
    return folder


def read_samples(value: Any, info: ValidationInfo) -> Samples:
    """Return the contents of a CSV file with the columns time_s and displacement_m."""
    path = existing_file(value, folder_of(info), (".csv",))
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            table = csv.DictReader(stream)
            header = [c.strip() for c in table.fieldnames or ()]
            table.fieldnames = header
            if missing := [c for c in COLUMNS if c not in header]:
                raise wrong(
                    f"{value}:1: there is no column {one_of(missing)}",
                    f"The first line must be '{','.join(COLUMNS)}'.",
                )
            rows = [_row(row, f"{value}:{table.line_num}") for row in table]
    except (UnicodeDecodeError, csv.Error) as error:
        raise wrong(f"{value}: this is not a text file with comma-separated values") from error
    except OSError as error:
        raise wrong(f"{value}: the file cannot be read: {error.strerror}") from error
    if not rows:
        raise wrong(f"{value}: the table is empty")
    if rows[0][0] < 0:
        raise wrong(f"{value}:2: times must not be negative, got {rows[0][0]}")
    times, displacements, places = zip(*rows, strict=True)
    for before, time, place in zip(times, times[1:], places[1:], strict=False):
        if time <= before:
            raise wrong(f"{place}: times must increase, got {time} after {before}")
    return Samples(path, times, displacements)


def _row(row: dict[str, Any], place: str) -> tuple[float, float, str]:
    values = []
    for column in COLUMNS:
        try:
            value = float(row[column] or "")
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            got = describe(row[column] or None)
            raise wrong(f"{place}: {column} must be a finite number, got {got}")
        values.append(value)
    return values[0], values[1], place
