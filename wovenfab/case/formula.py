"""Formulas of x, y, the programs and the shear angle: text to a checked tree, and its value.

A number takes the unit after it, as far as names of units are joined by ``*``, ``/`` or blanks:
``2 N/m * x`` is two newtons per metre times x. ``x``, ``y``, ``program``, ``second_program``,
``gamma``, ``pi``, ``and``, ``or`` and a name before a bracket are never units. With a name in place
of each number the text is one of Python, whose parser makes a tree of it. Only nodes of arithmetic
are accepted, and nothing is compiled or run: the tree is evaluated with quantities of pint, which
raises what does not fit together, with arrays, or with expressions of UFL.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Any, NamedTuple

import numpy as np

from wovenfab.case import units
from wovenfab.case.errors import FormulaError, describe, near_miss

#: Characters, and nodes of the tree one below the other: a sum of 250 values has as many.
LONGEST, DEEPEST = 500, 300
#: What formulas may depend on: places and displacements in m, and the shear angle in rad.
LENGTHS = ("x", "y", "program", "second_program")
SHEAR_ANGLE = "gamma"
VARIABLES = (*LENGTHS, SHEAR_ANGLE)
#: Functions by name with the number of their arguments.
FUNCTIONS = {
    **dict.fromkeys(("sqrt", "exp", "log", "sin", "cos", "tan", "tanh", "abs"), 1),
    **dict.fromkeys(("min", "max"), 2),
    "if": 3,
}
_CONSTANTS = {"pi": math.pi}
_CONNECTIVES: Mapping[type[ast.AST], str] = {ast.And: "and", ast.Or: "or"}
_COMPARISONS: Mapping[type[ast.AST], str] = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="}
_SIGNS: Mapping[type[ast.AST], str] = {
    **{ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"},
    **{ast.USub: "negative", ast.UAdd: "positive"},
}
#: Done by Python's own operators, whatever the values are.
_OPERATORS: Mapping[str, Callable[..., Any]] = {
    **{"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv},
    **{"**": operator.pow, "negative": operator.neg, "positive": lambda value: value},
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
#: The same for quantities of pint, which numpy's functions take, too; not in arrays, though.
_PINT_FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    **_OPERATORS,
    **NUMPY_FUNCTIONS,
    "abs": abs,
    "if": lambda condition, one, other: np.where(condition, one, other)[()],
}

_UNIT = (
    rf"(?!(?:{'|'.join((*VARIABLES, *_CONSTANTS, *_CONNECTIVES.values()))})\b|\w+\()"
    r"[^\W\d_][^\W\d]*(?:(?:\^|\*\*)-?[0-9](?![\w.])|[0-9](?![\w.])|[²³])?(?!\w)"
)
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)"
    rf"(?:\s*(?P<unit>{_UNIT}(?:(?:\s*(?:\*(?!\*)|/|·)\s*|\s+){_UNIT})*|°|%)"
    r"(?P<power>\s*(?:\^|\*\*))?)?"
    r"|(?P<word>[a-zA-Z][a-zA-Z0-9_]*|\*\*|<=|>=|[-+*/^()<>,])|(?P<end>$)|(?P<other>.))",
    re.DOTALL,
)
_NAMED = re.compile(rf"\b(?:{'|'.join((*VARIABLES, *_CONSTANTS))})\b")
#: What is written otherwise in Python. No word of a formula starts with ``_``.
_PYTHON = {"^": "**", "if": "_if"}

_SYNTAX = "A formula is written like '400 N/m * (1 + x/0.3 m)'."
_CONDITION = "Conditions are as in 'if(0.1 m < x and x < 0.2 m, 400 N/m, 800 N/m)'."
_MEASURE = "Numbers have their units, as in 'x - 0.3 m'; others are divided by one, as in 'x/1 m'."


class Number(NamedTuple):
    """A number of a formula, its unit as written (empty if it has none), and where both stand."""

    value: float
    unit: str
    start: int
    end: int


@dataclass(frozen=True, eq=False)
class _Formula:
    """The tree of a text, of which all nodes are known.

    Attributes:
        text: As written.
        tree: Python's, with the names ``_1``, ``_2`` ... in place of the numbers.
        numbers: Those by their names, in order.
        starts: Where in the text a word of the tree starts, by its column.
        ends: Where it ends, by the column of its end.
    """

    text: str
    tree: ast.expr
    numbers: Mapping[str, Number]
    starts: Mapping[int, int]
    ends: Mapping[int, int]

    def written(self, node: ast.expr) -> str:
        """Return a part of the formula for a message."""
        return describe(
            self.text[self.starts[node.col_offset] : self.ends[node.end_col_offset or 0]]
        )

    def walk(
        self,
        leaf: Callable[[ast.expr], Any],
        inner: Callable[[ast.expr, str, Sequence[Any]], Any],
        node: ast.expr | None = None,
        depth: int = 1,
    ) -> Any:
        """Return the value of a tree, from its leaves up.

        Args:
            leaf: What a node is worth by itself; None if its parts are needed.
            inner: Called with another node, its sign or function, and the values of its parts.
            node: The root of the tree; that of the whole formula if None.
            depth: Nodes from the root of the whole formula to this one.
        """
        node = node or self.tree
        if depth > DEEPEST:
            raise FormulaError("the formula is nested too deeply")
        if (value := leaf(node)) is not None:
            return value
        sign, parts = self.parts(node)
        return inner(node, sign, [self.walk(leaf, inner, part, depth + 1) for part in parts])

    def parts(self, node: ast.expr) -> tuple[str, Sequence[ast.expr]]:
        """Return the sign or function of a node and what it joins; the list of all that is known.

        Raises:
            FormulaError: It is another node of Python.
        """
        match node:
            case ast.Name(id=name):
                self._require_name(name)
                return name, ()
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _SIGNS:
                return _SIGNS[type(op)], (operand,)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _SIGNS:
                return _SIGNS[type(op)], (left, right)
            case ast.Compare(left=left, ops=[op], comparators=[right]) if type(op) in _COMPARISONS:
                return _COMPARISONS[type(op)], (left, right)
            case ast.Compare(ops=[_, _, *_]):
                raise FormulaError(f"{self.written(node)} compares more than two", _CONDITION)
            case ast.BoolOp(op=op, values=values):
                return _CONNECTIVES[type(op)], values
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if (
                name not in self.numbers
            ):
                name = name.removeprefix("_")
                if name not in FUNCTIONS:
                    known = f"The functions are {', '.join(FUNCTIONS)}."
                    meant = near_miss(name, FUNCTIONS)
                    raise FormulaError(f"unknown function '{name}'", meant or known)
                if len(arguments) != (number := FUNCTIONS[name]):
                    takes = f"{number} value" if number == 1 else f"{number} values"
                    raise FormulaError(f"'{name}' takes {takes}, got {len(arguments)}")
                return name, arguments
        raise FormulaError(f"{self.written(node)} means nothing in a formula", _SYNTAX)

    def _require_name(self, name: str) -> None:
        known = (*VARIABLES, *_CONSTANTS, *FUNCTIONS)
        if (name := _word(name)) in FUNCTIONS:
            raise FormulaError(f"the function '{name}' needs a bracket", f"Write '{name}(...)'.")
        if name not in known and name not in self.numbers:
            about = "A unit follows its number, as in '1 m' or '2 N/m', without brackets."
            raise FormulaError(f"unknown name '{name}'", near_miss(name, known) or about)

    def measured(self, varied: str = "") -> tuple[Any, dict[ast.expr, float]]:
        """Return the value where all variables are 1, a quantity of pint, and constant parts in SI.

        A zero that has no unit fits all: it is not of pint, and neither is a product with it.

        Args:
            varied: Name of a number that is not constant.

        Raises:
            FormulaError: Values are joined that do not fit together, or a part is not finite.
        """
        constants: dict[ast.expr, float] = {}

        def leaf(node: ast.expr) -> Any:
            if not isinstance(node, ast.Name):
                return None
            if node.id in VARIABLES:
                return units.quantity(1.0, "m" if node.id in LENGTHS else "")
            value, unit, *_ = self.numbers.get(node.id, (_CONSTANTS.get(node.id, 0.0), ""))
            fits_all = not value and not unit and node.id != varied
            try:
                found = np.float64(0.0) if fits_all else units.quantity(value, unit)
            except ValueError as error:
                raise FormulaError(f"got {error}") from error
            return keep(node, found)

        def inner(node: ast.expr, sign: str, values: Sequence[Any]) -> Any:
            _, parts = self.parts(node)
            for i, (part, value) in enumerate(zip(parts, values, strict=True)):
                require(part, value, sign in _CONNECTIVES.values() or (sign == "if" and i == 0))
            last = parts[-1]
            if sign == "/" and last in constants and not constants[last]:
                raise FormulaError(f"{self.written(node)} divides by zero")
            if sign == "**" and last not in constants and not _is_pure(values[0]):
                what = f"the exponent in {self.written(node)} is not a fixed number"
                raise FormulaError(what, _MEASURE)
            if any(map(_fits_all, {"*": values, "/": values[:1]}.get(sign, ()))):
                return keep(node, np.float64(0.0))
            try:
                value = _joined(_PINT_FUNCTIONS[sign], sign, values)
            except TypeError as error:  # pint's error of dimensions is one
                kinds = (units.kind_of(_dimension(v)) for v in values if not _is_condition(v))
                what = f"{self.written(node)} cannot take {' and '.join(kinds)}"
                raise FormulaError(what, _MEASURE) from error
            return keep(node, value)

        def require(node: ast.expr, value: Any, condition: bool) -> None:
            if _is_condition(value) != condition:
                what = "no condition" if condition else "a condition, and no value"
                raise FormulaError(f"{self.written(node)} is {what}", _CONDITION)

        def keep(node: ast.expr, value: Any) -> Any:
            if _is_condition(value):
                return value
            if isinstance(value, float) and not _fits_all(value):
                value = units.quantity(value, "")
            names = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
            if not names & {*VARIABLES, varied}:
                constants[node] = float(getattr(value, "magnitude", value))
                if not math.isfinite(constants[node]):
                    raise FormulaError(f"{self.written(node)} has no finite value")
            return value

        with np.errstate(all="ignore"):
            value = self.walk(leaf, inner)
        require(self.tree, value, False)
        return value, constants


def _joined(function: Callable[..., Any], sign: str, values: Sequence[Any]) -> Any:
    return reduce(function, values) if sign in _CONNECTIVES.values() else function(*values)


def _is_condition(value: Any) -> bool:
    return isinstance(value, bool | np.bool_)


def _fits_all(value: Any) -> bool:
    return isinstance(value, float) and value == 0


def _dimension(value: Any) -> Any:
    return getattr(value, "dimensionality", units.in_si("")[1])


def _is_pure(value: Any) -> bool:
    return bool(_dimension(value) == units.in_si("")[1])


def _word(name: str) -> str:
    """Return a name of the tree as it is written."""
    return next((word for word, python in _PYTHON.items() if python == name), name)


def _parse(text: str) -> _Formula:
    if len(text) > LONGEST:
        raise FormulaError(f"a formula has at most {LONGEST} characters, this has {len(text)}")
    python, numbers = "", dict[str, Number]()
    starts, ends = dict[int, int](), dict[int, int]()
    for token in _TOKEN.finditer(text):
        kind = token.lastgroup
        if kind == "end":
            break
        start, end = token.end() - len(token[0].lstrip()), token.end()
        if kind == "other":
            raise FormulaError(f"{describe(token['other'])} means nothing in a formula", _SYNTAX)
        if kind == "power":
            what = f"it is not clear what the power in '{text[start:end]}' is of"
            sign = token["power"].strip()
            raise FormulaError(what, f"Write '({token['number']} {token['unit']}){sign}...'.")
        word = token["word"]
        if word is None:
            word = f"_{len(numbers) + 1}"
            numbers[word] = Number(float(token["number"]), token["unit"] or "", start, end)
        starts[len(python)] = start
        python += _PYTHON.get(word, word)
        ends[len(python)] = end
        python += " "
    try:
        tree = ast.parse(python, mode="eval").body
    except SyntaxError as error:
        at = starts.get((error.offset or 0) - 1, len(text))
        found = f"{describe(text[at:])} at character {at + 1}" if text[at:].strip() else "its end"
        raise FormulaError(f"it cannot be read from {found} on: {error.msg}", _SYNTAX) from error
    formula = _Formula(text, tree, numbers, starts, ends)
    formula.walk(lambda _: None, lambda *_: True)  # raises what is not known
    return formula


@dataclass(frozen=True)
class Expression:
    """A formula whose value is in ``unit``, checked when it is made.

    Attributes:
        text: As written, such as ``"400 N/m * (1 + x/0.3 m)"``.
        unit: SI unit of the value; empty for a pure number.
        varied: Place of a number, from 1, to which ``program`` (m) is added, in its unit; 0 if
            none is.

    Raises:
        FormulaError: If the text is no formula, or has another dimension.
    """

    text: str
    unit: str
    varied: int = 0

    def __post_init__(self) -> None:
        """Check the text and its dimension."""
        value, _ = self._measured
        if not _fits_all(value) and _dimension(value) != units.in_si(self.unit)[1]:
            got = units.kind_of(_dimension(value))
            raise FormulaError(f"expected {units.kind(self.unit)}, but the formula gives {got}")

    @cached_property
    def _formula(self) -> _Formula:
        return _parse(self.text)

    @cached_property
    def _measured(self) -> tuple[Any, Mapping[ast.expr, float]]:
        return self._formula.measured(f"_{self.varied}")

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy in another process is made of."""
        return {"text": self.text, "unit": self.unit, "varied": self.varied}

    @property
    def variables(self) -> frozenset[str]:
        """The variables that the value depends on, of ``VARIABLES``."""
        names = {node.id for node in ast.walk(self._formula.tree) if isinstance(node, ast.Name)}
        return frozenset(names & {*VARIABLES} | ({"program"} if self.varied else set()))

    @property
    def constant(self) -> float | None:
        """The value if it depends on nothing, else None."""
        return self._measured[1].get(self._formula.tree)

    @property
    def numbers(self) -> tuple[Number, ...]:
        """The numbers in their order."""
        return tuple(self._formula.numbers.values())

    def evaluate(
        self, variables: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]
    ) -> Any:
        """Return the SI value, by the operators of Python on whatever the variables are.

        Args:
            variables: SI values of (at least) ``self.variables``.
            functions: What each key of ``NUMPY_FUNCTIONS`` means for such values; ``"if"`` is
                called with a condition and two values.
        """
        known, constants = {**_OPERATORS, **functions}, self._measured[1]

        def leaf(node: ast.expr) -> Any:
            if node in constants or not isinstance(node, ast.Name):
                return constants.get(node)
            if node.id in VARIABLES:
                return variables[node.id]
            value, unit, *_ = self._formula.numbers[node.id]
            return (value + variables["program"]) * units.in_si(unit)[0]

        return self._formula.walk(leaf, lambda _, sign, values: _joined(known[sign], sign, values))

    def at(self, x: Any, y: Any, program: Any = 0.0, second: Any = 0.0, angle: Any = 0.0) -> Any:
        """Return the SI value at points (m, arrays) for the programs (m) and an angle (rad)."""
        given = map(np.asarray, (x, y, program, second, angle))  # which divide by zero
        variables = dict(zip(VARIABLES, given, strict=True))
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
        formula = _parse(text)
        given = dict.fromkeys(number.unit for number in formula.numbers.values() if number.unit)
        if not given or _is_pure(value := formula.measured()[0]):
            return None
    except FormulaError:
        return None
    kinds = (*given, *units.KINDS)
    return next((k for k in kinds if units.in_si(k)[1] == value.dimensionality), units.SOME_SI)


def coefficients(formula: float | Expression) -> list[tuple[float, str]]:
    """Return the numbers of a formula in their order, each with its unit as written.

    A value that is no formula has none.
    """
    numbers = formula.numbers if isinstance(formula, Expression) else ()
    return [(number.value, number.unit) for number in numbers]


def with_coefficient(formula: Expression, place: int, value: float) -> str:
    """Return a formula's text with another number, of the unit as written, at a place from 1."""
    number = formula.numbers[place - 1]
    written = units.write(value, number.unit)
    return f"{formula.text[: number.start]}({written}){formula.text[number.end :]}"


def with_change(formula: Expression, place: int) -> Expression:
    """Return a formula in which ``program`` (m) is what the number at a place from 1 changes by.

    Raises:
        FormulaError: If the unit of a part depends on this number.
    """
    return replace(formula, varied=place)
