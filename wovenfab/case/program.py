"""The sections of a case on its programs: segments that follow each other in time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    PlainSerializer,
    model_validator,
)
from pydantic_core import core_schema

from wovenfab.case import units
from wovenfab.case.boundary import Boundary, conditions_of
from wovenfab.case.effects import Scene, needs_of_scene
from wovenfab.case.errors import KeyPath, value_error
from wovenfab.case.quantities import (
    AtLeastOne,
    Duration,
    Frequency,
    Json,
    Newtons,
    OneOr,
    Quantity,
    Section,
    Size,
    Speed,
    hide_default,
    is_force,
)
from wovenfab.case.samples import Samples, read_samples
from wovenfab.stepping import segments

if TYPE_CHECKING:
    from wovenfab.case.case import Case
    from wovenfab.case.schema import Solver
    from wovenfab.stepping.program import Program

#: Where, what and the remedy.
Finding = tuple[KeyPath, str, str]
#: Key and variable.
SECOND = "second_program"
#: Where a force is prescribed, the velocity is not known beforehand.
NO_VELOCITY = "a force has a {}, not a velocity"
_Speeds = Annotated[tuple[Speed, ...], Field(min_length=1), OneOr()] | None
_Frequencies = Annotated[tuple[Frequency, ...], Field(min_length=1), OneOr()] | None


@dataclass(frozen=True)
class Driven(Quantity):
    """A displacement, or a force where the text has a unit of force."""

    unit: str = "m"
    usual: tuple[float, float] = (1e-8, 20.0)

    def number(self, value: Any) -> float:
        """Return the SI value, which is of the class ``Newtons`` if it is a force."""
        if is_force(value):
            return Newtons(Quantity(unit="N", above=self.above).number(value))
        return super().number(value)

    def write(self, value: Any) -> Any:
        """Return text with the unit."""
        return units.write(value, "N" if isinstance(value, Newtons) else "m")

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> Json:
        """Describe a displacement and a force."""
        described = super().__get_pydantic_json_schema__(schema, handler)
        described["anyOf"][1]["description"] = "'40 mm', or a force such as '50 N'"
        return described


def _require_type(schema: Json) -> None:
    """Ask for the type in a case file, although Python's classes imply it."""
    schema["required"] = ["type", *schema.get("required", ())]


class _Segment(Section):
    model_config = ConfigDict(json_schema_extra=_require_type)


class CyclesSection(_Segment):
    """Cycles from where the last segment ended and back, A/2 (1 - cos(2 pi t/T)) each.

    Amplitudes with a unit of force prescribe the force that is conjugate to it.
    """

    type: Literal["cycles"] = Field(default="cycles", json_schema_extra=hide_default)
    """Kind of segment."""

    amplitudes: Annotated[tuple[Annotated[float, Driven(above=0)], ...], OneOr()] = Field(
        min_length=1, examples=[["20 mm", "40 mm"]]
    )
    """Amplitude A of each cycle."""

    repeat: AtLeastOne = 1
    """How often all amplitudes are run through, at each velocity or frequency."""

    max_velocity: _Speeds = None
    """Largest velocity in each cycle, so that T = pi A / velocity; all cycles at each of a list."""

    frequency: _Frequencies = None
    """The same for all cycles, so that T = 1 / frequency; all cycles at each of a list."""

    @model_validator(mode="after")
    def _one_speed(self) -> CyclesSection:
        kinds = {isinstance(amplitude, Newtons) for amplitude in self.amplitudes}
        if len(kinds) > 1:
            raise value_error(
                "amplitudes are either all lengths or all forces", "Use two segments."
            )
        if kinds == {True} and self.max_velocity is not None:
            raise value_error(NO_VELOCITY.format("frequency"), "For example 'frequency: 1 Hz'.")
        if (self.max_velocity is None) == (self.frequency is None):
            both = "not both" if self.frequency else "got neither"
            raise value_error(
                f"expected either max_velocity or frequency, {both}",
                "For example 'max_velocity: 0.5 m/s'.",
            )
        return self

    def segment(self, per_cycle: int) -> segments.Cycles:
        """Return the segment, with so many steps in each cycle."""
        return segments.Cycles(
            self.amplitudes,
            self.max_velocity or (),
            self.frequency or (),
            self.repeat,
            per_cycle,
            isinstance(self.amplitudes[0], Newtons),
        )


