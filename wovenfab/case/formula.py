"""Formulas of x, y and the programs: text to a checked tree, and its value.

Python's parser reads a formula, and only the kinds of nodes of arithmetic are accepted;
nothing is compiled or run. Before that, numbers and their units become placeholders.
A number takes the unit after it, as far as names of units are joined by ``*``, ``/``
or blanks: ``2 N/m * x`` is two newtons per metre times x. ``x``, ``y``, ``program``,
``second_program``, ``pi``, ``and``, ``or`` and a name before a bracket are never units.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from wovenfab.case import units
from wovenfab.case.errors import FormulaError, describe, near_miss

LONGEST, DEEPEST = 500, 20
#: What a formula may depend on, each a length in m.
VARIABLES = ("x", "y", "program", "second_program")
#: Functions by name with the number of their arguments.
FUNCTIONS = {
    **dict.fromkeys(("sqrt", "exp", "log", "sin", "cos", "tan", "tanh", "abs"), 1),
    **dict.fromkeys(("min", "max"), 2),
    "if": 3,
}
_CONSTANTS = {"pi": math.pi}
#: The signs of a formula, each a node of Python's tree; no others are accepted.
_NODES = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.Lt, ast.LtE, ast.Gt, ast.GtE)
_COMPARISONS = ("<", "<=", ">", ">=")
_CONNECTIVES = ("and", "or")
_ALL_SIGNS = ("+", "-", "*", "/", "**", *_COMPARISONS, *_CONNECTIVES)
_SIGNS = dict(zip((*_NODES, ast.And, ast.Or), _ALL_SIGNS, strict=True))
#: Done by Python's own operators, whatever the values are.
_OPERATORS: Mapping[str, Callable[..., Any]] = {
    **{"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv},
    **{"**": operator.pow, "negative": operator.neg},
}


def _absolute(value: Any) -> Any:
    """Return the value or its negative, such that it is differentiable by a complex step."""
    return np.where(np.real(value) < 0, -value, value)


#: The functions, comparisons and connectives for arrays; ``if`` takes a condition and two values.
NUMPY_FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    **{name: getattr(np, name) for name in FUNCTIONS if name not in ("abs", "min", "max", "if")},
    **{"abs": _absolute, "min": np.minimum, "max": np.maximum, "if": np.where},
    **{"<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal},
    **{"and": np.logical_and, "or": np.logical_or},
}
#: Keys that the functions given to :meth:`Expression.evaluate` must have.
REQUIRED_FUNCTIONS = frozenset(NUMPY_FUNCTIONS)

_TOKEN = re.compile(
    r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)"
    r"|(?P<name>[^\W\d]\w*)"
    r"|(?P<sign>\*\*|<=|>=|[-+*/^()<>,])"
)
_UNIT = (
    rf"(?!(?:{'|'.join((*VARIABLES, *_CONSTANTS, *_CONNECTIVES))})\b|\w+\()[^\W\d_][^\W\d]*"
    r"(?:(?:\^|\*\*)-?[0-9](?![\w.])|[0-9](?![\w.])|[²³])?(?!\w)"
)
_UNITS = re.compile(rf"\s*(?P<unit>{_UNIT}(?:(?:\s*(?:\*(?!\*)|/|·)\s*|\s+){_UNIT})*|°|%)")
_NAMED = re.compile(rf"\b(?:{'|'.join((*VARIABLES, *_CONSTANTS))})\b")
_POWERS = ("^", "**")
#: What is written otherwise in Python.
_PYTHON = {"^": "**", "if": "IF"}


@dataclass(frozen=True)
class _Node:
    """A number (with its unit), a variable, or a function or sign with its arguments."""

    kind: str
    text: str = field(compare=False)
    arguments: tuple[_Node, ...] = ()
    value: float = 0.0
    unit: str = ""

    @property
    def variables(self) -> frozenset[str]:
        here = frozenset({self.kind} if self.kind in VARIABLES else ())
        return here.union(*(a.variables for a in self.arguments))


@dataclass(frozen=True)
class Expression:
    """A formula whose value is in ``unit``, checked when it is made.

    Attributes:
        text: As written, such as ``"400 N/m * (1 + x/0.3 m)"``.
        unit: SI unit of the value; empty for a pure number.

    Raises:
        FormulaError: If the text is no formula, or has another dimension.
    """

    text: str
    unit: str

    def __post_init__(self) -> None:
        """Check the text and its dimension."""
        dimension = _dimension(_parse(self.text))
        if dimension is not None and dimension != units.in_si(self.unit)[1]:
            kind = units.kind(self.unit)
            raise FormulaError(f"expected {kind}, but the formula gives {_kind(dimension)}")
        _ = self._tree

    @cached_property
    def _tree(self) -> _Node:
        return _in_si(_parse(self.text))

    @property
    def variables(self) -> frozenset[str]:
        """The variables that the value depends on, of ``VARIABLES``."""
        return self._tree.variables

    @property
    def constant(self) -> float | None:
        """The value if it depends on nothing, else None."""
        return self._tree.value if self._tree.kind == "number" else None

    def evaluate(
        self, variables: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]
    ) -> Any:
        """Return the SI value, by the operators of Python on whatever the variables are.

        Args:
            variables: Values in m of (at least) ``self.variables``.
            functions: What each of ``REQUIRED_FUNCTIONS`` means for such values, like
                ``NUMPY_FUNCTIONS``; ``"if"`` is called with a condition and two values.
        """
        return _evaluate(self._tree, variables, functions)

    def at(self, x: Any, y: Any, program: Any = 0.0, second: Any = 0.0) -> Any:
        """Return the SI value at points (m, arrays) for the programs (m)."""
        variables = dict(zip(VARIABLES, (x, y, program, second), strict=True))
        with np.errstate(all="ignore"):
            return self.evaluate(variables, NUMPY_FUNCTIONS) + np.zeros_like(x)


def is_formula(text: str) -> bool:
    """Return whether a text is meant as a formula, not as a number with a unit or a word."""
    if _NAMED.search(text):
        return True
    if units.is_quantity(text):
        return False
    try:
        _parse(text)
    except FormulaError:
        return "(" in text
    return True


def unit_of_formula(text: str) -> str | None:
    """Return the unit of the value of a formula whose numbers have units.

    Returns:
        That of its first number of the same kind, as written, else SI. None of a pure number, of a
        formula without units, and of what is no formula.
    """
    try:
        given = dict.fromkeys(token.unit for token in tokens_of(text) if token.unit)
        dimension = _dimension(_parse(text)) if given else None
    except FormulaError:
        return None
    if dimension in (None, _CONDITION):
        return None
    kinds = (*given, *units.KINDS, "N")
    same = (kind for kind in kinds if units.in_si(kind)[1] == dimension)
    return next(same, units.SOME_SI) or None


class Token(NamedTuple):
    """A number with its unit, a name, a sign or the end, and where it stands in the text."""

    kind: str
    text: str
    start: int
    end: int
    unit: str = ""


def tokens_of(text: str) -> list[Token]:
    """Return what a formula is written with, and its end."""
    tokens, at = list[Token](), 0
    while (at := at + len(text[at:]) - len(text[at:].lstrip())) < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise FormulaError(f"{describe(text[at])} means nothing in a formula")
        kind, end = str(match.lastgroup), match.end()
        if kind == "name" and match[0] in _CONNECTIVES:
            kind = "sign"
        unit = _UNITS.match(text, end) if kind == "number" else None
        end = unit.end() if unit else end
        tokens.append(Token(kind, match[0], at, end, unit["unit"] if unit else ""))
        at = end
    return [*tokens, Token("end", "", len(text), len(text))]


def _parse(text: str) -> _Node:
    if len(text) > LONGEST:
        raise FormulaError(f"a formula has at most {LONGEST} characters, this has {len(text)}")
    tokens = tokens_of(text)
    _check_syntax(text, tokens)
    python, starts, ends = "", {}, {}
    for token in tokens[:-1]:
        starts[len(python)] = token
        python += "1" if token.kind == "number" else _PYTHON.get(token.text, token.text)
        ends[len(python)] = token.end
        python += " "
    return _tree(ast.parse(python, mode="eval").body, text, starts, ends)


def _check_syntax(text: str, tokens: Sequence[Token]) -> None:
    """Raise what is wrong with the order of tokens, with names and with the depth.

    Values and operators alternate. What passes is an expression of Python.
    """
    closing: list[str] = []  # what may end each open bracket
    depths = [0]  # signs and powers that nest, in all and in each open bracket
    value_next = True
    for before, token, after in zip((None, *tokens), tokens, (*tokens[1:], None), strict=False):
        sign = token.text if token.kind == "sign" else token.kind
        if sign == "(" and (value_next or (before and before.kind == "name")):
            closing.append("')'" if value_next else "',' or ')'")
            depths.append(0)
            value_next = True
        elif value_next and sign in ("+", "-"):
            depths[-1] += 1
        elif value_next:
            if sign not in ("number", "name"):
                raise _unexpected("a value", token)
            if sign == "name":
                _check_name(token.text, after is not None and after.text == "(")
            value_next = False
        elif sign in _POWERS:
            if before and before.unit:
                raise FormulaError(
                    f"it is not clear what the power in '{text[before.start : token.end]}' is of",
                    f"Write '({before.text} {before.unit}){sign}...'.",
                )
            depths[-1] += 1
            value_next = True
        elif sign in _ALL_SIGNS or (sign == "," and closing and "," in closing[-1]):
            depths[-1] = 0
            value_next = True
        elif sign == ")" and closing:
            closing.pop()
            depths.pop()
        elif sign != "end" or closing:
            raise _unexpected(closing[-1] if closing else "an operator", token)
        if len(closing) + sum(depths) > DEEPEST:
            raise FormulaError(f"brackets are nested more than {DEEPEST} deep")


def _check_name(name: str, is_called: bool) -> None:
    if is_called and name not in FUNCTIONS:
        known = f"The functions are {', '.join(FUNCTIONS)}."
        raise FormulaError(f"unknown function '{name}'", near_miss(name, FUNCTIONS) or known)
    if name in FUNCTIONS and not is_called:
        raise FormulaError(f"the function '{name}' needs a bracket", f"Write '{name}(...)'.")
    if name not in (*VARIABLES, *_CONSTANTS, *FUNCTIONS):
        meant = near_miss(name, (*VARIABLES, *_CONSTANTS, *FUNCTIONS))
        about = "A unit follows its number, as in '1 m' or '2 N/m', without brackets."
        raise FormulaError(f"unknown name '{name}'", meant or about)


def _unexpected(expected: str, token: Token) -> FormulaError:
    place = f"{describe(token.text)} at character {token.start + 1}"
    return FormulaError(f"expected {expected}, got {place if token.text else 'the end'}")


def _tree(node: ast.expr, text: str, starts: Mapping[int, Token], ends: Mapping[int, int]) -> _Node:
    """Return the tree of a formula from Python's, with the text of each node as written."""
    inner = partial(_tree, text=text, starts=starts, ends=ends)
    token = starts[node.col_offset]
    written = text[token.start : ends[node.end_col_offset or 0]]
    match node:
        case ast.Constant():
            return _Node("number", written, value=float(token.text), unit=token.unit)
        case ast.Name(id=name) if name in _CONSTANTS:
            return _Node("number", written, value=_CONSTANTS[name])
        case ast.Name(id=name) if name in VARIABLES:
            return _Node(name, written)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return inner(operand)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return _Node("negative", written, (inner(operand),))
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _SIGNS:
            return _Node(_SIGNS[type(op)], written, (inner(left), inner(right)))
        case ast.Compare(left=left, ops=signs, comparators=others):
            pairs: list[tuple[ast.AST, ast.expr]] = list(zip(signs, others, strict=True))
        case ast.BoolOp(op=connective, values=[left, *others]):
            pairs = [(connective, other) for other in others]
        case ast.Call(func=ast.Name(), args=arguments, keywords=[]):
            if len(arguments) != (number := FUNCTIONS[token.text]):
                takes = f"{number} value" if number == 1 else f"{number} values"
                raise FormulaError(f"'{token.text}' takes {takes}, got {len(arguments)}")
            return _Node(token.text, written, tuple(map(inner, arguments)))
        case _:
            raise FormulaError(f"{describe(written)} means nothing in a formula")
    result = inner(left)
    for sign, other in pairs:
        until = node if other is others[-1] else other
        written = text[token.start : ends[until.end_col_offset or 0]]
        result = _Node(_SIGNS[type(sign)], written, (result, inner(other)))
    return result


