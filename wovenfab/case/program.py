"""The displacement program as data: segments that follow each other in time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

from .files import Samples, read_samples
from .problems import wrong
from .values import AtLeastOne, Duration, Frequency, Length, OneOr, Section, Size, Speed


class Cycles(Section):
    """Cycles from where the last segment ended and back, A/2 (1 - cos(2 pi t/T)) each."""

    type: Literal["cycles"]
    """Kind of segment."""

    amplitudes: Annotated[tuple[Size, ...], OneOr()] = Field(
        min_length=1, examples=[["20 mm", "40 mm"]]
    )
    """Amplitude A of each cycle."""

    max_velocity: Speed | None = None
    """Largest velocity in each cycle, so that T = pi A / velocity."""

    frequency: Frequency | None = None
    """The same for all cycles, so that T = 1 / frequency."""

    @model_validator(mode="after")
    def _one_speed(self) -> Cycles:
        if (self.max_velocity is None) == (self.frequency is None):
            both = "not both" if self.frequency else "got neither"
            raise wrong(
                f"expected either max_velocity or frequency, {both}",
                "For example 'max_velocity: 0.5 m/s'.",
            )
        return self


class Ramp(Section):
    """A straight line in time to a displacement."""

    type: Literal["ramp"]
    """Kind of segment."""

    to: Length = Field(examples=["40 mm"])
    """Displacement at the end."""

    steps: AtLeastOne = 20
    """Number of equal steps."""

    velocity: Speed | None = None
    """Size of the velocity; this or the duration is needed where an effect depends on rates."""

    duration: Duration | None = None
    """How long it takes."""

    @model_validator(mode="after")
    def _one_speed(self) -> Ramp:
        if self.velocity is not None and self.duration is not None:
            raise wrong("expected either velocity or duration, not both")
        return self


class Hold(Section):
    """A rest at the displacement reached."""

    type: Literal["hold"]
    """Kind of segment."""

    duration: Duration = Field(examples=["2 s"])
    """How long it takes."""

    steps: AtLeastOne = 20
    """Number of equal steps."""


class Table(Section):
    """Any displacement against time, linear between the rows, which are the steps."""

    type: Literal["table"]
    """Kind of segment."""

    samples: Annotated[
        Samples,
        BeforeValidator(read_samples, json_schema_input_type=str),
        PlainSerializer(lambda s: str(s.file), return_type=str, when_used="json"),
    ] = Field(alias="file", examples=["u.csv"])
    """CSV file with the columns time_s (from the segment's start) and displacement_m."""


Segment = Annotated[Cycles | Ramp | Hold | Table, Field(discriminator="type")]


def reached(program: Iterable[Segment]) -> list[float]:
    """Return displacements (m) that a program reaches, its turning points among them."""
    found = [0.0]
    for segment in program:
        match segment:
            case Cycles(amplitudes=amplitudes):
                found += [found[-1] + amplitude for amplitude in amplitudes] + [found[-1]]
            case Ramp(to=end):
                found.append(end)
            case Table(samples=samples):
                found += samples.displacements
    return found


def _without_brackets(segments: list[Any]) -> Any:
    return segments[0] if len(segments) == 1 else segments


Segments = Annotated[
    tuple[Segment, ...],
    OneOr(),
    PlainSerializer(
        lambda s: _without_brackets(
            [x.model_dump(mode="json", by_alias=True, exclude_none=True) for x in s]
        ),
        when_used="json",
    ),
]