class RampSection(_Segment):
    """A straight line in time to a displacement or a force."""

    type: Literal["ramp"] = Field(default="ramp", json_schema_extra=hide_default)
    """Kind of segment."""

    to: Annotated[float, Driven()] = Field(examples=["40 mm"])
    """Displacement at the end, or the force that is conjugate to it."""

    steps: AtLeastOne = 20
    """Number of equal steps."""

    velocity: Speed | None = None
    """Size of the velocity; this or the duration is needed where an effect depends on rates."""

    duration: Duration | None = None
    """How long it takes."""

    @model_validator(mode="after")
    def _one_speed(self) -> RampSection:
        if self.velocity is not None and self.duration is not None:
            raise value_error("expected either velocity or duration, not both")
        if isinstance(self.to, Newtons) and self.velocity is not None:
            raise value_error(NO_VELOCITY.format("duration"), "For example 'duration: 10 s'.")
        return self

    def segment(self, per_cycle: int) -> segments.Ramp:
        """Return the segment; steps of cycles do not matter."""
        force = isinstance(self.to, Newtons)
        return segments.Ramp(self.to, self.steps, self.duration, self.velocity, force)


class HoldSection(_Segment):
    """A rest at the displacement or the force reached."""

    type: Literal["hold"] = Field(default="hold", json_schema_extra=hide_default)
    """Kind of segment."""

    duration: Duration = Field(examples=["2 s"])
    """How long it takes."""

    steps: AtLeastOne = 20
    """Number of equal steps."""

    control: Literal["displacement", "force"] | None = None
    """What is held; that which the last segment prescribed unless given."""

    def segment(self, per_cycle: int) -> segments.Hold:
        """Return the segment; steps of cycles do not matter."""
        force = None if self.control is None else self.control == "force"
        return segments.Hold(self.duration, self.steps, force)


class TrapezoidSection(_Segment):
    """A ramp to a displacement, a hold, the ramp back and, if asked for, a rest: a load cycle."""

    type: Literal["trapezoid"] = Field(default="trapezoid", json_schema_extra=hide_default)
    """Kind of segment."""

    to: Annotated[float, Driven()] = Field(examples=["40 mm"])
    """Displacement of the hold."""

    velocity: Speed = Field(examples=["0.1 m/s"])
    """Size of the velocity there and back."""

    hold: Duration = Field(examples=["2 s"])
    """How long it stays there."""

    rest: Duration | None = None
    """How long it then rests where it started; not at all unless given."""

    repeat: AtLeastOne = 1
    """How often all of it is done."""

    steps: AtLeastOne = 20
    """Number of equal steps of each ramp, hold and rest."""

    @model_validator(mode="before")
    @classmethod
    def _no_force(cls, data: Any) -> Any:
        if isinstance(data, dict) and is_force(data.get("to")):  # before its keys are asked for
            remedy = "Write two ramps with a duration and a hold between them."
            raise value_error("a trapezoid goes to a displacement, not to a force", remedy)
        return data

    def segment(self, per_cycle: int) -> segments.Trapezoid:
        """Return the segment; steps of cycles do not matter."""
        return segments.Trapezoid(
            self.to, self.velocity, self.hold, self.rest, self.repeat, self.steps
        )


class TableSection(_Segment):
    """Any displacement or force against time, linear between the rows, which are the steps."""

    type: Literal["table"] = Field(default="table", json_schema_extra=hide_default)
    """Kind of segment."""

    tolerance: Size | None = Field(default=None, examples=["0.1 mm"])
    """The rows become the fewest straight pieces that are this close to them at any time; where
    the motion reverses by more than this, the rows are kept."""

    steps: AtLeastOne | None = None
    """Straight pieces that take longer than this part of the whole are divided in equal steps."""

    samples: Annotated[
        Samples,
        BeforeValidator(read_samples, json_schema_input_type=str),
        PlainSerializer(lambda s: str(s.file), return_type=str, when_used="json"),
    ] = Field(alias="file", examples=["u.csv"])
    """CSV file with the columns time_s (from the segment's start) and displacement_m or force_N."""

    def segment(self, per_cycle: int) -> segments.Table:
        """Return the segment; steps of cycles do not matter."""
        samples = self.samples
        return segments.Table(samples.times, samples.values, self.steps, samples.force)


SegmentSection = Annotated[
    CyclesSection | RampSection | HoldSection | TrapezoidSection | TableSection,
    Field(discriminator="type"),
]


def segments_of(program: Iterable[SegmentSection], per_cycle: int = 2) -> list[segments.Segment]:
    """Return the segments that sections describe, with so many steps in each cycle."""
    return [section.segment(per_cycle) for section in program]


def prescribe_forces(program: Iterable[SegmentSection]) -> list[bool]:
    """Return of each segment whether it prescribes a force, which is conjugate to it."""
    return segments.prescribe_forces(segments_of(program))


def reached(program: Iterable[SegmentSection]) -> list[float]:
    """Return displacements (m) that a program prescribes, and turning points."""
    return segments.reached(segments_of(program))


def program_of_case(case: Case) -> Program:
    """Return the load program of a case, with the second one if it has one."""
    first, second, times = _plan(case)
    return segments.program(*first, second=second, extra_times=times)


def steps_of_case(case: Case) -> int:
    """Return the number of planned steps of a case."""
    return sum(piece.steps for piece in segments.pieces_of(*_plan(case))[0])