def _in_si(node: _Node) -> _Node:
    """Return the formula with plain SI numbers only, parts without variables worked out.

    Raises:
        FormulaError: If such a part is infinite or undefined.
    """
    new = replace(node, arguments=tuple(map(_in_si, node.arguments)))
    if node.kind == "/" and node.variables and new.arguments[1] == _Node("number", ""):
        raise FormulaError(f"{describe(node.text)} divides by zero")
    if node.variables or node.kind in (*_COMPARISONS, *_CONNECTIVES):
        return new
    with np.errstate(all="ignore"):
        number = node.kind == "number"
        value = _si_value(node) if number else _evaluate(new, {}, NUMPY_FUNCTIONS, np.float64)
    if not np.isfinite(value):
        raise FormulaError(f"{describe(node.text)} has no finite value")
    return _Node("number", node.text, value=float(value))


def _evaluate(
    node: _Node,
    variables: Mapping[str, Any],
    functions: Mapping[str, Callable[..., Any]],
    number: Callable[[float], Any] = float,
) -> Any:
    if node.kind == "number":
        return number(node.value)
    if node.kind in VARIABLES:
        return variables[node.kind]
    arguments = (_evaluate(a, variables, functions, number) for a in node.arguments)
    return (_OPERATORS.get(node.kind) or functions[node.kind])(*arguments)


