"""What is prescribed on the edges of the sheet, and what that leaves free."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    PlainSerializer,
    PlainValidator,
    WithJsonSchema,
    model_serializer,
    model_validator,
)
from pydantic_core import core_schema

from wovenfab.case.effects import Value
from wovenfab.case.errors import describe, near_miss, one_of, value_error
from wovenfab.case.formula import LENGTHS, Expression
from wovenfab.case.quantities import Angle, OneOr, Quantity, Section, Several, Size, hide_default
from wovenfab.case.units import write

_LENGTH = Quantity(unit="m", words=("program", "-program", "free"), variables=LENGTHS)
_FACTORS = {"program": 1.0, "-program": -1.0}
PROGRAMS = frozenset({"program", "second_program"})


@dataclass(frozen=True)
class FrameMotion:
    """A component of the displacement in a picture frame of four hinged bars.

    A frame that is square at rest turns its two pairs of bars against each other about the
    diagonal along which the crosshead moves. With D_1 and D_2 along the bars at rest, n the
    direction of that diagonal, m that of the other one, and c = 1/sqrt(2) + program/(2 length)
    the cosine of half the angle between the bars, D_1 becomes c n - sqrt(1 - c**2) m and D_2
    becomes c n + sqrt(1 - c**2) m. The origin of the coordinates stays where it is.

    Attributes:
        length: Of the bars from hinge to hinge, m.
        angle: Of the first bars to x, rad; the second ones are at right angles to them.
        axis: 0 for the displacement along x, 1 along y.
    """

    length: float
    angle: float
    axis: int
    variables = frozenset({"program"})

    def at(self, x: Any, y: Any, program: Any = 0.0, second: Any = 0.0) -> Any:
        """Return the displacement (m) at points (m, arrays) for the crosshead's travel (m)."""
        one = np.array([np.cos(self.angle), np.sin(self.angle)])
        two = np.array([-one[1], one[0]])
        n, m = ((two + sign * one)[self.axis] / np.sqrt(2) for sign in (1, -1))
        # Changes of c and sqrt(1 - c**2), so that there is no displacement at rest, not even by
        # rounding.
        rest, opened = 1 / np.sqrt(2), program / (2 * self.length)
        with np.errstate(invalid="ignore"):
            s = np.sqrt(1 - (rest + opened) ** 2)
        closed = -opened * (2 * rest + opened) / (s + rest)
        along_one, along_two = (x * d[0] + y * d[1] for d in (one, two))
        turned = along_one * (opened * n - closed * m)
        return turned + along_two * (opened * n + closed * m)


@dataclass(frozen=True)
class Component:
    """Factor times program + offset, or another function of x, y and both programs.

    Attributes:
        held: False where the edge moves freely; the rest then means nothing.
        factor: Multiple of the program's displacement.
        offset: Constant displacement, m.
        expression: The displacement (m), in place of factor and offset.
    """

    held: bool = True
    factor: float = 0.0
    offset: float = 0.0
    expression: Expression | FrameMotion | None = None

    @property
    def follows(self) -> frozenset[str]:
        """The programs that move it."""
        if self.expression is not None:
            return self.expression.variables & PROGRAMS
        return frozenset({"program"} if self.factor else ())

    @property
    def moves(self) -> bool:
        """Whether the program, the first one, moves it."""
        return "program" in self.follows

    def at(self, x: Any, y: Any, program: Any, second: Any = 0.0) -> Any:
        """Return the displacement (m) at points (m, arrays) for the programs (m)."""
        if self.expression is None:
            return self.factor * program + self.offset + np.zeros_like(x)
        return self.expression.at(x, y, program, second)


def programs_in(value: Value) -> frozenset[str]:
    """Return the names of the programs that a value depends on."""
    return value.variables & PROGRAMS if isinstance(value, Expression) else frozenset()


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
    if isinstance(component.expression, Expression):
        return component.expression.text
    words = [word for word, factor in _FACTORS.items() if factor == component.factor]
    return words[0] if words else write(component.offset, "m")


AnyComponent = Annotated[
    Component,
    PlainValidator(_read, json_schema_input_type=Annotated[float, _LENGTH]),
    PlainSerializer(write_component, when_used="json"),
]


_LOAD = Quantity(unit="N/m", variables=LENGTHS)
_ROTATIONS = ("free", "held")
_CLAMPS = ("placement", "rotation")
BOTH = (1, 2)


def _held(value: Any) -> bool:
    if value not in _ROTATIONS:
        raise value_error(f"expected {one_of(_ROTATIONS)}, got {describe(value)}")
    return bool(value == "held")


