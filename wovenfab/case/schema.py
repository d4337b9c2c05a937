"""The sections of a case other than effects, edges and program."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    PlainSerializer,
    Tag,
    ValidationInfo,
    model_validator,
)

from wovenfab.case import units
from wovenfab.case.document import existing_file, folder_of
from wovenfab.case.errors import describe, value_error
from wovenfab.case.quantities import (
    Angle,
    AtLeastOne,
    Count,
    Duration,
    Extent,
    Length,
    OneOr,
    Quantity,
    Section,
    Several,
    Size,
    TimeOrSteps,
)
from wovenfab.forms.effect import Needs
from wovenfab.sheet import probes
from wovenfab.sheet.tolerance import LEAST_CROSSING

STEP = (".step", ".stp")
GEOMETRIES = (".geo", ".msh", *STEP)


def _text(value: str) -> str:
    if not value.strip():
        raise value_error("the text is empty", "Say it in a few words.")
    return value


Text = Annotated[str, AfterValidator(_text)]


class Fabric(Section):
    """The fabric that the effects describe, and where their values are from."""

    name: Text = Field(examples=["Plain weave of glass, 743 g/m2"])
    """What it is, in a line."""

    source: Text = Field(examples=["doi:10.1016/j.compositesa.2008.02.016"])
    """Where its values were published or fitted: a DOI, or a text."""

    measured: tuple[Text, ...] = Field(
        default=(), examples=[["shear and friction: bias extension, 115 mm by 230 mm"]]
    )
    """Which values follow from which measurements."""

    assumed: tuple[Text, ...] = Field(
        default=(), examples=[["bending: too small to be measured here"]]
    )
    """Which values are assumed, and why."""


def _crossing(fibres: tuple[float, float]) -> tuple[float, float]:
    if far := [a for a in fibres if abs(a) > 2 * math.pi + 1e-12]:
        raise value_error(
            f"{far[0]:g} rad is more than a full turn",
            f"Did you mean '{far[0]:g} deg'? Numbers without a unit are SI.",
        )
    if abs(math.sin(fibres[1] - fibres[0])) <= LEAST_CROSSING:
        raise value_error(
            "the two families are parallel", "They must cross, as in [45 deg, -45 deg]."
        )
    return fibres


Fibres = Annotated[tuple[Angle, Angle], Several(), AfterValidator(_crossing)]


class Rectangle(Section):
    """A rectangle with its sides along x and y; its edges are left, right, bottom, top."""

    shape: Literal["rectangle"] = "rectangle"
    """Kind of sheet; for other shapes give a file instead."""

    length: Extent = Field(examples=["0.90 m"])
    """Extent along x."""

    width: Extent = Field(examples=["0.30 m"])
    """Extent along y."""

    fibres: Fibres = Field(examples=[["45 deg", "-45 deg"]])
    """Reference directions of family 1 and 2, as angles from the x axis."""


def _geometry(value: Any, info: ValidationInfo) -> Path:
    return existing_file(value, folder_of(info), GEOMETRIES)


def _unit(value: Any) -> str:
    try:
        units.parse(f"1 {value}", "m")
    except ValueError as error:
        raise value_error(
            f"expected a unit of length such as 'mm', got {describe(value)}"
        ) from error
    return str(value)


def _parameter(value: Any) -> float | str:
    with suppress(ValueError):
        if isinstance(value, int | float | str) and not isinstance(value, bool):
            number = units.parse_in(value, 1.0)
            return value if isinstance(value, str) else float(number)
    remedy = "A number is passed to the file as it is."
    raise value_error(f"expected a number, a length or an angle, got {describe(value)}", remedy)


class SheetFile(Section):
    """Any shape, from a gmsh file whose physical groups name the edges."""

    file: Annotated[
        Path, BeforeValidator(_geometry, json_schema_input_type=str), PlainSerializer(str)
    ] = Field(examples=["meshes/dogbone.geo"])
    """Geometry (.geo, .step) or mesh (.msh), relative to the case file."""

    unit: Annotated[str, BeforeValidator(_unit, json_schema_input_type=str)] | None = Field(
        default=None, examples=["mm"]
    )
    """Unit of the lengths in the file; metres unless given. A .step file states its own."""

    parameters: Mapping[str, Annotated[float | str, BeforeValidator(_parameter)]] | None = Field(
        default=None, examples=[{"radius": "20 mm"}]
    )
    """Values for constants that the file defines by DefineConstant. A text with a unit is
    converted to the unit of the file, a number is passed as it is."""

    edges: Mapping[str, Annotated[tuple[AtLeastOne, ...], Field(min_length=1), OneOr()]] | None = (
        Field(default=None, examples=[{"left": 3, "right": [1, 2]}])
    )
    """Edges by the numbers of their curves, in addition to those that the file names."""

    fibres: Fibres = Field(examples=[["45 deg", "-45 deg"]])
    """Reference directions of family 1 and 2, as angles from the x axis."""

    @property
    def length_unit(self) -> float:
        """Length of the unit in which gmsh reads the file, m; a .step file is read in mm."""
        own = "mm" if self.file.suffix.lower() in STEP else "m"
        return units.parse(f"1 {self.unit or own}", "m")

    @property
    def file_parameters(self) -> dict[str, float]:
        """The parameters in the units of the file."""
        given = self.parameters or {}
        return {name: units.parse_in(value, self.length_unit) for name, value in given.items()}

    @model_validator(mode="after")
    def _fits_the_file(self) -> SheetFile:
        if self.file.suffix.lower() in STEP and self.unit not in (None, "mm"):
            what = f"a .step file states its unit: {self.unit!r} would be wrong"
            raise value_error(what, "Leave 'unit' out.")
        if self.parameters and self.file.suffix.lower() != ".geo":
            raise value_error(f"{self.file.name} has no parameters", "A .geo file may have some.")
        return self


def _form(data: Any) -> str:
    named = "file" in data if isinstance(data, dict) else isinstance(data, SheetFile)
    return "from_file" if named else "rectangle"


Sheet = Annotated[
    Annotated[Rectangle, Tag("rectangle")] | Annotated[SheetFile, Tag("from_file")],
    Discriminator(_form),
]


Auto = Literal["auto"]
Mesh = Literal["fibres", "crossed", "right", "unstructured"]


class Discretisation(Section):
    """Elements in space."""

    degree: Annotated[int, Count(least=1, most=5)] = 3
    """Degree of the elements: 2 to 4; 1 only where no effect needs second derivatives."""

    mesh_size: Size | None = Field(default=None, examples=["50 mm"])
    """Size of the cells; unless given a quarter of a rectangle's shorter side, or a tenth of it
    where they do not follow the fibres."""

    mesh: Mesh | None = None
    """How the sheet is divided in triangles: along its fibres (unless given, and always best),
    a rectangle also crossed or right, any shape also unstructured."""

    jumps: Annotated[bool, Field(strict=True)] | None = None
    """Whether each of two placements may jump across the fibres of its own family where these
    stop being held alike, on a mesh along the fibres; true unless given."""

    corner_size: Size | None = Field(default=None, examples=["2 mm"])
    """Size of the cells at the ends of clamps and at re-entrant corners, for a mesh along the
    fibres or an unstructured rectangle."""

    graded: Annotated[bool, Field(strict=True)] | None = None
    """Whether a mesh along the fibres shrinks there, along special fibres and along free edges.
    Unless given it does for one placement; for two that friction makes stick it may be worth it."""

    penalty: Annotated[float | Auto, Quantity(above=0, words=("auto",))] = "auto"
    """Interior penalty sigma of the second-gradient terms."""

    quadrature_degree: Annotated[int | Auto, Count(least=1, most=30, words=("auto",))] = "auto"
    """Degree of polynomials that are integrated exactly."""


class Time(Section):
    """Steps in time."""

    steps_per_cycle: Annotated[int, Count(least=4, most=1_000_000, even=True)] = 80
    """Steps of each cycle, even so that the reversal is hit."""

    scheme: Literal["bdf2", "bdf3", "backward-euler", "midpoint"] = "bdf2"
    """How rates are formed."""

    tolerance: Annotated[float, Quantity(above=0, most=1)] | None = None
    """Steps adapt between the planned ones: error of one in friction's power and in force."""

    smallest_step: Annotated[float, Quantity(above=0, most=1)] = 1 / 1024
    """The run gives up on a step cut to less than this fraction of the planned one."""

    extra_times: Annotated[tuple[Duration, ...], OneOr()] = Field(default=(), examples=["0.2 s"])
    """Times since the start at which steps end, too, such as that of a photograph."""