def _si_value(number: _Node) -> float:
    try:
        return number.value * (units.in_si(number.unit)[0] if number.unit else 1.0)
    except ValueError as error:
        raise FormulaError(f"got {error}") from error


#: In place of the dimension of a condition, which is true or false.
_CONDITION = object()
_CONDITIONS = "Conditions are as in 'if(0.1 m < x and x < 0.2 m, 400 N/m, 800 N/m)'."
_DIVIDE = "Divide by a unit, as in 'x/1 m'."
_NUMBERS = "Numbers in a formula have their units, as in 'x - 0.3 m'."


def _dimension(node: _Node) -> Any:
    """Return the dimension of a value as pint keeps it; None for a bare 0, which fits all.

    Raises:
        FormulaError: If it adds, compares or raises what cannot be.
    """
    if node.kind == "number":
        _si_value(node)
        return units.in_si(node.unit)[1] if node.value or node.unit else None
    if node.kind in VARIABLES:
        return units.in_si("m")[1]
    inner = list(map(_dimension, node.arguments))
    written = describe(node.text)
    conditions = [d is _CONDITION for d in inner]
    if node.kind in _CONNECTIVES:
        if not all(conditions):
            raise FormulaError(f"{written} joins what are no conditions", _CONDITIONS)
        return _CONDITION
    if node.kind == "if":
        if not conditions[0]:
            raise FormulaError(f"{written} starts with no condition", _CONDITIONS)
        inner, conditions = inner[1:], conditions[1:]
    if any(conditions):
        raise FormulaError(f"{written} uses a condition as a value", _CONDITIONS)
    pure = units.in_si("")[1]
    first = inner[0]
    match node.kind:
        case "<" | "<=" | ">" | ">=" | "+" | "-" | "min" | "max" | "if":
            known = [d for d in inner if d is not None]
            if known and known[0] != known[-1]:
                one, other = map(_kind, known)
                raise FormulaError(f"{written} puts {one} beside {other}", _NUMBERS)
            common = known[0] if known else None
            return _CONDITION if node.kind in _COMPARISONS else common
        case "*":
            return None if None in inner else first * inner[1]
        case "/":
            return None if first is None else first / (inner[1] or pure)
        case "negative" | "abs":
            return first
        case "sqrt":
            return None if first is None else first**0.5
        case "**":
            if inner[1] not in (None, pure):
                raise FormulaError(f"the exponent in {written} is no pure number", _DIVIDE)
            if first in (None, pure):
                return first
            power = _in_si(node.arguments[1])
            if power.kind != "number":
                raise FormulaError(f"the exponent in {written} is not a fixed number", _DIVIDE)
            return first**power.value
    if first not in (None, pure):
        got = f"{_kind(first)} in {written}"
        raise FormulaError(f"'{node.kind}' takes a pure number, got {got}", _DIVIDE)
    return pure


def _kind(dimension: Any) -> str:
    return "a condition" if dimension is _CONDITION else units.kind_of(dimension)
