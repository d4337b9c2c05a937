"""Numbers with units: text such as ``"40 mm"`` to SI floats and back."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np

from wovenfab.case.errors import describe

#: What a unit measures, with an example, for messages and the schema.
KINDS = {
    "": ("a plain number", "0.5"),
    "rad": ("an angle", "45 deg"),
    "m": ("a length", "40 mm"),
    "s": ("a time", "2 s"),
    "m/s": ("a velocity", "0.5 m/s"),
    "Hz": ("a frequency", "2 Hz"),
    "N": ("a force", "10 N"),
    "N/m": ("a force per length", "400 N/m"),
    "N/m^2": ("a force per area", "199.2 kN/m^2"),
    "N/m^3": ("a force per volume", "6e7 N/m^3"),
    "N*m": ("a bending stiffness", "254.1 N*m"),
    "s/m": ("a time per length", "70 s/m"),
}

#: Everyday units, and how many of an SI unit they are: to load pint, which knows all units, takes
#: longer than to read a case. Tests compare them with pint.
EVERYDAY = {
    "mm": ("m", 1e-3),
    "cm": ("m", 1e-2),
    "deg": ("rad", math.pi / 180),
    "ms": ("s", 1e-3),
    "min": ("s", 60.0),
    "mm/s": ("m/s", 1e-3),
    "mm/min": ("m/s", 1e-3 / 60),
    "kN": ("N", 1e3),
    "N/mm": ("N/m", 1e3),
    "kN/m": ("N/m", 1e3),
    "kN/m^2": ("N/m^2", 1e3),
}
#: SI units of different kinds.
_DIFFERENT = {unit for unit, _ in EVERYDAY.values()}

#: In place of an SI unit that is none of :data:`KINDS`, in messages.
SOME_SI = "(in SI units)"

#: More characters than this are no number with a unit.
LONGEST = 80

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
# Single-digit powers only: pint computes powers, and 9^9^9^9 takes for ever.
_FACTOR = r"\(*[^\W\d_][^\W\d]*(?:(?:\^|\*\*)?-?\d|[²³])?\)*"
_UNIT = rf"(?:1\s*/\s*)?{_FACTOR}(?:(?:\s*[*/·.]\s*|\s+){_FACTOR})*|°|%"
# The unit of a parameter of an effect may also have a power such as m^1.5.
_WITH_POWERS = re.compile(_UNIT.replace(r"-?\d", r"-?\d(?:\.\d+)?"))
_QUANTITY = re.compile(rf"\s*(?P<number>{_NUMBER})\s*(?P<unit>{_UNIT})?\s*")
_BARE_POWER = re.compile(r"(?<=[^\W\d_])(?=-?\d)")
_DOT = re.compile(r"\.(?!\d)")  # a product, which not every pint reads

#: The same as a pattern for editors, which know no named groups.
PATTERN = rf"^\s*{_NUMBER}(\s*\S.*)?$"


def kind(unit: str) -> str:
    """Return in words what is expected in ``unit``, with an example."""
    name, example = KINDS.get(unit, (f"a value in {unit}", f"1 {unit}"))
    return f"{name} such as '{example}'" if unit else f"{name} such as {example}"


def parse(text: str, unit: str) -> float:
    """Return the SI value of a number with or without a unit.

    Args:
        text: ``"40 mm"``, ``"1e-3"``, ``"5 %"``.
        unit: The SI unit that is expected, as in ``wovenfab.forms.effect.Parameter``;
            empty for a pure number.

    Returns:
        The value in ``unit``; a number without unit is taken to be in it.

    Raises:
        ValueError: With what the text has got instead: ``"the unknown unit 'x'"``.
    """
    match = _QUANTITY.fullmatch(text) if len(text) <= LONGEST else None
    if match is None:
        raise ValueError(describe(text))
    value = float(match["number"]) * (_factor(match["unit"], unit) if match["unit"] else 1.0)
    if not math.isfinite(value):
        raise ValueError(f"{text!r}, which is too large")
    return value


def parse_in(value: float | str, unit: float) -> float:
    """Return a number as it is, a length in a unit of so many metres, or an angle in rad.

    Raises:
        ValueError: As from :func:`parse`.
    """
    if not isinstance(value, str):
        return value
    for kind, size in (("", 1.0), ("m", unit), ("rad", 1.0)):
        with suppress(ValueError):
            return parse(value, kind) / size
    raise ValueError(describe(value))


def measures(text: str, unit: str) -> bool:
    """Return whether a text is a number with a unit of the same kind as ``unit``."""
    match = _QUANTITY.fullmatch(text) if len(text) <= LONGEST else None
    try:
        return bool(match and match["unit"] and _factor(match["unit"], unit))
    except ValueError:
        return False


def write(value: float, unit: str) -> str | float:
    """Return ``value`` with its unit, so that :func:`parse` gives the same float."""
    short = f"{value:g}"
    return f"{short if float(short) == value else repr(value)} {unit}" if unit else value


def in_si(unit: str) -> tuple[float, Any]:
    """Return how many SI units a unit is, and its dimension, as pint keeps it.

    Angles and ``%`` have the dimension of a pure number, which is that of ``""``.

    Raises:
        ValueError: The unit is unknown, or does not start at zero (``degC``, ``dB``).
    """
    if unit == "%":
        return 0.01, _registry().dimensionless.dimensionality
    try:
        factor, base = _in_base_units(unit)
        zero = _registry().Quantity(0.0, _parsed(unit)).to_base_units().magnitude
    except Exception as error:  # pint passes on whatever its tokenizer raises
        raise ValueError(f"the unknown unit {unit!r}") from error
    if zero:
        raise ValueError(f"{unit!r}, which does not start at zero")
    return factor, base.dimensionality


def quantity(value: float, unit: str) -> Any:
    """Return a number with a unit as a quantity of pint in SI units; empty for a pure number.

    Raises:
        ValueError: As from :func:`in_si`.
    """
    factor, _ = in_si(unit)
    base = _registry().dimensionless if unit == "%" else _in_base_units(unit)[1]
    return _registry().Quantity(np.float64(value * factor), base)


def kind_of(dimension: Any) -> str:
    """Return in words what a dimension is: ``"a length"``."""
    names = {unit: name for unit, (name, _) in KINDS.items()} | {"m^2": "an area"}
    for unit, name in names.items():
        if in_si(unit)[1] == dimension:
            return name
    base = {"[length]": "m", "[mass]": "kg", "[time]": "s", "[temperature]": "K"}
    powers = (f"{base.get(of, of)}^{power:g}" for of, power in dimension.items())
    return f"a value in {'*'.join(powers)}".replace("^1", "")


def is_quantity(text: str) -> bool:
    """Return whether a text is a number, perhaps with a unit, that may not be known."""
    return len(text) <= LONGEST and _QUANTITY.fullmatch(text) is not None


def unit_of(text: str) -> str:
    """Return the unit of a text that :func:`is_quantity`, as written; empty if it has none."""
    match = _QUANTITY.fullmatch(text)
    return (match["unit"] or "") if match else ""


def _factor(given: str, unit: str) -> float:
    """Return how many ``unit`` one ``given`` is."""
    if given == unit:
        return 1.0
    known, factor = EVERYDAY.get(given, (given, 1.0))
    if known == unit:
        return factor
    if {known, unit} <= _DIFFERENT:
        raise ValueError(repr(given))
    if not unit:
        if given == "%":
            return 0.01
        raise ValueError(repr(given))
    try:
        factor, base = _in_base_units(given)
    except Exception as error:  # pint passes on whatever its tokenizer raises
        raise ValueError(f"the unknown unit {given!r}") from error
    own_factor, own_base = _in_base_units(unit)
    if base != own_base and not _is_per_angle(base, own_base):
        raise ValueError(repr(given))
    return factor / own_factor


def _is_per_angle(given: Any, own: Any) -> bool:
    """Return whether a unit is a stiffness per angle, as laboratories state it: N/m per rad."""
    return "[mass]" in own.dimensionality and given * _registry().radian == own


def _in_base_units(unit: str) -> tuple[float, Any]:
    factor, base = _registry().get_base_units(_parsed(unit))
    return float(factor), base


def _parsed(unit: str) -> Any:
    if unit and (len(unit) > LONGEST or not _WITH_POWERS.fullmatch(unit)):
        raise ValueError(unit)
    return _registry().parse_units(_DOT.sub("*", _BARE_POWER.sub("^", unit)))


@cache
def _registry() -> Any:
    import pint  # half a second, which a case in everyday units need not pay

    return pint.UnitRegistry()