def _option(value: Any) -> str | int | float | bool:
    if not isinstance(value, str | int | float):
        raise value_error(f"expected text, a number, true or false, got {describe(value)}")
    return value


def _option_name(name: str) -> str:
    if not name or name.startswith("-"):
        raise value_error("PETSc options are written without the leading dash here")
    return name


class Solver(Section):
    """Newton's method in each step."""

    max_iterations: AtLeastOne = 25
    """Iterations after which a step is cut."""

    tolerance: Annotated[float, Quantity(above=0, most=1)] = 1e-9
    """Relative tolerance of the balance of forces."""

    tangent: Literal["mixed", "plain"] = "mixed"
    """Mixed-integration-point tangent, which suits stiff yarns, or the plain one."""

    predictor: Literal["quadratic", "none"] = "quadratic"
    """Whether a step starts from the motion extrapolated, or from the last state."""

    factor: Literal["kept", "renewed"] = "kept"
    """Whether earlier factors serve where that is quicker, or none but the present one."""

    stability: Literal["stop", "follow", "ignore"] = "stop"
    """Where the sheet buckles: stop, follow the branch of minima, or stay on the saddle."""

    seed: Annotated[int, Count(least=0, most=2**32 - 1)] = 0
    """Of the random numbers that decide to which side the sheet buckles."""

    petsc: Mapping[
        Annotated[str, AfterValidator(_option_name)],
        Annotated[str | int | float | bool, BeforeValidator(_option)],
    ] = Field(default={}, examples=[{"snes_linesearch_type": "basic"}])
    """PETSc options that act on the solution; others, such as those that write files, are for the
    command line."""


