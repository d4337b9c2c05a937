"""Files of a results directory as plain data, checked: they may be damaged, or of another program.

Nothing that such a file says is executed.
"""

from __future__ import annotations

import json
from collections.abc import Collection
from itertools import islice
from math import isfinite
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

#: Longest piece of a damaged file that a message quotes.
_QUOTED = 40


class UnreadableResultsError(ValueError):
    """A file of a results directory is damaged or was not written by wovenfab; says which."""


def text_of(path: Path, lines: int | None = None) -> str:
    """Return the text of a file, or its first so many lines.

    Raises:
        FileNotFoundError: It is not there.
        UnreadableResultsError: It is no text.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise damaged(path, "this is no ordinary file")
    try:
        with path.open("rb") as file:
            whole = file.read() if lines is None else b"".join(islice(file, lines))
        return whole.decode("utf-8")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise UnreadableResultsError(f"{path}:{line}: this is not UTF-8 text{RUN_AGAIN}") from None
    except IsADirectoryError:
        raise UnreadableResultsError(f"{path} is a folder, not a file{RUN_AGAIN}") from None


#: What to do with a damaged file.
RUN_AGAIN = "; the file is damaged, or not from wovenfab: restore it, or run the case again"


def read_table(
    path: Path,
    required: Collection[str] = (),
    ascending: str | None = None,
    rows: int | None = None,
) -> dict[str, NDArray[np.float64]]:
    """Return the columns of a table of numbers by name, each of shape (rows,).

    A last row that a killed run left unfinished is dropped.

    Args:
        path: A CSV file with one line of names.
        required: Columns that it must have.
        ascending: The column, if any, whose values must increase.
        rows: Number of rows that are read; all if None.

    Raises:
        FileNotFoundError: It is not there.
        UnreadableResultsError: It is no such table.
    """

    def fail(number: int, why: str) -> NoReturn:
        raise UnreadableResultsError(f"{path}:{number}: {why}{RUN_AGAIN}")

    text = text_of(path, None if rows is None else rows + 1)
    header, *lines = text[: text.rfind("\n") + 1].removesuffix("\n").split("\n")
    names = header.split(",")
    if not header:
        fail(1, "the file is empty, or has no line with the names of the columns")
    if not all(name.isprintable() and name for name in names) or len({*names}) < len(names):
        fail(1, "this is no line with the names of the columns")
    if missing := [name for name in required if name not in names]:
        fail(1, f"the columns {', '.join(missing)} are missing")
    values = np.empty((len(lines), len(names)))
    for row, line in enumerate(lines):
        cells = line.split(",")
        if len(cells) != len(names):
            fail(row + 2, f"there are {len(cells)} values for {len(names)} columns")
        for column, cell in enumerate(cells):
            try:
                values[row, column] = float(cell)
            except ValueError:
                fail(row + 2, f"{cell[:_QUOTED]!r} is no number")
        if not np.isfinite(values[row]).all():
            fail(row + 2, "a value is not finite")
    columns = {name: values[:, i] for i, name in enumerate(names)}
    if ascending is not None:
        back = np.flatnonzero(np.diff(columns[ascending]) <= 0)
        if len(back):
            fail(int(back[0]) + 3, f"{ascending} does not increase")
    return columns


def read_object(path: Path) -> dict[str, Any]:
    """Return the object of a JSON file, whose numbers are all finite.

    Raises:
        FileNotFoundError: It is not there.
        UnreadableResultsError: It is no such file.
    """

    def number(text: str) -> float:
        if not isfinite(value := float(text)):
            raise ValueError(f"{text} is not finite")
        return value

    try:
        content = json.loads(text_of(path), parse_constant=number, parse_float=number)
    except UnreadableResultsError:
        raise
    except (ValueError, RecursionError) as error:
        why = str(error) or "it is nested too deeply"
        raise UnreadableResultsError(f"{path} is not valid JSON ({why}){RUN_AGAIN}") from None
    if not isinstance(content, dict):
        raise UnreadableResultsError(f"{path} has no names with values{RUN_AGAIN}")
    return content


def damaged(path: Path, why: str) -> UnreadableResultsError:
    """Return the error of a file that is wrong for a reason in words."""
    return UnreadableResultsError(f"{path}: {why}{RUN_AGAIN}")
