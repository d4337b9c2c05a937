"""Clouds of measured points, as digital image correlation gives them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wovenfab.case import units
from wovenfab.case.errors import case_error, describe
from wovenfab.measured.layout import EMPTY, Layout
from wovenfab.measured.names import WORDS, fold, name_of, units_in
from wovenfab.measured.table import MeasuredTable, is_missing, read_table

Array = NDArray[np.float64]
#: Names of the columns.
CLOUD = {
    "x": ("x", "x0"),
    "y": ("y", "y0"),
    "ux": ("ux", "u_x", "u", "dx", "disp x", "disp_x"),
    "uy": ("uy", "u_y", "v", "dy", "disp y", "disp_y"),
}


def read_cloud(path: Path, layout: Layout = EMPTY) -> tuple[Array, Array]:
    """Return a cloud of measured points.

    The header has columns x, y, ux and uy (or u and v, or displacement x and y) with their units.
    Rows in which one of them is empty or NaN, where the correlation was lost, are left out.

    Args:
        path: The file.
        layout: What the user says of it.

    Returns:
        Reference positions and displacements, shape (n, 2) each, m.

    Raises:
        CaseError: With file and line.
    """
    table = read_table(path, layout)
    remedy = "The header is like 'x (mm),y (mm),ux (mm),uy (mm)'."
    values = []
    for name in CLOUD:
        at = _column(name, table, layout, remedy)
        factor = _factor(name, at, table, layout, remedy)
        column = table.column(at)
        for row, value in zip(table.rows, column, strict=True):
            if not np.isfinite(value) and not is_missing(row.cell(at)):
                message = f"{name} (column {at + 1}) must be a number, got {describe(row.cell(at))}"
                raise case_error(str(path), message, "Remove the row, or correct it.", row.line)
        values.append(factor * column)
    rows = np.array(values).T
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows):
        raise case_error(str(path), "there is no row with a position and a displacement", remedy)
    return rows[:, :2], rows[:, 2:]


def _column(name: str, table: MeasuredTable, layout: Layout, remedy: str) -> int:
    """Return the column, from 0, of a coordinate or displacement."""
    given = layout.columns.get(name)
    if isinstance(given, int):
        if 1 <= given <= table.width:
            return given - 1
        found = []
    elif given is not None:
        word = given.strip().casefold()
        names = ({t.strip().casefold(), name_of(t).casefold()} for t in table.titles)
        found = [i for i, n in enumerate(names) if word in n]
    else:
        found = [i for i, t in enumerate(table.titles) if t and _means(t, name)]
    if len(found) == 1:
        return found[0]
    what = "no column" if not found else "more than one column"
    wanted = f"{given!r} for {name!r}" if given is not None else f"{name!r}"
    say = f"Or name it: --columns {name}={min(table.width, 2)}. {table.names}"
    raise case_error(str(table.file), f"there is {what} {wanted}", f"{remedy} {say}", table.header)


def _means(title: str, name: str) -> bool:
    short = name_of(title).casefold()
    if {title.strip().casefold(), short} & {*CLOUD[name]}:
        return True
    if len(name) == 1:
        return False
    # "displacement x" in one of the languages
    words = fold(short).replace("_", " ").split()
    moved = {fold(word) for word in WORDS["displacement"]}
    return len(words) == 2 and name[1] in words and bool(moved & {*words})


def _factor(name: str, at: int, table: MeasuredTable, layout: Layout, remedy: str) -> float:
    """Return how many metres the unit of a column is."""
    path = str(table.file)
    if (given := layout.units.get(name)) is not None:
        try:
            text = given if given.strip()[:1] in tuple("+-.0123456789") else f"1 {given}"
            return units.parse(text, "m")
        except ValueError as error:
            message = f"the unit of {name} must be {units.kind('m')}, got {error}"
            raise case_error(path, message) from error
    for unit in units_in(table.titles[at], table.units[at]):
        if unit.si == "m":
            return unit.factor
    say = "Or say it: --units x=mm,y=mm,ux=mm,uy=mm."
    raise case_error(path, f"the header has no unit of the {name}", f"{remedy} {say}", table.header)
