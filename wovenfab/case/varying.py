"""A quantity that may be given by a formula, as an annotation for pydantic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import GetJsonSchemaHandler
from pydantic_core import core_schema

from . import units
from .expression import Expression, FormulaError, is_formula
from .problems import one_of, wrong
from .values import Json, Quantity


@dataclass(frozen=True)
class Varying(Quantity):
    """A float in the SI unit ``unit``, or an ``Expression`` of some variables.

    Attributes:
        variables: What a formula may depend on here.
    """

    variables: tuple[str, ...] = ("x", "y")

    def read(self, value: Any) -> Any:
        """Return a word, a number, or an expression if it depends on any variable."""
        plain = not isinstance(value, str) or value in self.words or not is_formula(value)
        if isinstance(value, Expression) or plain:
            return value if isinstance(value, Expression) else super().read(value)
        try:
            expression = Expression(value, self.unit)
        except FormulaError as error:
            raise wrong(str(error), error.remedy) from error
        if expression.constant is not None:
            self.check(expression.constant, value)
            return expression.constant
        if unknown := sorted(expression.variables - set(self.variables)):
            raise wrong(
                f"'{unknown[0]}' cannot be used here",
                f"This formula may depend on {one_of(self.variables)}.",
            )
        return expression

    def write(self, value: Any) -> Any:
        """Return text that reads as the same value."""
        return value.text if isinstance(value, Expression) else super().write(value)

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> Json:
        """Describe a number in SI, or text with a unit or a formula."""
        name, example = units.KINDS.get(self.unit, ("a value", f"1 {self.unit}"))
        number = {"type": "number", "description": f"{name} in {self.unit}".removesuffix(" in ")}
        formula = f"or a formula of {', '.join(self.variables)}"
        text = {"type": "string", "description": f"'{example}', {formula}"}
        return self._or_words([number | self.bounds(), text]) | {
            "examples": [example],
            "unit": self.unit or "1",
        }
