"""Numbers with a decimal point or a decimal comma, perhaps with thousands separators.

A number is read in one of two ways: with a decimal point, so that commas separate thousands, or
with a decimal comma, so that points do. Blanks and apostrophes may separate thousands in both.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite, nan

POINT, COMMA = ".", ","
#: The names of the decimal signs.
NAMES = {POINT: "point", COMMA: "comma"}
#: How much larger the steps between rows must be, over the range, in the reading that is wrong.
CLEAR = 2.0
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
#: Most numbers: with one sign at most, whatever it means.
_SIMPLE = re.compile(r"[-+]?(?:[0-9]+[.,]?[0-9]*|[.,][0-9]+)(?:[eEdD][-+]?[0-9]+)?")


def plain(cell: str) -> str:
    """Return a cell without blanks and quotes around it, with one kind of blank and apostrophe."""
    text = cell if cell.isascii() else cell.translate(_SAME)
    return text.strip(" \t\f\v\"'")


def is_number(cell: str) -> bool:
    """Return whether a cell, which is plain, is a number with one of the decimal signs."""
    return bool(_SIMPLE.fullmatch(cell)) or any(p.fullmatch(cell) for p in _PATTERNS.values())


def number(cell: str, decimal: str) -> float:
    """Return the number in a plain cell with a decimal sign; nan where there is no finite one."""
    match = _PATTERNS[decimal].fullmatch(cell)
    if match is None:
        return nan
    text = cell.replace(by, "") if (by := match["by"]) else cell
    value = float(text.replace(decimal, ".").replace("d", "e").replace("D", "e"))
    return value if isfinite(value) else nan


def thousands(cells: Iterable[str], decimal: str) -> str:
    """Return the sign that separates thousands in some cells; empty if none does."""
    signs = {" ", "'", COMMA if decimal == POINT else POINT}
    matches = (_PATTERNS[decimal].fullmatch(c) for c in cells if not signs.isdisjoint(c))
    return next((match["by"] for match in matches if match and match["by"]), "")


def decimals(cell: str, decimal: str) -> int:
    """Return how many digits a cell has after the decimal sign."""
    return len(cell.partition(decimal)[2])


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
    no decimals, and whole numbers of four digits are not beside thousands. That reading must also
    be the smoother one.

    Args:
        columns: Cells of each column, from the same rows.
    """
    needed: dict[str, tuple[int, str]] = {}
    either: tuple[int, str] | None = None
    for cells in columns:
        found, unsure = _needed_by(cells)
        for sign, place in found.items():
            needed.setdefault(sign, place)
        either = either or unsure
    if len(needed) == 1:
        return Evidence(next(iter(needed)), needed, either)
    if needed or either is not None:
        return Evidence("", needed, either)
    return Evidence(POINT, needed, either)


def _needed_by(
    cells: Sequence[str],
) -> tuple[dict[str, tuple[int, str]], tuple[int, str] | None]:
    """Return the signs without which a column cannot be read, and a cell that both read.

    Each with its row.
    """
    needed: dict[str, tuple[int, str]] = {}
    unsure: dict[str, list[tuple[int, str]]] = {}
    bare = long = False
    for i, text in enumerate(cells):
        if _WHOLE.fullmatch(text):
            digits = text.lstrip("+-")
            bare = bare or digits.strip("0") != ""
            long = long or len(digits) > 3
        elif sign := _either(text):
            unsure.setdefault(sign, []).append((i, text))
        elif _SIMPLE.fullmatch(text):
            needed.setdefault(POINT if POINT in text else COMMA if COMMA in text else "", (i, text))
        else:
            fitting = [s for s, pattern in _PATTERNS.items() if pattern.fullmatch(text)]
            if len(fitting) == 1:
                needed.setdefault(fitting[0], (i, text))
    needed.pop("", None)  # whole numbers with an exponent
    for sign, places in unsure.items():
        other = COMMA if sign == POINT else POINT
        zero = next((place for place in places if place[1].endswith("0")), None)
        smoother = _roughness(cells, sign) / (_roughness(cells, other) or 1.0)
        if bare and zero and smoother > CLEAR:
            needed.setdefault(other, zero)
        if long and smoother < 1 / CLEAR:
            needed.setdefault(sign, places[0])
    first = min((places[0] for places in unsure.values()), default=None)
    return needed, first


def _roughness(cells: Sequence[str], decimal: str) -> float:
    """Return the largest step between rows over the range of the numbers, with a decimal sign."""
    values = [value for cell in cells if isfinite(value := number(cell, decimal))]
    extent = max(values, default=0.0) - min(values, default=0.0)
    steps = (abs(b - a) for a, b in pairwise(values))
    return max(steps, default=0.0) / extent if extent else 0.0


def _either(text: str) -> str:
    """Return the sign in a number that is a decimal sign or separates thousands; else nothing."""
    sign = text[-4:-3]
    if sign and sign in ".," and all(p.fullmatch(text) for p in _PATTERNS.values()):
        return sign
    return ""
