"""Text to the tree of a formula. Nothing is evaluated here, and nothing is Python.

A number takes the unit after it, as far as names of units are joined by ``*``, ``/``
or blanks: ``2 N/m * x`` is two newtons per metre times x. ``x``, ``y``, ``program``,
``pi``, ``and``, ``or`` and a name before a bracket are never units.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from .formula import (
    COMPARISONS,
    CONNECTIVES,
    FUNCTIONS,
    VARIABLES,
    Call,
    FormulaError,
    Name,
    Node,
    Number,
)
from .problems import describe, near_miss

LONGEST = 500
DEEPEST = 20

_CONSTANTS = {"pi": math.pi}
_NO_UNITS = (*VARIABLES, *_CONSTANTS, *CONNECTIVES)
_TOKEN = re.compile(
    r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)"
    r"|(?P<name>[^\W\d]\w*)"
    r"|(?P<sign>\*\*|<=|>=|[-+*/^()<>,])"
)
_UNIT = (
    rf"(?!(?:{'|'.join(_NO_UNITS)})\b|\w+\()[^\W\d_][^\W\d]*"
    r"(?:(?:\^|\*\*)-?[0-9](?![\w.])|[0-9](?![\w.])|[²³])?(?!\w)"
)
_UNITS = re.compile(rf"\s*(?P<unit>{_UNIT}(?:(?:\s*(?:\*(?!\*)|/|·)\s*|\s+){_UNIT})*|°|%)")
_NAMED = re.compile(rf"\b(?:{'|'.join((*VARIABLES, *_CONSTANTS))})\b")

#: Signs by how loosely they bind.
_LEVELS = (("or",), ("and",), COMPARISONS, ("+", "-"), ("*", "/"))
_POWERS = ("^", "**")


def names_a_variable(text: str) -> bool:
    """Return whether a text can only be a formula, for it has x, y, program or pi in it."""
    return _NAMED.search(text) is not None


def parse_formula(text: str) -> Node:
    """Return the tree of a formula.

    Raises:
        FormulaError: If it is too long, too deep, or against the grammar.
    """
    if len(text) > LONGEST:
        raise FormulaError(f"a formula has at most {LONGEST} characters, this has {len(text)}")
    return _Parser(text).parse()


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    start: int
    end: int
    unit: str = ""


def _tokens(text: str) -> list[_Token]:
    found = []
    at = 0
    while (at := at + len(text[at:]) - len(text[at:].lstrip())) < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise FormulaError(f"{describe(text[at])} means nothing in a formula")
        kind, end = str(match.lastgroup), match.end()
        unit = _UNITS.match(text, end) if kind == "number" else None
        if unit:
            end = unit.end()
        found.append(_Token(kind, match[0], at, end, unit["unit"] if unit else ""))
        at = end
    return [*found, _Token("end", "", len(text), len(text))]


class _Parser:
    """Recursive descent over the tokens of one text."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._tokens = _tokens(text)
        self._at = 0
        self._depth = 0

    def parse(self) -> Node:
        node = self._binary(0)
        if self._now.kind != "end":
            raise self._unexpected("an operator")
        return node

    @property
    def _now(self) -> _Token:
        return self._tokens[self._at]

    def _next(self) -> _Token:
        token = self._now
        self._at += 1
        return token

    def _since(self, start: int) -> str:
        return self._text[start : self._tokens[self._at - 1].end]

    def _binary(self, level: int) -> Node:
        if level == len(_LEVELS):
            return self._unary()
        start = self._now.start
        left = self._binary(level + 1)
        while self._now.text in _LEVELS[level]:
            sign = self._next().text
            right = self._binary(level + 1)
            left = Call(self._since(start), sign, (left, right))
        return left

    def _unary(self) -> Node:
        if self._now.text not in ("-", "+"):
            return self._power()
        token = self._next()
        self._deeper()
        inner = self._unary()
        self._depth -= 1
        return Call(self._since(token.start), "negative", (inner,)) if token.text == "-" else inner

    def _power(self) -> Node:
        first = self._now
        base = self._atom()
        if self._now.text not in _POWERS:
            return base
        if first.kind == "number" and first.unit:
            sign = self._next().text
            raise FormulaError(
                f"it is not clear what the power in '{self._since(first.start)}' is of",
                f"Write '({first.text} {first.unit}){sign}...'.",
            )
        self._next()
        self._deeper()
        exponent = self._unary()
        self._depth -= 1
        return Call(self._since(first.start), "**", (base, exponent))

    def _atom(self) -> Node:
        token = self._now
        if token.text == "(":
            self._next()
            return self._inner(")")[0]
        if token.kind == "number":
            self._next()
            return Number(self._since(token.start), float(token.text), token.unit)
        if token.kind == "name" and token.text not in CONNECTIVES:
            self._next()
            return self._call(token) if self._now.text == "(" else self._named(token.text)
        raise self._unexpected("a value")

    def _inner(self, *ends: str) -> tuple[Node, str]:
        """Return what stands in a bracket, with the sign that ends it."""
        self._deeper()
        node = self._binary(0)
        self._depth -= 1
        if self._now.text not in ends:
            raise self._unexpected(" or ".join(f"'{e}'" for e in ends))
        return node, self._next().text

    def _call(self, name: _Token) -> Node:
        if name.text not in FUNCTIONS:
            known = f"The functions are {', '.join(FUNCTIONS)}."
            meant = near_miss(name.text, FUNCTIONS)
            raise FormulaError(f"unknown function '{name.text}'", meant or known)
        arguments = []
        sign = self._next().text
        while sign != ")":
            node, sign = self._inner(",", ")")
            arguments.append(node)
        wanted = FUNCTIONS[name.text]
        if len(arguments) != wanted:
            values = "value" if wanted == 1 else "values"
            raise FormulaError(f"'{name.text}' takes {wanted} {values}, got {len(arguments)}")
        return Call(self._since(name.start), name.text, tuple(arguments))

    def _named(self, name: str) -> Node:
        if name in VARIABLES:
            return Name(name)
        if name in _CONSTANTS:
            return Number(name, _CONSTANTS[name])
        if name in FUNCTIONS:
            raise FormulaError(f"the function '{name}' needs a bracket", f"Write '{name}(...)'.")
        known = (*VARIABLES, *_CONSTANTS, *FUNCTIONS)
        meant = near_miss(name, known)
        about = "A unit follows its number, as in '1 m' or '2 N/m', without brackets."
        raise FormulaError(f"unknown name '{name}'", meant or about)

    def _deeper(self) -> None:
        self._depth += 1
        if self._depth > DEEPEST:
            raise FormulaError(f"brackets are nested more than {DEEPEST} deep")

    def _unexpected(self, wanted: str) -> FormulaError:
        token = self._now
        got = describe(token.text) if token.kind != "end" else "the end"
        place = f" at character {token.start + 1}" if token.kind != "end" else ""
        return FormulaError(f"expected {wanted}, got {got}{place}")
