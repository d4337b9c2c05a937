"""The displacement program as data: segments that follow each other in time."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationInfo,
    model_validator,
)

from wovenfab.case.document import existing_file, folder_of
from wovenfab.case.errors import KeyPath, describe, one_of, wrong
from wovenfab.case.quantities import (
    AtLeastOne,
    Driven,
    Duration,
    Frequency,
    Json,
    Newtons,
    OneOr,
    Section,
    Speed,
    hide_default,
)

COLUMNS, FORCE = ("time_s", "displacement_m"), "force_N"
#: Where a force is prescribed, the velocity is not known beforehand.
NO_VELOCITY = "a force has a {}, not a velocity"


@dataclass(frozen=True)
class Samples:
    """A displacement program as measured or computed elsewhere.

    Attributes:
        file: The CSV file it was read from.
        times: Strictly increasing, from the start of the segment, s.
        displacements: One for each time, m; they are forces (N) where ``force`` is true.
        force: Whether the column is force_N.
    """

    file: Path
    times: tuple[float, ...]
    displacements: tuple[float, ...]
    force: bool = False


def read_samples(value: Any, info: ValidationInfo) -> Samples:
    """Return the contents of a CSV file with the columns time_s and displacement_m or force_N."""
    path = existing_file(value, folder_of(info), (".csv",))
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            table = csv.DictReader(stream)
            header = [c.strip() for c in table.fieldnames or ()]
            table.fieldnames = header
            force = FORCE in header
            if force and COLUMNS[1] in header:
                raise wrong(f"{value}:1: there are both {COLUMNS[1]} and {FORCE}", "Leave out one.")
            columns = (COLUMNS[0], FORCE) if force else COLUMNS
            if missing := [c for c in columns if c not in header]:
                raise wrong(
                    f"{value}:1: there is no column {one_of(missing)}",
                    f"The first line must be '{','.join(columns)}'.",
                )
            rows = [_row(row, f"{value}:{table.line_num}", columns) for row in table]
    except (UnicodeDecodeError, csv.Error) as error:
        raise wrong(f"{value}: this is not a text file with comma-separated values") from error
    except OSError as error:
        raise wrong(f"{value}: the file cannot be read: {error.strerror}") from error
    if not rows:
        raise wrong(f"{value}: the table is empty")
    if rows[0][0] < 0:
        raise wrong(f"{value}:2: times must not be negative, got {rows[0][0]}")
    times, displacements, places = zip(*rows, strict=True)
    for before, time, place in zip(times, times[1:], places[1:], strict=False):
        if time <= before:
            raise wrong(f"{place}: times must increase, got {time} after {before}")
    return Samples(path, times, displacements, force=force)


def _row(row: dict[str, Any], place: str, columns: Iterable[str]) -> tuple[float, float, str]:
    values = []
    for column in columns:
        try:
            value = float(row[column] or "")
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            got = describe(row[column] or None)
            raise wrong(f"{place}: {column} must be a finite number, got {got}")
        values.append(value)
    return values[0], values[1], place


def _require_type(schema: Json) -> None:
    """Ask for the type in a case file, although Python's classes imply it."""
    schema["required"] = ["type", *schema.get("required", ())]


class _Segment(Section):
    model_config = ConfigDict(json_schema_extra=_require_type)


class Cycles(_Segment):
    """Cycles from where the last segment ended and back, A/2 (1 - cos(2 pi t/T)) each.

    Amplitudes with a unit of force prescribe the force of the driven edge.
    """

    type: Literal["cycles"] = Field(default="cycles", json_schema_extra=hide_default)
    """Kind of segment."""

    amplitudes: Annotated[tuple[Annotated[float, Driven(above=0)], ...], OneOr()] = Field(
        min_length=1, examples=[["20 mm", "40 mm"]]
    )
    """Amplitude A of each cycle."""

    max_velocity: Speed | None = None
    """Largest velocity in each cycle, so that T = pi A / velocity."""

    frequency: Frequency | None = None
    """The same for all cycles, so that T = 1 / frequency."""

    @model_validator(mode="after")
    def _one_speed(self) -> Cycles:
        kinds = {isinstance(amplitude, Newtons) for amplitude in self.amplitudes}
        if len(kinds) > 1:
            raise wrong("amplitudes are either all lengths or all forces", "Use two segments.")
        if kinds == {True} and self.max_velocity is not None:
            raise wrong(NO_VELOCITY.format("frequency"), "For example 'frequency: 1 Hz'.")
        if (self.max_velocity is None) == (self.frequency is None):
            both = "not both" if self.frequency else "got neither"
            raise wrong(
                f"expected either max_velocity or frequency, {both}",
                "For example 'max_velocity: 0.5 m/s'.",
            )
        return self