def _plan(case: Case) -> tuple[list[segments.Segment], list[segments.Segment], tuple[float, ...]]:
    first, *second = (segments_of(p, case.time.steps_per_cycle) for p in case.programs.values())
    return first, second[0] if second else [], case.time.extra_times


def joints(program: Sequence[SegmentSection]) -> Iterator[Finding]:
    """Yield where segments do not follow each other, and the remedy."""
    here: float | None = 0.0  # None where it is not known beforehand
    before = False
    for i, (segment, force) in enumerate(zip(program, prescribe_forces(program), strict=True)):
        here = here if force == before else None
        what, unit = ("force", "N") if force else ("displacement", "m")
        match segment:
            case RampSection(to=end) | TrapezoidSection(to=end):
                if end == here:
                    already = f"the {what} is {here:g} {unit} already"
                    yield ("program", i, "to"), already, "Use {type: hold} to wait."
                if here is None and segment.velocity:
                    unknown = "where it starts is not known, since a force was prescribed before"
                    remedy = "Ramp to a displacement first."
                    if isinstance(segment, RampSection):
                        remedy = "Give a duration instead."
                    yield ("program", i, "velocity"), unknown, remedy
                here = here if isinstance(segment, TrapezoidSection) else end
            case TableSection(samples=samples):
                path, start = ("program", i, "file"), samples.values[0]
                if samples.times[0] == 0 and start != here:
                    at = "another one" if here is None else f"{here:g} {unit}"
                    jump = f"the table starts at {start:g} {unit}, where the program is at {at}"
                    yield path, jump, "Give the first row a later time, to ramp to it."
                if samples.times[-1] == 0:
                    yield path, "the table has no row after time zero", ""
                here = samples.values[-1]
        before = force


def force_control(
    boundary: Boundary, program: Sequence[SegmentSection], solver: Solver, accuracy: float | None
) -> Iterator[Finding]:
    """Yield why a program of forces cannot be, and the remedy."""
    forces, instead = prescribe_forces(program), "Leave this key out, or prescribe displacements."
    if not any(forces):
        return
    if not any(c.moves for _, _, c in conditions_of(boundary)):
        remedy = "For example 'right: {displacement: [program, 0]}' in boundary."
        yield ("program", forces.index(True)), "no edge moves to attain the force", remedy
    if solver.stability == "follow":
        yield ("solver", "stability"), "branches under a prescribed force are unstable", instead
    if accuracy is not None and not all(forces):
        reason = "errors are estimated where all of the program is of one kind"
        yield (
            ("accuracy",),
            reason,
            "Leave this key out, or prescribe displacements or forces only.",
        )


def speeds(scene: Scene, program: Sequence[SegmentSection]) -> Iterator[Finding]:
    """Yield ramps that take no time where an effect depends on rates."""
    for i, segment in enumerate(program):
        timeless = isinstance(segment, RampSection) and not (segment.velocity or segment.duration)
        if timeless and needs_of_scene(scene).rate:
            what = "a velocity or a duration is needed, because an effect depends on rates"
            yield ("program", i), what, "For example 'velocity: 0.1 m/s', or 'duration: 1 s'."


def second(
    scene: Scene,
    boundary: Boundary,
    second_program: Sequence[SegmentSection] | None,
    accuracy: float | None,
) -> Iterator[Finding]:
    """Yield what is wrong in or with a second program, and the remedy."""
    if second_program is None:
        for name, i, condition in conditions_of(boundary):
            if SECOND in condition.follows:
                remedy = f"For example '{SECOND}: {{type: ramp, to: 10 mm, duration: 1 s}}'."
                yield ("boundary", name, i), f"follows {SECOND}, which the case has not got", remedy
        return
    for (_, *rest), what, remedy in (*joints(second_program), *speeds(scene, second_program)):
        yield (SECOND, *rest), what, remedy
    if any(forces := prescribe_forces(second_program)):
        remedy = "Let 'program' prescribe the force."
        yield (SECOND, forces.index(True)), "prescribes displacements only, no force", remedy
    if not any(SECOND in c.follows for _, _, c in conditions_of(boundary)):
        remedy = f"For example 'top: {{displacement: [free, {SECOND}]}}' in boundary."
        yield (SECOND,), "no edge uses it", remedy
    if accuracy is not None:
        reason = "steps are chosen for one program only"
        yield ("accuracy",), reason, f"Leave this key out, or '{SECOND}'."


def planned_steps(program: Iterable[SegmentSection], per_cycle: int) -> int:
    """Return the number of planned steps, with ``per_cycle`` steps in each cycle."""
    return sum(segment.planned for segment in segments_of(program, per_cycle))


def _without_brackets(segments: list[Any]) -> Any:
    return segments[0] if len(segments) == 1 else segments


Segments = Annotated[
    tuple[SegmentSection, ...],
    OneOr(),
    PlainSerializer(
        lambda s: _without_brackets(
            [x.model_dump(mode="json", by_alias=True, exclude_none=True) for x in s]
        ),
        when_used="json",
    ),
]
