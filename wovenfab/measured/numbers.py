"""Numbers with a decimal point or a decimal comma, perhaps with thousands separators.

A number is read in one of two ways: with a decimal point, so that commas separate thousands, or
with a decimal comma, so that points do. Blanks and apostrophes may separate thousands in both.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import isfinite, nan

POINT, COMMA = ".", ","
#: The names of the decimal signs.
NAMES = {POINT: "point", COMMA: "comma"}
_SAME = str.maketrans(
    {"\u2019": "'", "\u00a0": " ", "\u202f": " ", "\u2009": " ", "\u2007": " ", "\u2212": "-"}
)


def _pattern(decimal: str) -> re.Pattern[str]:
    other = COMMA if decimal == POINT else POINT
    sign = re.escape(decimal)
    grouped = rf"[1-9][0-9]{{0,2}}(?P<by>[' {other}])[0-9]{{3}}(?:(?P=by)[0-9]{{3}})*"
    return re.compile(
        rf"[-+]?(?:{grouped}(?:{sign}[0-9]*)?"
        rf"|(?:[0-9]+(?:{sign}[0-9]*)?|{sign}[0-9]+)(?:[eEdD][-+]?[0-9]+)?)"
    )


_PATTERNS = {decimal: _pattern(decimal) for decimal in NAMES}
_WHOLE = re.compile(r"[-+]?[0-9]+")


def plain(cell: str) -> str:
    """Return a cell without blanks and quotes around it, with one kind of blank and apostrophe."""
    return cell.translate(_SAME).strip().strip("\"'").strip()


def is_number(cell: str) -> bool:
    """Return whether a cell is a number with one of the decimal signs."""
    text = plain(cell)
    return any(pattern.fullmatch(text) for pattern in _PATTERNS.values())


def number(cell: str, decimal: str) -> float:
    """Return the number in a cell with a decimal sign; nan where there is no finite one."""
    text = plain(cell)
    match = _PATTERNS[decimal].fullmatch(text)
    if match is None:
        return nan
    if by := match["by"]:
        text = text.replace(by, "")
    value = float(text.replace(decimal, ".").replace("d", "e").replace("D", "e"))
    return value if isfinite(value) else nan


def thousands(cells: Iterable[str], decimal: str) -> str:
    """Return the sign that separates thousands in some cells; empty if none does."""
    pattern = _PATTERNS[decimal]
    matches = (pattern.fullmatch(plain(cell)) for cell in cells)
    return next((match["by"] for match in matches if match and match["by"]), "")


def decimals(cell: str, decimal: str) -> int:
    """Return how many digits a cell has after the decimal sign."""
    return len(plain(cell).partition(decimal)[2])


@dataclass(frozen=True)
class Evidence:
    """What tells the decimal sign of a table.

    Attributes:
        decimal: The sign; empty where nothing tells, or where signs are mixed.
        needed: For each sign the number (row, cell) that is only read with it.
        either: A number (row, cell) that is read with both signs, as different values; None if
            there is none.
    """

    decimal: str
    needed: dict[str, tuple[int, str]]
    either: tuple[int, str] | None

    @property
    def mixed(self) -> bool:
        """Whether some numbers are only read with one sign, and some only with the other."""
        return len(self.needed) > 1


def evidence(columns: Sequence[Sequence[str]]) -> Evidence:
    """Return what all columns together say of the decimal sign.

    Where no number settles it, such as ``0.36`` and ``12,5`` do, each column must be one that is
    written by one rule: numbers with a trailing zero (``1.580``) beside whole ones (``350``) are
    no decimals, and whole numbers of four digits are not beside thousands.

    Args:
        columns: Cells of each column, from the same rows.
    """
    needed: dict[str, tuple[int, str]] = {}
    either: tuple[int, str] | None = None
    for cells in columns:
        for sign, place in _needed_by(cells).items():
            needed.setdefault(sign, place)
        if either is None:
            either = next(((i, c) for i, c in enumerate(cells) if _either(plain(c))), None)
    if len(needed) == 1:
        return Evidence(next(iter(needed)), needed, either)
    if needed or either is not None:
        return Evidence("", needed, either)
    return Evidence(POINT, needed, either)


def _needed_by(cells: Sequence[str]) -> dict[str, tuple[int, str]]:
    """Return the signs without which a column cannot be read, each with a row and its cell."""
    needed: dict[str, tuple[int, str]] = {}
    unsure: dict[str, list[tuple[int, str]]] = {}
    bare = False
    long = False
    for i, cell in enumerate(cells):
        text = plain(cell)
        if _WHOLE.fullmatch(text):
            digits = text.lstrip("+-")
            bare |= digits.strip("0") != ""
            long |= len(digits) > 3
        elif sign := _either(text):
            unsure.setdefault(sign, []).append((i, text))
        else:
            fitting = [s for s, pattern in _PATTERNS.items() if pattern.fullmatch(text)]
            if len(fitting) == 1:
                needed.setdefault(fitting[0], (i, text))
    for sign, places in unsure.items():
        other = COMMA if sign == POINT else POINT
        zero = next((place for place in places if place[1].endswith("0")), None)
        if bare and zero:
            needed.setdefault(other, zero)
        if long:
            needed.setdefault(sign, places[0])
    return needed


def _either(text: str) -> str:
    """Return the sign in a number that is a decimal sign or separates thousands; else nothing."""
    for sign in NAMES:
        if text.count(sign) == 1 and all(p.fullmatch(text) for p in _PATTERNS.values()):
            return sign
    return ""