FieldName = Literal["displacement", "relative_displacement", "curvature", "shear_angle", "stretch"]


def possible_fields(needs: Needs) -> tuple[FieldName, ...]:
    """Return the fields that make sense for effects with these needs."""
    known = {"relative_displacement": needs.placements == 2, "curvature": needs.second_gradient}
    return tuple(name for name in get_args(FieldName) if known.get(name, True))


Position = Annotated[tuple[Length, Length], Several()]


def _apart(ends: tuple[Position, Position]) -> tuple[Position, Position]:
    if ends[0] == ends[1]:
        raise value_error("both points are the same")
    return ends


Ends = Annotated[tuple[Position, Position], AfterValidator(_apart)]
Family = Literal[1, 2]
Samples = Annotated[int, Count(least=2, most=100_000)]


class PointSection(Section):
    """Displacement of each family and slip at a point, on every step."""

    type: Literal["point"]
    """Kind of probe."""

    at: Position = Field(examples=[["0.45 m", "0.15 m"]])
    """Reference position."""

    @property
    def probe(self) -> probes.PointProbe:
        """The probe."""
        return probes.PointProbe(self.at)


class ExtensometerSection(Section):
    """Gauge length between two points of the sheet and its strain, on every step."""

    type: Literal["extensometer"]
    """Kind of probe."""

    ends: Ends = Field(examples=[[["0.40 m", "0.15 m"], ["0.50 m", "0.15 m"]]])
    """Reference positions of both ends."""

    family: Family | None = None
    """The family that it is fixed to; to the mean of both unless given."""

    @property
    def probe(self) -> probes.Extensometer:
        """The probe."""
        return probes.Extensometer(self.ends, self.family)


