"""What a user says of a measured file where its header does not tell."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from wovenfab.case.errors import CaseError, case_error
from wovenfab.measured.numbers import NAMES

_ROWS = re.compile(r"\s*(?P<first>[0-9]{0,9})\s*(?P<dash>-)?\s*(?P<last>[0-9]{0,9})\s*")


@dataclass(frozen=True)
class Layout:
    """Columns, units, rows, decimal sign and sheet of a file; what is not said is found out.

    Attributes:
        columns: Names or numbers (from 1) of columns by quantity, such as ``{"force": "Kraft"}``.
        units: Units by quantity, perhaps with a number: with ``-1 N`` signs are reversed, with
            ``2.3 mm`` one in the file is 2.3 mm.
        rows: First and last line of the file that may hold numbers, from 1; None for all.
        decimal: Decimal sign, point or comma; empty if the numbers tell.
        sheet: Name of a sheet of a workbook; empty for that with the longest table.
    """

    columns: Mapping[str, str | int] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    rows: tuple[int, int] | None = None
    decimal: str = ""
    sheet: str = ""


#: Nothing is said.
EMPTY = Layout()


def rows_of(text: str) -> tuple[int, int]:
    """Return first and last line that a text such as ``12-340``, ``12-`` or ``-340`` names.

    Raises:
        ValueError: It is something else.
    """
    match = _ROWS.fullmatch(text)
    if not match or not (match["first"] or match["last"]):
        raise ValueError(text)
    first = int(match["first"] or 1)
    last = int(match["last"] or (10**9 if match["dash"] else first))
    if not 1 <= first <= last:
        raise ValueError(text)
    return first, last


def layout_of_options(
    columns: Sequence[str],
    units: Sequence[str],
    rows: str | None,
    decimal: str | None,
    sheet: str | None,
    quantities: Iterable[str],
) -> Layout:
    """Return the layout that options of the command line give.

    Args:
        columns: Texts such as ``force=Kraft`` or ``displacement=1,force=3``.
        units: Texts such as ``force=kN``.
        rows: As for :func:`rows_of`.
        decimal: ``point`` or ``comma``, or the sign itself.
        sheet: Name of a sheet.
        quantities: Those that there are.

    Raises:
        CaseError: With the option and a remedy.
    """
    named = _pairs("--columns", columns, quantities)
    signs = {name: sign for sign, name in NAMES.items()} | {sign: sign for sign in NAMES}
    if decimal is not None and decimal.strip() not in signs:
        raise case_error("--decimal", f"expected point or comma, got {decimal!r}")
    try:
        lines = None if rows is None else rows_of(rows)
    except ValueError:
        raise bad_rows("--rows", rows) from None
    return Layout(
        {k: int(v) if v.isdecimal() and v.isascii() and len(v) < 10 else v for k, v in named},
        dict(_pairs("--units", units, quantities)),
        lines,
        "" if decimal is None else signs[decimal.strip()],
        sheet or "",
    )


def bad_rows(option: str, given: object) -> CaseError:
    """Return the error of lines that are none."""
    return case_error(
        option,
        f"expected the first and last line with numbers, got {given!r}",
        "For example 12-340, 12- or -340, counted from 1 as an editor does.",
    )


def _pairs(option: str, texts: Sequence[str], names: Iterable[str]) -> list[tuple[str, str]]:
    known = tuple(names)
    pairs = []
    for text in texts:
        for part in re.split(r",\s*(?=\w+\s*=)", text):
            name, sign, value = (piece.strip() for piece in part.partition("="))
            if name not in known or not sign or not value:
                example = f"{option} {known[-1]}={'kN' if option == '--units' else '2'}"
                remedy = f"For example {example}; what may be named is {', '.join(known)}."
                raise case_error(option, f"expected NAME=VALUE, got {part!r}", remedy)
            pairs.append((name, value))
    return pairs
