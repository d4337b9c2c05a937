"""The tree of a formula: numbers, names and what is done with them."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from .problems import describe

#: What a formula may depend on, each a length in m.
VARIABLES = ("x", "y", "program")
#: Functions by name with the number of their arguments.
FUNCTIONS = {
    **dict.fromkeys(("sqrt", "exp", "log", "sin", "cos", "tan", "tanh", "abs"), 1),
    **dict.fromkeys(("min", "max"), 2),
    "if": 3,
}
COMPARISONS = ("<", "<=", ">", ">=")
CONNECTIVES = ("and", "or")
#: Done by Python's own operators, whatever the values are.
OPERATORS: Mapping[str, Callable[..., Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "**": operator.pow,
    "negative": operator.neg,
}
#: Keys that the functions given to :func:`evaluate` must have.
REQUIRED_FUNCTIONS = frozenset((*FUNCTIONS, *COMPARISONS, *CONNECTIVES))
#: These for arrays; ``if`` takes a condition and two values.
NUMPY_FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    **{name: getattr(np, name) for name in FUNCTIONS if name not in ("min", "max", "if")},
    "min": np.minimum,
    "max": np.maximum,
    "if": np.where,
    "<": np.less,
    "<=": np.less_equal,
    ">": np.greater,
    ">=": np.greater_equal,
    "and": np.logical_and,
    "or": np.logical_or,
}


class FormulaError(ValueError):
    """A text that is no formula, or one that makes no sense.

    Attributes:
        remedy: What would be right, in full sentences; may be empty.
    """

    def __init__(self, message: str, remedy: str = "") -> None:
        """Keep both."""
        super().__init__(message)
        self.remedy = remedy


@dataclass(frozen=True)
class Number:
    """A number in ``unit``, which is empty for a pure number."""

    text: str = field(compare=False)
    value: float
    unit: str = ""


@dataclass(frozen=True)
class Name:
    """One of ``VARIABLES``."""

    text: str


@dataclass(frozen=True)
class Call:
    """A function, comparison, connective or operator with its arguments."""

    text: str = field(compare=False)
    function: str
    arguments: tuple[Node, ...]


#: Each has the ``text`` it was read from, for messages.
Node = Number | Name | Call


def names_in(node: Node) -> frozenset[str]:
    """Return the variables that a formula depends on."""
    match node:
        case Name(name):
            return frozenset({name})
        case Call(arguments=arguments):
            return frozenset().union(*map(names_in, arguments))
    return frozenset()


def in_si(node: Node, to_si: Callable[[Number], float]) -> Node:
    """Return the formula with plain SI numbers only, parts without variables worked out.

    Args:
        node: The formula.
        to_si: Gives the SI value of a number with a unit.

    Raises:
        FormulaError: If such a part is infinite or undefined.
    """
    match node:
        case Name():
            return node
        case Number():
            return _finite(node.text, to_si(node))
        case Call():
            new = Call(node.text, node.function, tuple(in_si(a, to_si) for a in node.arguments))
    if not names_in(new) and is_value(new):
        with np.errstate(all="ignore"):
            return _finite(new.text, float(evaluate(new, {}, NUMPY_FUNCTIONS, np.float64)))
    if new.function == "/" and new.arguments[1] == Number("", 0.0):
        raise FormulaError(f"{describe(new.text)} divides by zero")
    return new


def is_value(node: Node) -> bool:
    """Return whether a formula gives a number, not a condition."""
    return not (isinstance(node, Call) and node.function in (*COMPARISONS, *CONNECTIVES))


def evaluate(
    node: Node,
    variables: Mapping[str, Any],
    functions: Mapping[str, Callable[..., Any]],
    number: Callable[[float], Any] = float,
) -> Any:
    """Return the value of a formula, units left aside.

    Args:
        node: The formula.
        variables: Values by name.
        functions: What the names of ``REQUIRED_FUNCTIONS`` mean for these values.
        number: Makes a value of a constant.
    """
    match node:
        case Number(value=value):
            return number(value)
        case Name(name):
            return variables[name]
        case Call(function=function, arguments=arguments):
            inner = partial(evaluate, variables=variables, functions=functions, number=number)
            return (OPERATORS.get(function) or functions[function])(*map(inner, arguments))


def _finite(text: str, value: float) -> Number:
    if not np.isfinite(value):
        raise FormulaError(f"{describe(text)} has no finite value")
    return Number(text, value)
