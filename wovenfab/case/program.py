"""The displacement program as data: segments that follow each other in time."""

from __future__ import annotations

import csv
import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, zip_longest
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
    Length,
    Newtons,
    OneOr,
    Section,
    Size,
    Speed,
    hide_default,
)

COLUMNS, FORCE = ("time_s", "displacement_m"), "force_N"
#: Where a force is prescribed, the velocity is not known beforehand.
NO_VELOCITY = "a force has a {}, not a velocity"
_Speeds = Annotated[tuple[Speed, ...], Field(min_length=1), OneOr()] | None
_Frequencies = Annotated[tuple[Frequency, ...], Field(min_length=1), OneOr()] | None


@dataclass(frozen=True)
class Samples:
    """A displacement program as measured or computed elsewhere.

    Attributes:
        file: The CSV file it was read from.
        times: Strictly increasing, from the start of the segment, s.
        displacements: One for each time, m; they are forces (N) where ``force`` is true.
        rows: Number of rows of the file; more than there are times where it was thinned.
        force: Whether the column is force_N.
    """

    file: Path
    times: tuple[float, ...]
    displacements: tuple[float, ...]
    rows: int
    force: bool = False


def read_samples(value: Any, info: ValidationInfo) -> Samples:
    """Return the contents of a CSV file with the columns time_s and displacement_m or force_N.

    A tolerance that is read before thins them.
    """
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
    if tolerance := info.data.get("tolerance"):
        if force:
            raise wrong(
                f"{value}: a tolerance is a length, and the column is {FORCE}", "Leave it out."
            )
        corners = thinned(list(zip(times, displacements, strict=True)), tolerance)
        times, displacements = zip(*corners, strict=True)
    return Samples(path, times, displacements, len(rows), force)


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


Point = tuple[float, float]


def thinned(rows: Sequence[Point], tolerance: float) -> list[Point]:
    """Return the corners of the fewest straight pieces that are close to rows, in linear time.

    Both ends, and the rows where the motion reverses by more than the tolerance, are corners.

    Args:
        rows: Times, strictly increasing, and displacements.
        tolerance: Largest distance of the displacements at any time.
    """
    turns = _turns([displacement for _, displacement in rows], tolerance)
    parts = (_straightened(rows[a : b + 1], tolerance) for a, b in pairwise(turns))
    return [rows[0], *(corner for part in parts for corner in part)]


def _turns(values: Sequence[float], least: float) -> list[int]:
    """Return which values are the ends, or where the way turns back by more than ``least``."""
    found, ahead = {0, len(values) - 1}, 0
    farthest = {1: 0, -1: 0}  # the highest and the lowest value since the last turn
    for i, value in enumerate(values):
        farthest = {s: i if s * value > s * values[far] else far for s, far in farthest.items()}
        for s, far in farthest.items():
            if ahead != -s and s * (values[far] - value) > least:
                found.add(far)
                ahead, farthest = -s, {s: far, -s: i}
                break
    return sorted(found)


def _straightened(rows: Sequence[Point], tolerance: float) -> list[Point]:
    """Return the corners after the first row of the fewest straight pieces between two rows.

    Each piece passes gates about the rows and goes as far as any line can. H. Imai, M. Iri: An
    optimal algorithm for approximating a piecewise linear function. J. Inf. Process. 9 (1986).
    Below, side 1 is above the rows, side -1 below them.
    """
    first, *_, last = rows
    # Of each side: hull of what lines must not cross, and the steepest line to that side that is
    # possible, by where it touches the other side, then this one, and its slope.
    hulls = {side: deque([first]) for side in (1, -1)}
    steepest = {side: (first, first, side * math.inf) for side in (1, -1)}
    gate, pieces, windows = {1: first, -1: first}, [], []
    for t, displacement in rows[1:]:
        width = 0.0 if t == last[0] else tolerance
        before, gate = gate, {side: (t, displacement + side * width) for side in (1, -1)}
        over = {s: s * (_at(steepest[-s], t) - gate[s][1]) for s in (1, -1)}
        s = max(over, key=over.__getitem__)
        if over[s] > 1e-9 * tolerance:  # no line passes: the last one leaves on this side
            foot, tip, slope = line = steepest[-s]
            room = s * (before[s][1] - _at(line, before[s][0]))
            u, v, share = before[s], gate[s], room / (room + over[s])
            leaves = u[0] + share * (v[0] - u[0]), u[1] + share * (v[1] - u[1])
            pieces.append((foot, slope))
            windows.append((tip[0], leaves[0]))
            while hulls[-s][0] != tip:
                hulls[-s].popleft()
            hulls[s] = deque([leaves])
            steepest = {s: (tip, leaves, slope), -s: (leaves, leaves, -s * math.inf)}
        for s in (1, -1):
            if s * (_at(steepest[s], t) - gate[s][1]) > 0:
                other = hulls[-s]
                while (
                    len(other) > 1
                    and s * (_rise(other[1], gate[s]) - _rise(other[0], gate[s])) <= 0
                ):
                    other.popleft()
                steepest[s] = other[0], gate[s], _rise(other[0], gate[s])
        for s in (1, -1):
            own = hulls[s]
            while len(own) > 1 and s * (_rise(own[-1], gate[s]) - _rise(own[-2], own[-1])) < 0:
                own.pop()
            own.append(gate[s])
    pieces.append((last, steepest[1][2]))
    corners = []
    for ((t, u1), a), ((t2, u2), b), window in zip(pieces, pieces[1:], windows, strict=False):
        low, high = window
        meet = min(max((u2 - b * t2 - u1 + a * t) / (a - b), low), high)
        corners.append((meet, u1 + a * (meet - t)))
    return [*corners, last]


