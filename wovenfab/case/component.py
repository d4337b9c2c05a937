"""One component of the displacement of an edge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import PlainSerializer, PlainValidator

from .expression import NUMPY_FUNCTIONS, Expression
from .formula import VARIABLES
from .units import write
from .varying import Varying

_LENGTH = Varying(unit="m", words=("program", "-program", "free"), variables=VARIABLES)
_FACTORS = {"program": 1.0, "-program": -1.0}


@dataclass(frozen=True)
class Component:
    """Factor times program + offset, or a formula of x, y and the program.

    Attributes:
        held: False where the edge moves freely; the rest then means nothing.
        factor: Multiple of the program's displacement.
        offset: Constant displacement, m.
        expression: The displacement (m), in place of factor and offset.
    """

    held: bool = True
    factor: float = 0.0
    offset: float = 0.0
    expression: Expression | None = None

    @property
    def moves(self) -> bool:
        """Whether the program moves it."""
        if self.expression is not None:
            return "program" in self.expression.variables
        return self.factor != 0

    def at(self, x: Any, y: Any, program: Any) -> Any:
        """Return the displacement (m) at points (m, arrays) for a program (m)."""
        if self.expression is None:
            return self.factor * program + self.offset + np.zeros_like(x)
        with np.errstate(all="ignore"):
            known = {"x": x, "y": y, "program": program}
            return self.expression.evaluate(known, NUMPY_FUNCTIONS) + np.zeros_like(x)


FREE = Component(held=False)


def _read(value: Any) -> Component:
    given = _LENGTH.read(value)
    if isinstance(given, Expression):
        return Component(expression=given)
    if given == "free":
        return FREE
    if isinstance(given, str):
        return Component(factor=_FACTORS[given])
    return Component(offset=given)


def write_component(component: Component) -> str | float:
    """Return a component as it is written in a case."""
    if not component.held:
        return "free"
    if component.expression is not None:
        return component.expression.text
    words = [word for word, factor in _FACTORS.items() if factor == component.factor]
    return words[0] if words else write(component.offset, "m")


AnyComponent = Annotated[
    Component,
    PlainValidator(_read, json_schema_input_type=Annotated[float, _LENGTH]),
    PlainSerializer(write_component, when_used="json"),
]
