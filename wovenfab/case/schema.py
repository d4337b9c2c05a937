"""The case: what a case file says, validated and in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, BeforeValidator, Field, PrivateAttr

from forms.effect import Needs

from .boundary import EdgeConditions
from .effects import EffectsSection
from .needs import needs_of_scene
from .problems import describe, wrong
from .program import Segments
from .scene import Scene, Values
from .sheet import Sheet
from .values import AtLeastOne, Count, Quantity, Section, Size

Mesh = Literal["fibres", "crossed", "right", "unstructured"]


class Discretisation(Section):
    """Elements in space."""

    degree: Annotated[int, Count(least=1, most=4)] = 3
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
    fibres or an unstructured rectangle. Along the fibres one placement is graded unless told
    otherwise, there and along free edges; the mesh size given here makes it uniform."""

    penalty: Annotated[float | Literal["auto"], Quantity(above=0, words=("auto",))] = "auto"
    """Interior penalty sigma of the second-gradient terms."""

    quadrature_degree: Annotated[
        int | Literal["auto"], Count(least=1, most=30, words=("auto",))
    ] = "auto"
    """Degree of polynomials that are integrated exactly."""


class Time(Section):
    """Steps in time."""

    steps_per_cycle: Annotated[int, Count(least=4, most=1_000_000, even=True)] = 80
    """Steps of each cycle, even so that the reversal is hit."""

    scheme: Literal["bdf2", "backward-euler", "midpoint"] = "bdf2"
    """How rates are formed."""

    tolerance: Annotated[float, Quantity(above=0, most=1)] | None = None
    """Steps adapt between the planned ones: error of one in friction's power and in force."""

    smallest_step: Annotated[float, Quantity(above=0, most=1)] = 1 / 1024
    """The run gives up on a step cut to less than this fraction of the planned one."""


def _option(value: Any) -> str | int | float | bool:
    if not isinstance(value, str | int | float):
        raise wrong(f"expected text, a number, true or false, got {describe(value)}")
    return value


def _option_name(name: str) -> str:
    if not name or name.startswith("-"):
        raise wrong("PETSc options are written without the leading dash here")
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
    """Whether earlier tangents and factors serve where that is quicker, or none but the present."""

    stability: Literal["stop", "follow", "ignore"] = "stop"
    """Where the sheet buckles: stop, follow the branch of minima, or stay on the saddle."""

    seed: Annotated[int, Count(least=0, most=2**32 - 1)] = 0
    """Of the random numbers that decide to which side the sheet buckles."""

    petsc: Mapping[
        Annotated[str, AfterValidator(_option_name)],
        Annotated[str | int | float | bool, BeforeValidator(_option)],
    ] = Field(default={}, examples=[{"snes_linesearch_type": "basic"}])
    """Any PETSc options, which have the last word."""


FieldName = Literal["displacement", "relative_displacement", "curvature", "shear_angle", "stretch"]


def possible_fields(needs: Needs) -> tuple[FieldName, ...]:
    """Return the fields that make sense for effects with these needs."""
    missing = set()
    if needs.placements == 1:
        missing.add("relative_displacement")
    if not needs.second_gradient:
        missing.add("curvature")
    return tuple(name for name in get_args(FieldName) if name not in missing)


class Output(Section):
    """What is written besides the history."""

    fields: tuple[FieldName, ...] = get_args(FieldName)
    """Fields for ParaView; all that the effects know of unless given."""

    every: AtLeastOne = 10
    """Fields are written every so many steps, at reversals and at the end."""

    pictures: Annotated[bool, Field(strict=True)] = True
    """Whether pictures are drawn at the end."""


class Case(Section):
    """A case of wovenfab. A value is a plain number in SI units or a text with its unit."""

    title: str = Field(default="", examples=["Bias extension 1:3"])
    """One line for people."""

    sheet: Sheet
    """Shape and fibre directions."""

    scene: Annotated[Scene, EffectsSection()] = Field(alias="effects")
    """What the sheet resists and dissipates; what is not listed is not simulated."""

    boundary: Mapping[str, EdgeConditions] = Field(
        examples=[{"left": "clamp", "right": {"displacement": ["program", 0]}}]
    )
    """Condition on each named edge; edges that are not named are free."""

    program: Segments = Field(min_length=1, examples=[{"type": "ramp", "to": "40 mm", "steps": 20}])
    """Displacement against time: one segment, or a list of them."""

    accuracy: Annotated[float | None, Quantity(above=0, most=0.2)] = Field(
        default=None, examples=["1 %"]
    )
    """Largest relative error of the peak force and of the dissipated energy; degree, size of
    cells and steps are then found by the program."""

    discretisation: Discretisation = Discretisation()
    """Elements in space."""

    time: Time = Time()
    """Steps in time."""

    solver: Solver = Solver()
    """Newton's method."""

    output: Output = Output()
    """What is written besides the history."""

    _name: str = PrivateAttr(default="case")

    def model_post_init(self, context: Any, /) -> None:
        """Take the name from the file that is being read."""
        self._name = (context or {}).get("name", "case")

    @property
    def name(self) -> str:
        """Name of the case file without its suffix."""
        return self._name

    @property
    def needs(self) -> Needs:
        """What the effects need together: placements, second gradient, rate."""
        return needs_of_scene(self.scene)

    @property
    def effects(self) -> Mapping[str, Values]:
        """Values by the name of the effect, in the order of the scene."""
        return {e.name: e.values for e in self.scene}