class ZoneSection(Section):
    """Mean shear angle over the area of a rectangle or a circle, on every step."""

    type: Literal["zone"]
    """Kind of probe."""

    corners: Ends | None = Field(default=None, examples=[[["0.4 m", "0.1 m"], ["0.5 m", "0.2 m"]]])
    """Opposite corners of a rectangle with sides along x and y."""

    centre: Position | None = None
    """Of a circle."""

    radius: Size | None = None
    """Of the circle."""

    @property
    def probe(self) -> probes.Zone:
        """The probe."""
        if self.corners is not None:
            return probes.rectangle_zone(*self.corners)
        assert self.centre is not None and self.radius is not None
        return probes.circle_zone(self.centre, self.radius)

    @model_validator(mode="after")
    def _one_shape(self) -> ZoneSection:
        circle = (self.centre is not None, self.radius is not None)
        if any(circle) == (self.corners is not None) or any(circle) != all(circle):
            remedy = "For example 'centre: [0.45 m, 0.15 m]' and 'radius: 50 mm'."
            raise value_error("expected either two corners, or a centre and a radius", remedy)
        if self.corners and any(a == b for a, b in zip(*self.corners, strict=True)):
            raise value_error("the corners are not opposite ones", "They differ in x and in y.")
        return self


class LineSection(Section):
    """All stored fields along a straight line, whenever fields are stored."""

    type: Literal["line"]
    """Kind of probe."""

    ends: Ends = Field(examples=[[["0.1 m", "0.15 m"], ["0.8 m", "0.15 m"]]])
    """Reference positions of both ends."""

    points: Samples = 101
    """Number of equidistant points."""

    @property
    def probe(self) -> probes.Line:
        """The probe."""
        return probes.Line(self.ends, self.points)


class YarnSection(Section):
    """All stored fields along a yarn, from edge to edge, whenever fields are stored."""

    type: Literal["yarn"]
    """Kind of probe."""

    family: Family
    """Family of the yarn."""

    through: Position = Field(examples=[["0.45 m", "0.15 m"]])
    """Reference position of a point of it."""

    points: Samples = 101
    """Number of equidistant points."""

    @property
    def probe(self) -> probes.Yarn:
        """The probe."""
        return probes.Yarn(self.family, self.through, self.points)


ProbeSection = Annotated[
    PointSection | ExtensometerSection | ZoneSection | LineSection | YarnSection,
    Field(discriminator="type"),
]


def _probe_name(name: str) -> str:
    if not (name.isidentifier() and name.isascii()):
        remedy = "It is part of names of columns: letters, digits and underscores, a letter first."
        raise value_error(f"{describe(name)} cannot be the name of a probe", remedy)
    return name


class OutputSection(Section):
    """What is written besides the history."""

    fields: tuple[FieldName, ...] = get_args(FieldName)
    """Fields for ParaView; all that the effects know of unless given."""

    every: AtLeastOne = 10
    """Fields are written every so many steps, at reversals and at the end."""

    pictures: Annotated[bool, Field(strict=True)] = True
    """Whether pictures are drawn at the end."""

    checkpoint: Annotated[float | int | bool, TimeOrSteps(unit="s", above=0)] = Field(
        default=300.0, examples=["5 min", 100, False]
    )
    """Wall time or number of steps between checkpoints, from which a run can go on; one more is
    written at the end. False for none."""

    probes: Mapping[Annotated[str, AfterValidator(_probe_name)], ProbeSection] = Field(
        default={}, examples=[{"centre": {"type": "point", "at": ["0.45 m", "0.15 m"]}}]
    )
    """Named places: points, extensometers and zones are columns of the history, lines and yarns
    are written to lines.csv."""

    @property
    def lines(self) -> Mapping[str, LineSection | YarnSection]:
        """The probes that are written wherever fields are stored."""
        return {n: p for n, p in self.probes.items() if isinstance(p, LineSection | YarnSection)}
