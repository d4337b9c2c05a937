"""Clouds of measured points, as digital image correlation gives them.

Names of columns were taken from files and sources of these programs:

- DICe (github.com/dicengine/dice): ``COORDINATE_X``, ``DISPLACEMENT_X`` in pixels, of two cameras
  ``MODEL_COORDINATES_X``, ``MODEL_DISPLACEMENT_X`` in the unit of the calibration; ``SIGMA`` is -1
  where the correlation was lost.
- ARAMIS, exported by github.com/dlr-wf/aramis-data-exporter: ``x_undef [mm]``, ``u [mm]``.
- VIC-3D: ``X [mm]``, ``U [mm]`` beside ``x [pixel]``, ``u [pixel]`` of the picture; ``sigma`` is
  negative where the correlation was lost. VIC-2D: ``x``, ``y``, ``u``, ``v``.

muDIC writes no table of its own.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
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
    "x": ("x", "x0", "x_undef", "coordinate_x", "model_coordinates_x"),
    "y": ("y", "y0", "y_undef", "coordinate_y", "model_coordinates_y"),
    "ux": ("ux", "u_x", "u", "dx", "disp x", "disp_x", "model_displacement_x"),
    "uy": ("uy", "u_y", "v", "dy", "disp y", "disp_y", "model_displacement_y"),
}
#: What the metric columns begin with where a program writes those of the picture, too.
MODEL = "model_"
#: Name of the column that is negative where the correlation was lost.
SIGMA = "sigma"
#: Columns of a picture's pixels, where the header has no unit.
PIXELS = ("coordinate_x", "coordinate_y")
_PIXEL = re.compile(r"\b(px|pix|pixels?)\b", re.IGNORECASE)


@dataclass(frozen=True)
class MeasuredCloud:
    """Measured displacements of points.

    Attributes:
        points: Positions, shape (n, 2), m.
        displacements: Shape (n, 2), m.
        lost: Number of rows that were left out, since the correlation was lost.
    """

    points: Array
    displacements: Array
    lost: int = 0


def read_cloud(path: Path, layout: Layout = EMPTY) -> MeasuredCloud:
    """Return a cloud of measured points.

    The header has columns x, y, ux and uy (or u and v, or displacement x and y, or the names of a
    program) with their units. A unit that is said of one of them holds for the others without one.
    Rows in which one of them is empty or NaN, or sigma is negative, are left out: there the
    correlation was lost.

    Args:
        path: The file.
        layout: What the user says of it.

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
    found = np.isfinite(rows).all(axis=1)
    for at, title in enumerate(table.titles):
        if name_of(title).casefold() == SIGMA:
            found &= ~(table.column(at) < 0)
    if not found.any():
        raise case_error(str(path), "there is no row with a position and a displacement", remedy)
    rows = rows[found]
    return MeasuredCloud(rows[:, :2], rows[:, 2:], int(np.count_nonzero(~found)))


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
        found = found if len(found) < 2 else _metric(found, table) or found
    if len(found) == 1:
        return found[0]
    what = "no column" if not found else "more than one column"
    wanted = f"{given!r} for {name!r}" if given is not None else f"{name!r}"
    say = f"Or name it: --columns {name}={min(table.width, 2)}. {table.names}"
    raise case_error(str(table.file), f"there is {what} {wanted}", f"{remedy} {say}", table.header)


def _metric(found: list[int], table: MeasuredTable) -> list[int]:
    """Return the columns that are lengths of several of one name; others are of the picture."""
    titles = [table.titles[i] for i in found]
    lengths = [i for i in found if _length(i, table) is not None]
    if len(lengths) == 1:
        return lengths
    names = [name_of(t) for t in titles]
    model = [i for i, n in zip(found, names, strict=True) if n.casefold().startswith(MODEL)]
    if model:
        return model
    return [i for i, n in zip(found, names, strict=True) if n.isupper()]  # as VIC-3D has them


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
    if (factor := _length(at, table)) is not None:
        return factor
    title = table.titles[at]
    pixels = _PIXEL.search(" ".join([title.replace("_", " "), *table.units[at]]))
    others = [layout.units[n] for n in CLOUD if n in layout.units]
    if others:  # said of another column; its sign is its own
        return abs(_factor(name, at, table, Layout(units={name: others[0]}), remedy))
    if pixels or name_of(title).casefold() in PIXELS:
        say = (
            "Say how long a pixel is on the sheet, such as --units x=0.05mm; where rows of the "
            "picture count downwards --units x=0.05mm,y=-0.05mm,ux=0.05mm,uy=-0.05mm."
        )
        raise case_error(path, f"{name} ({title!r}) is in pixels", say, table.header)
    say = "Or say it: --units x=mm,y=mm,ux=mm,uy=mm."
    raise case_error(path, f"the header has no unit of the {name}", f"{remedy} {say}", table.header)


def _length(at: int, table: MeasuredTable) -> float | None:
    """Return how many metres the unit of a column in the header is; None if it has none."""
    found = (u for u in units_in(table.titles[at], table.units[at]) if u.si == "m")
    return next((unit.factor for unit in found), None)
