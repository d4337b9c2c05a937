"""Tables of forces against strains, from CSV files or in the case itself."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any

from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationInfo, create_model
from pydantic_core import core_schema

from wovenfab.case import units
from wovenfab.case.csv_file import CsvFile, read_csv
from wovenfab.case.errors import describe, value_error
from wovenfab.case.quantities import Json, Quantity, Section, Several
from wovenfab.forms.table import Column, ForceTable, ForceTableError, TableParameter

#: More rows take long to compile, and are hardly a law.
MOST_ROWS = 100
_TITLE = re.compile(r"(?P<name>[^\[(]*?)\s*(?:[\[(](?P<unit>[^\])]*)[\])])?")


def table_file(value: Any, parameter: TableParameter, info: ValidationInfo) -> ForceTable:
    """Return the table in a CSV file whose titles have the units, as in ``angle (deg)``."""
    file = read_csv(value, info)
    return _table([_column(file, c, parameter) for c in parameter.columns], parameter, file)


def titles_of(parameter: TableParameter) -> str:
    """Return the first line of a file with a table."""
    return ",".join(f"{c.name} ({c.unit})" if _unit(c) else c.name for c in parameter.columns)


def _unit(column: Column) -> str:
    return "" if column.unit == "1" else column.unit


def _column(file: CsvFile, column: Column, parameter: TableParameter) -> list[float]:
    """Return the numbers of a column in SI units."""
    unit, remedy = _unit(column), f"The first line is such as '{titles_of(parameter)}'."
    matches = ((title, _TITLE.fullmatch(title)) for title in file.titles)
    found = [(t, m["unit"] or "") for t, m in matches if m and m["name"].casefold() == column.name]
    if len(found) != 1:
        how_many = "are several columns" if found else "is no column"
        raise value_error(f"{file.name}:1: there {how_many} '{column.name}'", remedy)
    title, given = found[0]
    if unit and not given:
        raise value_error(f"{file.name}:1: the column '{title}' has no unit", remedy)
    try:
        units.parse(f"1 {given}", unit)
    except ValueError as error:
        reason = f"'{title}' is no column with {units.kind(unit)}"
        raise value_error(f"{file.name}:1: {reason}", remedy) from error
    numbers = []
    for row, cells in enumerate(file.rows):
        cell = cells[title]
        try:
            numbers.append(units.parse(f"{float(cell or '')!r} {given}", unit))
        except ValueError as error:
            got = describe(cell or None)
            message = f"{file.place(row)}: {column.name} must be a finite number, got {got}"
            raise value_error(message) from error
    return numbers


def _table(
    columns: Sequence[Sequence[float]], parameter: TableParameter, file: CsvFile | None = None
) -> ForceTable:
    """Return the table with two columns in SI units, from a file unless they are in the case."""
    where = "" if file is None else f"{file.name}: "
    if len(columns[0]) > MOST_ROWS:
        remedy = "Some 30 rows on a smooth line through the measured points are enough."
        raise value_error(f"{where}there are more than {MOST_ROWS} rows", remedy)
    try:
        return ForceTable(*map(tuple, columns))
    except ForceTableError as error:
        column, row = parameter.columns[error.column], error.row
        if row is not None:
            where = f"row {row + 1}: " if file is None else f"{file.place(row)}: "
            got = units.write(columns[error.column][row], _unit(column))
            raise value_error(
                f"{where}{column.name} {error.rule}, got {got}", error.remedy
            ) from error
        raise value_error(f"{where}{column.name} {error.rule}", error.remedy) from error


@dataclass(frozen=True)
class Tabulated:
    """Annotation that reads a table: the name of a CSV file, or both columns as lists.

    It is written as lists, so that a case that was read needs the file no more.
    """

    parameter: TableParameter

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Read and write with the methods below."""
        return core_schema.with_info_plain_validator_function(
            self._read,
            serialization=core_schema.plain_serializer_function_ser_schema(self.write),
        )

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> Json:
        """Describe both ways."""
        text = f"CSV file with the columns {titles_of(self.parameter)}, in any units of these kinds"
        return {
            "anyOf": [
                {"type": "string", "description": text},
                _lists(self.parameter).model_json_schema(),
            ]
        }

    def _read(self, value: Any, info: ValidationInfo) -> ForceTable:
        if isinstance(value, ForceTable):
            return value
        if isinstance(value, str):
            return table_file(value, self.parameter, info)
        lists = _lists(self.parameter).model_validate(value)
        return _table([getattr(lists, name) for name in _FIELDS], self.parameter)

    def write(self, table: ForceTable) -> dict[str, str]:
        """Return both columns, each in a text with its unit, that read as the same table."""
        columns = zip(self.parameter.columns, (table.strains, table.forces), strict=True)
        return {c.name: f"{', '.join(map(repr, of))} {_unit(c)}".strip() for c, of in columns}


#: Names of the fields of lists, whose keys are those of the columns.
_FIELDS = ("strains", "forces")


@cache
def _lists(parameter: TableParameter) -> type[Section]:
    """Return a model of a table in a case."""
    columns = zip(_FIELDS, parameter.columns, strict=True)
    fields: Any = {
        name: (_numbers(c), Field(alias=c.name, description=c.meaning)) for name, c in columns
    }
    return create_model("Table", __base__=Section, __doc__=parameter.meaning, **fields)


def _numbers(column: Column) -> Any:
    one = Annotated[float, Quantity(unit=_unit(column), least=0)]
    return Annotated[tuple[one, ...], Several()]
