"""Values of a case for the model: numbers stay, formulas become functions of the position."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import ufl

from wovenfab.case import Component, Expression
from wovenfab.model.constraints import Held
from wovenfab.model.loads import Force
from wovenfab.model.model import Value

#: What the functions of a formula mean in UFL.
UFL_FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "sqrt": ufl.sqrt,
    "exp": ufl.exp,
    "log": ufl.ln,
    "sin": ufl.sin,
    "cos": ufl.cos,
    "tan": ufl.tan,
    "tanh": ufl.tanh,
    "abs": abs,
    "min": ufl.min_value,
    "max": ufl.max_value,
    "if": ufl.conditional,
    "<": ufl.lt,
    "<=": ufl.le,
    ">": ufl.gt,
    ">=": ufl.ge,
    "and": ufl.And,
    "or": ufl.Or,
}


def value_of(value: float | Expression) -> Value:
    """Return a number, or a UFL expression as a function of the reference position."""
    return partial(_in_ufl, value) if isinstance(value, Expression) else value


def load_of(value: float | Expression) -> Force:
    """Return a number, or a UFL expression as a function of position and program."""
    return partial(_in_ufl, value) if isinstance(value, Expression) else value


def values_of(values: Mapping[str, Any]) -> dict[str, Value | tuple[Value, Value]]:
    """Return an effect's values; pairs are those of the two families."""
    return {
        name: (value_of(value[0]), value_of(value[1]))
        if isinstance(value, tuple)
        else value_of(value)
        for name, value in values.items()
    }


def held_of(component: Component) -> Held | None:
    """Return how a component is held, None where it is free."""
    if not component.held:
        return None
    if component.expression is not None:
        return Held(field=component.at)
    return Held(component.factor, component.offset)


def _in_ufl(formula: Expression, position: Any, program: Any = None) -> Any:
    known = {"x": position[0], "y": position[1], "program": program}
    return ufl.as_ufl(formula.evaluate(known, UFL_FUNCTIONS))
