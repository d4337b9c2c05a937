"""What is done to the edges of the sheet."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    PlainSerializer,
    WithJsonSchema,
    model_serializer,
    model_validator,
)
from pydantic_core import core_schema

from .component import FREE, AnyComponent, write_component
from .expression import Expression
from .formula import VARIABLES
from .problems import describe, near_miss, one_of, wrong
from .scene import Value
from .values import OneOr, Section, hide_default
from .varying import Varying

_LOAD = Varying(unit="N/m", variables=VARIABLES)
_ROTATIONS = ("free", "held")
_CLAMPS = ("placement", "rotation")
BOTH = (1, 2)


def follows_program(value: Value) -> bool:
    """Return whether a value depends on the program."""
    return isinstance(value, Expression) and "program" in value.variables


def _held(value: Any) -> bool:
    if value not in _ROTATIONS:
        raise wrong(f"expected {one_of(_ROTATIONS)}, got {describe(value)}")
    return bool(value == "held")


def _families(value: Any) -> tuple[int, ...]:
    if isinstance(value, bool) or value not in BOTH:
        raise wrong(f"expected family 1 or 2, got {describe(value)}", "Leave it out for both.")
    return (int(value),)


class EdgeCondition(Section):
    """What is prescribed on an edge; clamp is short for no displacement."""

    components: tuple[AnyComponent, AnyComponent] = Field(
        default=(FREE, FREE),
        alias="displacement",
        examples=[["program", 0]],
        json_schema_extra={"default": ["free", "free"]},
    )
    """Displacement along x and y: program, -program, a length, free, or a formula of all."""

    rotation: Annotated[
        bool,
        BeforeValidator(_held),
        PlainSerializer(lambda held: _ROTATIONS[held], when_used="json"),
        WithJsonSchema({"enum": list(_ROTATIONS)}),
    ] = Field(default=False, json_schema_extra={"default": "free"})
    """Whether the yarn directions at the edge are held as they were at rest."""

    force: tuple[Annotated[Value, _LOAD], Annotated[Value, _LOAD]] | None = Field(
        default=None, examples=[["10 N/m", 0]]
    )
    """Dead force per length of the edge at rest, along x and y; both families share it."""

    families: Annotated[
        tuple[int, ...],
        BeforeValidator(_families, json_schema_input_type=int),
        WithJsonSchema({"enum": list(BOTH)}),
    ] = Field(default=BOTH, alias="family", json_schema_extra=hide_default)
    """The only family that is meant; both unless given."""

    @property
    def moves(self) -> bool:
        """Whether the program moves this edge."""
        return any(c.held and c.moves for c in self.components)

    @property
    def grows(self) -> bool:
        """Whether the program changes a force on this edge."""
        return any(follows_program(load) for load in self.force or ())

    @property
    def burdens_the_start(self) -> bool:
        """Whether it has a force or a displacement that does not follow the program."""
        held = [c.expression or c.offset for c in self.components if c.held and not c.moves]
        given = (*held, *(load for load in self.force or () if not follows_program(load)))
        return any(isinstance(value, Expression) or value != 0 for value in given)

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
        if data.keys() - {"clamp", "family"}:
            raise wrong(
                "'clamp' holds all of the edge and stands alone",
                "Leave out the other keys, or 'clamp'.",
            )
        how = data["clamp"]
        if how not in _CLAMPS:
            raise wrong(
                f"expected clamp: {one_of(_CLAMPS)}, got {describe(how)}", near_miss(how, _CLAMPS)
            )
        rest = {key: value for key, value in data.items() if key != "clamp"}
        return rest | {"displacement": [0.0, 0.0], "rotation": _ROTATIONS[how == "rotation"]}

    @model_validator(mode="after")
    def _sensible(self) -> EdgeCondition:
        if not self.model_fields_set & {"components", "rotation", "force"}:
            raise wrong(
                "expected a displacement, a rotation or a force",
                "For example {displacement: [program, 0]}.",
            )
        for axis, component, load in zip("xy", self.components, self.force or (), strict=False):
            if component.held and load != 0:
                raise wrong(
                    f"the displacement along {axis} is prescribed, so that a force along it "
                    "changes nothing",
                    f"Let it be 'free' there, or make the force along {axis} zero.",
                )
        return self

    @model_serializer(mode="plain", when_used="json")
    def _written(self) -> dict[str, Any]:
        parts: dict[str, Any] = {} if self.families == BOTH else {"family": self.families[0]}
        parts["displacement"] = [write_component(c) for c in self.components]
        parts["rotation"] = _ROTATIONS[self.rotation]
        return parts | ({"force": [_LOAD.write(v) for v in self.force]} if self.force else {})

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Offer the short forms, too."""
        own = handler.resolve_ref_schema(handler(schema))
        clamp = {
            "type": "object",
            "properties": {
                "clamp": {"enum": list(_CLAMPS), "description": "What is held."},
                "family": own["properties"]["family"],
            },
            "required": ["clamp"],
            "additionalProperties": False,
        }
        told = own.pop("description")
        return {"anyOf": [{"const": "clamp"}, clamp, own], "description": told}


def _apart(conditions: tuple[EdgeCondition, ...]) -> tuple[EdgeCondition, ...]:
    given = [family for condition in conditions for family in condition.families]
    if len(given) > len(set(given)):
        raise wrong(
            "two conditions of this edge are for the same family",
            "Make them one, or give them 'family: 1' and 'family: 2'.",
        )
    return conditions


def _without_brackets(conditions: tuple[EdgeCondition, ...]) -> Any:
    written = [c.model_dump(mode="json") for c in conditions]
    return written[0] if len(written) == 1 else written


#: All that is prescribed on one edge; each family is in one condition at most.
EdgeConditions = Annotated[
    tuple[EdgeCondition, ...],
    Field(min_length=1),
    AfterValidator(_apart),
    OneOr(),
    PlainSerializer(_without_brackets, when_used="json"),
]
Boundary = Mapping[str, tuple[EdgeCondition, ...]]


def conditions_of(boundary: Boundary) -> Iterator[tuple[str, int, EdgeCondition]]:
    """Yield each condition with its edge and its place in the edge's list."""
    for name, conditions in boundary.items():
        for i, condition in enumerate(conditions):
            yield name, i, condition