def _at(line: tuple[Point, Point, float], t: float) -> float:
    return line[0][1] + line[2] * (t - line[0][0])


def _rise(a: Point, b: Point) -> float:
    return (b[1] - a[1]) / (b[0] - a[0])


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

    repeat: AtLeastOne = 1
    """How often all amplitudes are run through, at each velocity or frequency."""

    max_velocity: _Speeds = None
    """Largest velocity in each cycle, so that T = pi A / velocity; all cycles at each of a list."""

    frequency: _Frequencies = None
    """The same for all cycles, so that T = 1 / frequency; all cycles at each of a list."""

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

    @property
    def count(self) -> int:
        """Number of cycles."""
        return len(self.amplitudes) * self.repeat * len(self.max_velocity or self.frequency or ())

    def turns(self) -> Iterator[tuple[float, float]]:
        """Yield amplitude (m) and period (s) of each cycle."""
        for velocity, frequency in zip_longest(self.max_velocity or (), self.frequency or ()):
            for amplitude in self.amplitudes * self.repeat:
                yield amplitude, 1 / frequency if frequency else math.pi * amplitude / velocity


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


class Trapezoid(_Segment):
    """A ramp to a displacement, a hold, the ramp back and, if asked for, a rest: a load cycle."""

    type: Literal["trapezoid"] = Field(default="trapezoid", json_schema_extra=hide_default)
    """Kind of segment."""

    to: Length = Field(examples=["40 mm"])
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

    def parts(self, start: float) -> tuple[Ramp | Hold, ...]:
        """Return the segments that it is short for, once."""
        more: Any = {"steps": self.steps, "velocity": self.velocity}
        there, back = (Ramp.model_construct(to=to, **more) for to in (self.to, start))
        durations = filter(None, (self.hold, self.rest))
        first, *rest = (Hold.model_construct(duration=d, steps=self.steps) for d in durations)
        return there, first, back, *rest


class Table(_Segment):
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

    @property
    def divisions(self) -> tuple[int, ...]:
        """Number of equal steps to each row from the one before, or from the start."""
        times = self.samples.times
        pieces = [after - before for before, after in pairwise((0.0, *times)) if after > 0]
        longest = times[-1] / self.steps * (1 + 1e-9) if self.steps else math.inf
        return tuple(max(1, math.ceil(piece / longest)) for piece in pieces)


Segment = Annotated[Cycles | Ramp | Hold | Trapezoid | Table, Field(discriminator="type")]


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


def reached(program: Sequence[Segment], start: float = 0.0) -> list[float]:
    """Return displacements (m) that a program prescribes from a start, and turning points."""
    values = [start]
    for segment, force in zip(program, prescribe_forces(program), strict=True):
        start = values[-1]
        match segment:
            case _ if force:
                continue
            case Cycles(amplitudes=amplitudes):
                values += [*(start + amplitude for amplitude in amplitudes), start]
            case Ramp(to=end):
                values.append(end)
            case Trapezoid(to=end):
                values += [end, start]
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
            case Ramp(to=end) | Trapezoid(to=end):
                if end == here:
                    already = f"the {what} is {here:g} {unit} already"
                    yield ("program", i, "to"), already, "Use {type: hold} to wait."
                if here is None and segment.velocity:
                    unknown = "where it starts is not known, since a force was prescribed before"
                    yield ("program", i, "velocity"), unknown, "Give a duration instead."
                here = here if isinstance(segment, Trapezoid) else end
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


def planned_steps(program: Iterable[Segment], per_cycle: int) -> int:
    """Return the number of planned steps, with ``per_cycle`` steps in each cycle."""
    return sum(_planned(segment, per_cycle) for segment in program)


def _planned(segment: Segment, per_cycle: int) -> int:
    match segment:
        case Cycles(count=count):
            return count * per_cycle
        case Trapezoid(steps=steps, repeat=repeat, rest=rest):
            return repeat * steps * (4 if rest else 3)
        case Table(divisions=divisions):
            return sum(divisions)
    return segment.steps


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