def _families(value: Any) -> tuple[int, ...]:
    if isinstance(value, bool) or value not in BOTH:
        raise value_error(
            f"expected family 1 or 2, got {describe(value)}", "Leave it out for both."
        )
    return (int(value),)


class Frame(Section):
    """A picture frame: four bars of equal length with hinges at their ends, square at rest.

    The program is the travel of the crosshead along the diagonal between two hinges; the angle
    between the bars there becomes smaller as it grows. The fabric may be shorter than the bars.
    """

    length: Size
    """Of the bars from hinge to hinge."""

    angle: Angle = 0.0
    """Direction of the bars of the first pair from x; the others are at right angles to them."""

    @property
    def components(self) -> tuple[Component, Component]:
        """The displacement along x and y of all that is fixed to it."""
        x, y = (FrameMotion(self.length, self.angle, axis) for axis in (0, 1))
        return Component(expression=x), Component(expression=y)


class EdgeCondition(Section):
    """What is prescribed on an edge; clamp is short for no displacement."""

    displacement: Annotated[tuple[AnyComponent, AnyComponent], Several()] = Field(
        default=(FREE, FREE),
        examples=[["program", 0]],
        json_schema_extra={"default": ["free", "free"]},
    )
    """Displacement along x and y: program, -program, second_program, a length, free, or a formula
    of all."""

    frame: Frame | None = Field(default=None, examples=[{"length": "250 mm"}])
    """The picture frame whose bar holds this edge, in place of a displacement."""

    rotation: Annotated[
        bool,
        BeforeValidator(_held),
        PlainSerializer(lambda held: _ROTATIONS[held], when_used="json"),
        WithJsonSchema({"enum": list(_ROTATIONS)}),
    ] = Field(default=False, json_schema_extra={"default": "free"})
    """Whether the yarn directions at the edge are held as they were at rest."""

    force: Annotated[tuple[Annotated[Value, _LOAD], Annotated[Value, _LOAD]], Several()] | None = (
        Field(default=None, examples=[["10 N/m", 0]])
    )
    """Dead force per length of the edge at rest, along x and y; both families share it."""

    families: Annotated[
        tuple[int, ...],
        BeforeValidator(_families, json_schema_input_type=int),
        WithJsonSchema({"enum": list(BOTH)}),
    ] = Field(default=BOTH, alias="family", json_schema_extra=hide_default)
    """The only family that is meant; both unless given."""

    @property
    def components(self) -> tuple[Component, Component]:
        """How it is held along x and y."""
        return self.frame.components if self.frame else self.displacement

    @property
    def moves(self) -> bool:
        """Whether the program moves this edge."""
        return any(c.held and c.moves for c in self.components)

    @property
    def follows(self) -> frozenset[str]:
        """The programs that move this edge or change a force on it."""
        moving = (c.follows for c in self.components if c.held)
        return frozenset().union(*moving, *map(programs_in, self.force or ()))

    @property
    def acts_initially(self) -> bool:
        """Whether it has a force or a displacement that does not follow a program."""
        held = [c.expression or c.offset for c in self.components if c.held and not c.follows]
        given = (*held, *(load for load in self.force or () if not programs_in(load)))
        return any(value != 0 for value in given)

    @model_validator(mode="before")
    @classmethod
    def _spell_out(cls, data: Any) -> Any:
        """Turn the short forms into the long one."""
        if data == "clamp":
            data = {"clamp": "placement"}
        if not isinstance(data, dict):
            raise value_error(
                f"expected 'clamp', 'clamp: rotation' or a displacement, got {describe(data)}",
                near_miss(data, ["clamp"]) or "For example {displacement: [program, 0]}.",
            )
        if "clamp" not in data:
            return data
        if data.keys() - {"clamp", "family"}:
            raise value_error(
                "'clamp' holds all of the edge and stands alone",
                "Leave out the other keys, or 'clamp'.",
            )
        how = data["clamp"]
        if how not in _CLAMPS:
            raise value_error(
                f"expected clamp: {one_of(_CLAMPS)}, got {describe(how)}", near_miss(how, _CLAMPS)
            )
        rest = {key: value for key, value in data.items() if key != "clamp"}
        return rest | {"displacement": [0.0, 0.0], "rotation": _ROTATIONS[how == "rotation"]}

    @model_validator(mode="after")
    def _sensible(self) -> EdgeCondition:
        if not self.model_fields_set & {"displacement", "frame", "rotation", "force"}:
            raise value_error(
                "expected a displacement, a frame, a rotation or a force",
                "For example {displacement: [program, 0]}.",
            )
        if self.frame and self.model_fields_set & {"displacement", "rotation", "force"}:
            raise value_error(
                "'frame' prescribes both displacements, and the yarns turn with its bars",
                "Leave out displacement, rotation and force, or 'frame'.",
            )
        for axis, component, load in zip("xy", self.components, self.force or (), strict=False):
            if component.held and load != 0:
                raise value_error(
                    f"the displacement along {axis} is prescribed, so that a force along it "
                    "changes nothing",
                    f"Let it be 'free' there, or make the force along {axis} zero.",
                )
        return self

    @model_serializer(mode="plain", when_used="json")
    def _written(self) -> dict[str, Any]:
        parts: dict[str, Any] = {} if self.families == BOTH else {"family": self.families[0]}
        if self.frame:
            return parts | {"frame": self.frame.model_dump(mode="json")}
        parts["displacement"] = [write_component(c) for c in self.displacement]
        parts["rotation"] = _ROTATIONS[self.rotation]
        return parts | ({"force": [_LOAD.write(v) for v in self.force]} if self.force else {})

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Offer the short forms, too."""
        spelt_out = handler.resolve_ref_schema(handler(schema))
        clamp = {
            "type": "object",
            "properties": {
                "clamp": {"enum": list(_CLAMPS), "description": "What is held."},
                "family": spelt_out["properties"]["family"],
            },
            "required": ["clamp"],
            "additionalProperties": False,
        }
        description = spelt_out.pop("description")
        return {"anyOf": [{"const": "clamp"}, clamp, spelt_out], "description": description}


def _apart(conditions: tuple[EdgeCondition, ...]) -> tuple[EdgeCondition, ...]:
    given = [family for condition in conditions for family in condition.families]
    if len(given) > len(set(given)):
        raise value_error(
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


Array = npt.NDArray[np.float64]

#: End points of the edges of a rectangle, in units of its sides.
EDGES = {
    "left": ((0, 0), (0, 1)),
    "right": ((1, 0), (1, 1)),
    "bottom": ((0, 0), (1, 0)),
    "top": ((0, 1), (1, 1)),
}


def free_motion(
    sides: tuple[float, float],
    fibres: tuple[float, float],
    boundary: Boundary,
    shear_resisted: bool,
) -> str | None:
    """Return in words how the sheet can move at no cost, or None if it cannot.

    Args:
        sides: Length and width, m.
        fibres: Angles of the families, rad.
        boundary: Conditions on the edges of the rectangle. Two placements are tied, so
            that what holds one of them holds both.
        shear_resisted: Whether an effect resists shear. If not, the fibres may also
            turn independently of each other, each family as one.
    """
    directions = np.array([[np.cos(a), np.sin(a)] for a in fibres])
    names, gradients = zip(*_gradients(directions, shear_resisted), strict=True)
    size = max(sides)
    rows: list[Array] = []
    for edge, _, condition in conditions_of(boundary):
        for corner in EDGES[edge]:
            point = np.array(corner) * np.array(sides) / size
            moved = np.column_stack([np.eye(2), *(g @ point for g in gradients)])
            rows += [moved[i] for i in (0, 1) if condition.components[i].held]
        for d in directions[[f - 1 for f in condition.families]] if condition.rotation else ():
            across = np.array([-d[1], d[0]])
            rows.append(np.array([0.0, 0.0, *(across @ g @ d for g in gradients)]))
    constraints = np.array(rows).reshape(-1, 2 + len(gradients))
    free = [
        name
        for name, column in zip(("move along x", "move along y"), constraints.T, strict=False)
        if not column.any()
    ]
    if free:
        return free[0]
    rank = int(np.linalg.matrix_rank(constraints, tol=1e-9))
    return None if rank == constraints.shape[1] else names[0]


def _gradients(directions: Array, shear_resisted: bool) -> list[tuple[str, Array]]:
    """Return the displacement gradients that keep the fibres straight and their length."""
    inverse = np.linalg.inv(directions)
    turns = [inverse @ np.array(m, float) @ inverse.T for m in ([[0, 1], [0, 0]], [[0, 0], [1, 0]])]
    if shear_resisted:
        return [("turn as a whole", turns[0] - turns[1])]
    return [("turn as a whole or shear uniformly", turn) for turn in turns]


def apart(a: EdgeCondition, b: EdgeCondition, x: float, y: float, size: float) -> str:
    """Return the axis along which two conditions differ at a point, if there is one."""
    programs = size * np.array(list(product((0.0, 0.01, 0.1, 0.3), repeat=2))).T
    for axis, c, d in zip("xy", a.components, b.components, strict=True):
        if c.held and d.held:
            gap = np.abs(c.at(x, y, *programs) - d.at(x, y, *programs))
            if not np.all(gap <= 1e-9 * size):
                return axis
    return ""
