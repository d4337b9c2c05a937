"""What is done to the edges of the sheet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import (
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    PlainSerializer,
    PlainValidator,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import core_schema

from .problems import describe, near_miss, one_of, wrong
from .units import write
from .values import Quantity, Section

_LENGTH = Quantity(unit="m", words=("program", "-program", "free"))
_FACTORS = {"program": 1.0, "-program": -1.0}
_ROTATIONS = ("free", "held")
_CLAMPS = ("placement", "rotation")


@dataclass(frozen=True)
class Component:
    """One component of the displacement of an edge: factor times program + offset.

    Attributes:
        held: False where the edge moves freely; the rest then means nothing.
        factor: Multiple of the program's displacement.
        offset: Constant displacement, m.
    """

    held: bool = True
    factor: float = 0.0
    offset: float = 0.0


def _read(value: Any) -> Component:
    given = _LENGTH.read(value)
    if given == "free":
        return Component(held=False)
    if isinstance(given, str):
        return Component(factor=_FACTORS[given])
    return Component(offset=given)


def _write(component: Component) -> str | float:
    if not component.held:
        return "free"
    words = [word for word, factor in _FACTORS.items() if factor == component.factor]
    return words[0] if words else write(component.offset, "m")


AnyComponent = Annotated[
    Component,
    PlainValidator(_read, json_schema_input_type=Annotated[float, _LENGTH]),
    PlainSerializer(_write, when_used="json"),
]


def _held(value: Any) -> bool:
    if value not in _ROTATIONS:
        raise wrong(f"expected {one_of(_ROTATIONS)}, got {describe(value)}")
    return bool(value == "held")


class EdgeCondition(Section):
    """What is prescribed on an edge, for both families; clamp is short for no displacement."""

    components: tuple[AnyComponent, AnyComponent] = Field(
        alias="displacement", examples=[["program", 0]]
    )
    """Displacement along x and y: program, -program, a length, or free."""

    rotation: Annotated[
        bool,
        BeforeValidator(_held),
        PlainSerializer(lambda held: _ROTATIONS[held], when_used="json"),
        WithJsonSchema({"enum": list(_ROTATIONS)}),
    ] = Field(default=False, json_schema_extra={"default": "free"})
    """Whether the yarn directions at the edge are held as they were at rest."""

    @property
    def moves(self) -> bool:
        """Whether the program moves this edge."""
        return any(c.factor for c in self.components)

    @model_validator(mode="before")
    @classmethod
    def _spell_out(cls, data: Any) -> Any:
        """Turn the short forms into the long one."""
        if data == "clamp":
            data = {"clamp": "placement"}
        if not isinstance(data, dict):
            raise wrong(
                f"expected 'clamp', 'clamp: rotation' or a displacement, got {describe(data)}",
                near_miss(data, ["clamp"]) or "For example {displacement: [program, 0]}.",
            )
        if "clamp" not in data:
            return data
        if len(data) > 1:
            raise wrong(
                "'clamp' holds all of the edge and stands alone",
                "Leave out the other keys, or 'clamp'.",
            )
        how = data["clamp"]
        if how not in _CLAMPS:
            raise wrong(
                f"expected clamp: {one_of(_CLAMPS)}, got {describe(how)}", near_miss(how, _CLAMPS)
            )
        return {"displacement": [0.0, 0.0], "rotation": _ROTATIONS[how == "rotation"]}

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Offer the short forms, too."""
        own = handler.resolve_ref_schema(handler(schema))
        clamp = {
            "type": "object",
            "properties": {"clamp": {"enum": list(_CLAMPS), "description": "What is held."}},
            "required": ["clamp"],
            "additionalProperties": False,
        }
        told = own.pop("description")
        return {"anyOf": [{"const": "clamp"}, clamp, own], "description": told}
