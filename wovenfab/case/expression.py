"""A value that varies over the sheet, given by a formula."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from . import units
from .dimensions import dimension_of, in_words, si_value
from .formula import (
    NUMPY_FUNCTIONS,
    REQUIRED_FUNCTIONS,
    FormulaError,
    Node,
    Number,
    evaluate,
    names_in,
)
from .formula import in_si as tree_in_si
from .grammar import names_a_variable, parse_formula

__all__ = [
    "NUMPY_FUNCTIONS",
    "REQUIRED_FUNCTIONS",
    "Expression",
    "FormulaError",
    "is_formula",
]


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
        found = dimension_of(parse_formula(self.text))
        if found is not None and found != units.in_si(self.unit)[1]:
            kind = units.kind(self.unit)
            raise FormulaError(f"expected {kind}, but the formula gives {in_words(found)}")
        _ = self._tree

    @cached_property
    def _tree(self) -> Node:
        return tree_in_si(parse_formula(self.text), si_value)

    @property
    def variables(self) -> frozenset[str]:
        """The variables that the value depends on: of x, y and program."""
        return names_in(self._tree)

    @property
    def constant(self) -> float | None:
        """The value if it depends on nothing, else None."""
        return self._tree.value if isinstance(self._tree, Number) else None

    def evaluate(
        self, variables: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]
    ) -> Any:
        """Return the SI value, by the operators of Python on whatever the variables are.

        Args:
            variables: Values in m of (at least) ``self.variables``.
            functions: What each of ``REQUIRED_FUNCTIONS`` means for such values, like
                ``NUMPY_FUNCTIONS``; ``"if"`` is called with a condition and two values.
        """
        return evaluate(self._tree, variables, functions)


def is_formula(text: str) -> bool:
    """Return whether a text is meant as a formula, not as a number with a unit or a word."""
    if names_a_variable(text):
        return True
    if units.is_quantity(text):
        return False
    try:
        parse_formula(text)
    except FormulaError:
        return "(" in text
    return True