class Ramp(_Segment):
    """A straight line in time to a displacement or a force."""

    type: Literal["ramp"] = Field(default="ramp", json_schema_extra=hide_default)
    """Kind of segment."""

    to: Annotated[float, Driven()] = Field(examples=["40 mm"])
    """Displacement at the end, or the force of the driven edge."""

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
        if isinstance(self.to, Newtons) and self.velocity is not None:
            raise wrong(NO_VELOCITY.format("duration"), "For example 'duration: 10 s'.")
        return self


class Hold(_Segment):
    """A rest at the displacement or the force reached."""

    type: Literal["hold"] = Field(default="hold", json_schema_extra=hide_default)
    """Kind of segment."""

    duration: Duration = Field(examples=["2 s"])
    """How long it takes."""

    steps: AtLeastOne = 20
    """Number of equal steps."""

    control: Literal["displacement", "force"] | None = None
    """What is held; that which the last segment prescribed unless given."""


class Table(_Segment):
    """Any displacement or force against time, linear between the rows, which are the steps."""

    type: Literal["table"] = Field(default="table", json_schema_extra=hide_default)
    """Kind of segment."""

    samples: Annotated[
        Samples,
        BeforeValidator(read_samples, json_schema_input_type=str),
        PlainSerializer(lambda s: str(s.file), return_type=str, when_used="json"),
    ] = Field(alias="file", examples=["u.csv"])
    """CSV file with the columns time_s (from the segment's start) and displacement_m or force_N."""


Segment = Annotated[Cycles | Ramp | Hold | Table, Field(discriminator="type")]


def prescribe_forces(program: Iterable[Segment]) -> list[bool]:
    """Return of each segment whether it prescribes the force of the driven edge."""
    kinds = [False]
    for segment in program:
        match segment:
            case Cycles(amplitudes=(Newtons(), *_)) | Ramp(to=Newtons()) | Hold(control="force"):
                kinds.append(True)
            case Hold(control=None):
                kinds.append(kinds[-1])
            case _:
                kinds.append(isinstance(segment, Table) and segment.samples.force)
    return kinds[1:]


def reached(program: Sequence[Segment]) -> list[float]:
    """Return displacements (m) that a program prescribes, its turning points among them."""
    values = [0.0]
    for segment, force in zip(program, prescribe_forces(program), strict=True):
        match segment:
            case _ if force:
                continue
            case Cycles(amplitudes=amplitudes):
                values += [values[-1] + amplitude for amplitude in amplitudes] + [values[-1]]
            case Ramp(to=end):
                values.append(end)
            case Table(samples=samples):
                values += samples.displacements
    return values


def joints(program: Sequence[Segment]) -> Iterator[tuple[KeyPath, str, str]]:
    """Yield where segments do not follow each other, and the remedy."""
    here: float | None = 0.0  # None where it is not known beforehand
    before = False
    for i, (segment, force) in enumerate(zip(program, prescribe_forces(program), strict=True)):
        here = here if force == before else None
        what, unit = ("force", "N") if force else ("displacement", "m")
        match segment:
            case Ramp(to=end):
                if end == here:
                    already = f"the {what} is {here:g} {unit} already"
                    yield ("program", i, "to"), already, "Use {type: hold} to wait."
                if here is None and segment.velocity:
                    unknown = "where it starts is not known, since a force was prescribed before"
                    yield ("program", i, "velocity"), unknown, "Give a duration instead."
                here = end
            case Table(samples=samples):
                path, start = ("program", i, "file"), samples.displacements[0]
                if samples.times[0] == 0 and start != here:
                    at = "another one" if here is None else f"{here:g} {unit}"
                    jump = f"the table starts at {start:g} {unit}, where the program is at {at}"
                    yield path, jump, "Give the first row a later time, to ramp to it."
                if samples.times[-1] == 0:
                    yield path, "the table has no row after time zero", ""
                here = samples.displacements[-1]
        before = force


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
