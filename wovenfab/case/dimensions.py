"""Whether the units in a formula fit together, and what it measures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from . import units
from .formula import COMPARISONS, CONNECTIVES, Call, FormulaError, Name, Node, Number, in_si
from .problems import describe

#: A dimension as pint keeps it; None is that of a bare 0, which fits all others.
Dimension = Any
#: In place of the dimension of a condition, which is true or false.
CONDITION: Dimension = object()


def si_value(number: Number) -> float:
    """Return the value of a number in SI units.

    Raises:
        FormulaError: If its unit is unknown.
    """
    try:
        return number.value * (units.in_si(number.unit)[0] if number.unit else 1.0)
    except ValueError as error:
        raise FormulaError(f"got {error}") from error


def dimension_of(node: Node) -> Dimension:
    """Return the dimension of a formula's value.

    Raises:
        FormulaError: If it adds, compares or raises what cannot be.
    """
    match node:
        case Number(value=value, unit=unit):
            si_value(node)
            return units.in_si(unit)[1] if value or unit else None
        case Name():
            return units.in_si("m")[1]
        case Call(function=function, arguments=arguments):
            inner = [dimension_of(argument) for argument in arguments]
            return _of_call(node, function, inner)


def in_words(dimension: Dimension) -> str:
    """Return what a dimension is: ``"a length"``."""
    return "a condition" if dimension is CONDITION else units.kind_of(dimension)


def _of_call(node: Call, function: str, inner: Sequence[Dimension]) -> Dimension:
    conditions = [d is CONDITION for d in inner]
    if function in CONNECTIVES:
        if not all(conditions):
            raise FormulaError(f"{describe(node.text)} joins what are no conditions", _CONDITIONS)
        return CONDITION
    if function == "if":
        if not conditions[0]:
            raise FormulaError(f"{describe(node.text)} starts with no condition", _CONDITIONS)
        inner, conditions = inner[1:], conditions[1:]
    if any(conditions):
        raise FormulaError(f"{describe(node.text)} uses a condition as a value", _CONDITIONS)
    if function in COMPARISONS:
        _common(node, inner)
        return CONDITION
    match function:
        case "+" | "-" | "min" | "max" | "if":
            return _common(node, inner)
        case "*":
            return None if inner[0] is None or inner[1] is None else inner[0] * inner[1]
        case "/":
            return None if inner[0] is None else inner[0] / (inner[1] or _pure())
        case "negative" | "abs":
            return inner[0]
        case "sqrt":
            return None if inner[0] is None else inner[0] ** 0.5
        case "**":
            return _of_power(node, *inner)
    if not _is_pure(inner[0]):
        got = f"{in_words(inner[0])} in {describe(node.text)}"
        raise FormulaError(f"'{function}' takes a pure number, got {got}", _DIVIDE)
    return _pure()


_CONDITIONS = "Conditions are as in 'if(0.1 m < x and x < 0.2 m, 400 N/m, 800 N/m)'."
_DIVIDE = "Divide by a unit, as in 'x/1 m'."
_NUMBERS = "Numbers in a formula have their units, as in 'x - 0.3 m'."


def _pure() -> Dimension:
    return units.in_si("")[1]


def _is_pure(dimension: Dimension) -> bool:
    return dimension is None or bool(dimension == _pure())


def _common(node: Call, inner: Sequence[Dimension]) -> Dimension:
    known = [d for d in inner if d is not None]
    if known and known[0] != known[-1]:
        first, second = map(in_words, known)
        raise FormulaError(f"{describe(node.text)} puts {first} beside {second}", _NUMBERS)
    return known[0] if known else None


def _of_power(node: Call, base: Dimension, exponent: Dimension) -> Dimension:
    if not _is_pure(exponent):
        raise FormulaError(f"the exponent in {describe(node.text)} is no pure number", _DIVIDE)
    if _is_pure(base):
        return base
    power = in_si(node.arguments[1], si_value)
    if not isinstance(power, Number):
        raise FormulaError(f"the exponent in {describe(node.text)} is not a fixed number", _DIVIDE)
    return base**power.value
