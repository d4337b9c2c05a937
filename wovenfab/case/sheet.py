"""The sheet of a case: its shape and the directions of its fibres."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    PlainSerializer,
    Tag,
    ValidationInfo,
)

from .files import existing_file, folder_of
from .problems import wrong
from .values import Angle, Section, Size

GEOMETRIES = (".geo", ".msh")
#: Smallest |sin| of the angle between the families.
LEAST_CROSSING = 1e-3


def _crossing(fibres: tuple[float, float]) -> tuple[float, float]:
    if far := [a for a in fibres if abs(a) > 2 * math.pi + 1e-12]:
        raise wrong(
            f"{far[0]:g} rad is more than a full turn",
            f"Did you mean '{far[0]:g} deg'? Numbers without a unit are SI.",
        )
    if abs(math.sin(fibres[1] - fibres[0])) <= LEAST_CROSSING:
        raise wrong("the two families are parallel", "They must cross, as in [45 deg, -45 deg].")
    return fibres


Fibres = Annotated[tuple[Angle, Angle], AfterValidator(_crossing)]


class Rectangle(Section):
    """A rectangle with its sides along x and y; its edges are left, right, bottom, top."""

    shape: Literal["rectangle"] = "rectangle"
    """Kind of sheet; for other shapes give a file instead."""

    length: Size = Field(examples=["0.90 m"])
    """Extent along x."""

    width: Size = Field(examples=["0.30 m"])
    """Extent along y."""

    fibres: Fibres = Field(examples=[["45 deg", "-45 deg"]])
    """Reference directions of family 1 and 2, as angles from the x axis."""


def _geometry(value: Any, info: ValidationInfo) -> Path:
    return existing_file(value, folder_of(info), GEOMETRIES)


class SheetFile(Section):
    """Any shape, from a gmsh file whose physical groups name the edges."""

    file: Annotated[
        Path, BeforeValidator(_geometry, json_schema_input_type=str), PlainSerializer(str)
    ] = Field(examples=["meshes/dogbone.geo"])
    """Geometry (.geo) or mesh (.msh), relative to the case file, in metres."""

    fibres: Fibres = Field(examples=[["45 deg", "-45 deg"]])
    """Reference directions of family 1 and 2, as angles from the x axis."""


def _form(data: Any) -> str:
    named = "file" in data if isinstance(data, dict) else isinstance(data, SheetFile)
    return "from_file" if named else "rectangle"


Sheet = Annotated[
    Annotated[Rectangle, Tag("rectangle")] | Annotated[SheetFile, Tag("from_file")],
    Discriminator(_form),
]
