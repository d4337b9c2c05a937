"""Numbers with units in lists: one rule in case files, on the command line and in Python."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from wovenfab.case import units
from wovenfab.case.formula import Expression, unit_of_formula


def numbers_of(text: str) -> list[str] | None:
    """Return the numbers of a text such as ``"20, 40 mm"``; None if it is no such list.

    A unit that only the last number has serves for all. A comma without a blank after it is no
    separator, since ``"0,5 mm"`` is meant as one number.
    """
    parts = re.split(r",\s+", text.strip())
    return with_last_unit(parts) if len(parts) > 1 and all(map(units.is_quantity, parts)) else None


def with_last_unit(values: Sequence[Any]) -> list[Any]:
    """Return values in which the unit that only the last number has serves for all.

    A formula has the units of its own numbers, which serve for no other.
    """
    found = list(map(_unit_of, values))
    if not found or not (last := found[-1]) or any(found[:-1]):
        return list(values)
    if not units.is_quantity(_text(values[-1])):
        return list(values)
    return [f"{v} {last}" if unit == "" else v for v, unit in zip(values, found, strict=True)]


def mixed(values: Sequence[Any]) -> tuple[str, str] | None:
    """Return what is wrong with a list in which some values have units and others have none.

    A number without one could be in the SI unit, as elsewhere, or in the unit of the others, which
    are numbers or formulas. Only zero is the same in all.

    Returns:
        Message, and remedy with both readings; None of a list in which nothing is wrong.
    """
    found = list(map(_unit_of, values))
    given = [unit for unit in found if unit]
    bare = [v for v, unit in zip(values, found, strict=True) if unit == "" and float(v)]
    if not given or not bare:
        return None
    readings = dict.fromkeys(_reading(values, unit) for unit in (given[-1], _si_of(given[-1])))
    meant = f"{' or '.join(readings)}{', whichever is meant' if len(readings) > 1 else ''}"
    return (
        f"{bare[0]} has no unit, but others have one",
        f"Write {meant}: in a list each number has its own unit. A text such as '20, 40 mm' has "
        "one unit for all.",
    )


def _text(value: Any) -> str:
    """Return a number or a formula as text; empty for another value."""
    if isinstance(value, Expression):
        return value.text
    return str(value) if isinstance(value, int | float | str) else ""


def _unit_of(value: Any) -> str | None:
    """Return the unit of a number, empty if it has none, or of a formula; None of what has none."""
    text = _text(value)
    return units.unit_of(text) if units.is_quantity(text) else unit_of_formula(text)


def _reading(values: Sequence[Any], unit: str) -> str:
    """Return a list as it reads if numbers without unit are in this one; empty for pure numbers."""

    def read(value: Any) -> str:
        if _unit_of(value) != "" or not float(value):
            return _text(value)
        return f"{value} {unit}" if unit else f"{100 * float(value):g} %"

    return f"[{', '.join(map(read, values))}]"


def _si_of(unit: str) -> str:
    """Return the SI unit of the same kind."""
    found = (kind for kind in units.KINDS if units.measures(f"1 {unit}", kind))
    return next(found, units.SOME_SI)
