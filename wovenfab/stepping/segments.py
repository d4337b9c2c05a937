"""The kinds of segments of a load program, and programs made of them.

Each segment begins where the one before it ended. Values are displacements (m), or forces (N)
where ``force`` is true: the force that is conjugate to the program.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, zip_longest
from math import ceil, inf, pi

from wovenfab.stepping.program import (
    Piece,
    Program,
    cycle,
    load_cycle,
    program_of,
    ramp,
    side_by_side,
    table,
)


@dataclass(frozen=True)
class Cycles:
    """Cycles A/2 (1 - cos(2 pi t/T)) from where the last segment ended and back.

    All amplitudes are run through at each velocity or frequency.

    Attributes:
        amplitudes: A of each cycle, m or N.
        max_velocity: Largest velocities, m/s, so that T = pi A / velocity.
        frequency: Frequencies, Hz, so that T = 1 / frequency; in place of velocities.
        repeat: How often all amplitudes are run through.
        steps: Even number of steps of each cycle.
        force: Amplitudes are forces; they need a frequency.
    """

    amplitudes: Sequence[float]
    max_velocity: Sequence[float] = ()
    frequency: Sequence[float] = ()
    repeat: int = 1
    steps: int = 80
    force: bool = False

    def __post_init__(self) -> None:
        """Refuse cycles without a period."""
        if bool(self.max_velocity) == bool(self.frequency):
            raise ValueError("cycles need either velocities or frequencies")
        if self.steps < 2 or self.steps % 2:
            raise ValueError(f"a cycle has an even number of steps, not {self.steps}")

    @property
    def count(self) -> int:
        """Number of cycles."""
        return len(self.amplitudes) * self.repeat * len(self.max_velocity or self.frequency)

    @property
    def planned(self) -> int:
        """Number of planned steps."""
        return self.count * self.steps

    def turns(self) -> Iterator[tuple[float, float]]:
        """Yield amplitude (m or N) and period (s) of each cycle."""
        for velocity, frequency in zip_longest(self.max_velocity, self.frequency):
            for amplitude in tuple(self.amplitudes) * self.repeat:
                yield amplitude, 1 / frequency if frequency else pi * amplitude / velocity

    def pieces(self, start: float | None, force: bool) -> tuple[list[Piece], float | None]:
        """Return its pieces from a start (m or N; None if unknown), and the value at its end."""
        turns = (cycle(start, a, period, self.steps, force) for a, period in self.turns())
        return [piece for turn in turns for piece in turn], start

    def reached(self, start: float) -> list[float]:
        """Return the values (m or N) at its turning points and at its end."""
        return [*(start + amplitude for amplitude in self.amplitudes), start]


@dataclass(frozen=True)
class Ramp:
    """A straight line in time.

    Attributes:
        to: Value at its end, m or N.
        steps: Number of equal steps.
        duration: s; 1 s unless this or a velocity is given.
        velocity: Size of the velocity, m/s, in place of the duration.
        force: The value is a force.
    """

    to: float
    steps: int = 20
    duration: float | None = None
    velocity: float | None = None
    force: bool = False

    @property
    def planned(self) -> int:
        """Number of planned steps."""
        return self.steps

    def pieces(self, start: float | None, force: bool) -> tuple[list[Piece], float | None]:
        """Return its pieces from a start (m or N; None if unknown), and the value at its end."""
        duration = self.duration or 1.0
        if self.velocity and start is not None:
            duration = abs(self.to - start) / self.velocity
        return [ramp(start, self.to, duration, self.steps, force)], self.to

    def reached(self, start: float) -> list[float]:
        """Return the value (m or N) at its end."""
        return [self.to]


@dataclass(frozen=True)
class Hold:
    """A rest at the value reached.

    Attributes:
        duration: s.
        steps: Number of equal steps.
        force: Whether the force is held, or the displacement; None for what the segment before
            it has prescribed.
    """

    duration: float
    steps: int = 20
    force: bool | None = None

    @property
    def planned(self) -> int:
        """Number of planned steps."""
        return self.steps

    def pieces(self, start: float | None, force: bool) -> tuple[list[Piece], float | None]:
        """Return its pieces from a start (m or N; None if unknown), and the value at its end."""
        return [ramp(start, start, self.duration, self.steps, force)], start

    def reached(self, start: float) -> list[float]:
        """Return no further value."""
        return []


@dataclass(frozen=True)
class Trapezoid:
    """A ramp to a displacement, a hold, the ramp back and, if asked for, a rest: a load cycle.

    Attributes:
        to: Displacement of the hold, m.
        velocity: Size of the velocity there and back, m/s.
        hold: How long it stays there, s.
        rest: How long it then rests where it started, s; not at all if None.
        repeat: How often all of it is done.
        steps: Number of equal steps of each ramp, hold and rest.
    """

    to: float
    velocity: float
    hold: float
    rest: float | None = None
    repeat: int = 1
    steps: int = 20
    force = False

    @property
    def planned(self) -> int:
        """Number of planned steps."""
        return self.repeat * self.steps * (4 if self.rest else 3)

    def pieces(self, start: float | None, force: bool) -> tuple[list[Piece], float | None]:
        """Return its pieces from a start (m), and the displacement at its end.

        Raises:
            ValueError: The start is not known, since a force was prescribed before.
        """
        if start is None:
            raise ValueError("a trapezoid must not follow a prescribed force")
        there, back = (Ramp(to, self.steps, velocity=self.velocity) for to in (self.to, start))
        holds = [Hold(duration, self.steps) for duration in (self.hold, self.rest) if duration]
        once: list[Piece] = []
        position: float | None = start
        parts: list[Ramp | Hold] = [there, holds[0], back, *holds[1:]]
        for part in parts:
            added, position = part.pieces(position, force)
            once += added
        return load_cycle(once) * self.repeat, start

    def reached(self, start: float) -> list[float]:
        """Return the displacements (m) at its turning point and at its end."""
        return [self.to, start]


@dataclass(frozen=True)
class Table:
    """Values against time, linear in between; the rows are the steps.

    Attributes:
        times: Of the rows from the start of the segment, s, strictly increasing.
        values: Of the rows, m or N.
        steps: Rows farther apart than the whole time over this are divided in equal steps.
        force: Values are forces.
    """

    times: Sequence[float]
    values: Sequence[float]
    steps: int | None = None
    force: bool = False

    @property
    def divisions(self) -> tuple[int, ...]:
        """Number of equal steps to each row from the one before, or from the start."""
        spans = [after - before for before, after in pairwise((0.0, *self.times)) if after > 0]
        longest = self.times[-1] / self.steps * (1 + 1e-9) if self.steps else inf
        return tuple(max(1, ceil(span / longest)) for span in spans)

    @property
    def planned(self) -> int:
        """Number of planned steps."""
        return sum(self.divisions)

    def pieces(self, start: float | None, force: bool) -> tuple[list[Piece], float | None]:
        """Return its pieces from a start (m or N; None if unknown), and the value at its end."""
        return table(start, self.times, self.values, self.divisions, force), self.values[-1]

    def reached(self, start: float) -> list[float]:
        """Return the values (m or N) of its rows."""
        return list(self.values)


Segment = Cycles | Ramp | Hold | Trapezoid | Table


def prescribe_forces(segments: Sequence[Segment]) -> list[bool]:
    """Return of each segment whether it prescribes a force."""
    kinds = [False]
    for segment in segments:
        kinds.append(kinds[-1] if segment.force is None else segment.force)
    return kinds[1:]


def reached(segments: Sequence[Segment], start: float = 0.0) -> list[float]:
    """Return displacements (m) that segments prescribe from a start, and turning points."""
    values = [start]
    for segment, force in zip(segments, prescribe_forces(segments), strict=True):
        values += [] if force else segment.reached(values[-1])
    return values


def program(
    *segments: Segment, second: Sequence[Segment] = (), extra_times: Sequence[float] = ()
) -> Program:
    """Return the load program of segments that follow each other.

    Args:
        *segments: The first one begins at zero displacement.
        second: Segments of a second program beside it, of displacements.
        extra_times: Times since the start at which steps end, too, s.
    """
    first, *others = map(program_of, pieces_of(segments, second, extra_times))
    return replace(first, beside=others[0]) if others else first


def pieces_of(
    segments: Sequence[Segment], second: Sequence[Segment] = (), extra_times: Sequence[float] = ()
) -> list[list[Piece]]:
    """Return the pieces of a program and of that beside it, if any, which take the same steps.

    Arguments are those of :func:`program`.
    """
    plans = [_pieces(some) for some in (segments, second) if some]
    if extra_times or len(plans) > 1:
        return side_by_side(*plans, extra=extra_times)
    return plans


def _pieces(segments: Sequence[Segment]) -> list[Piece]:
    """Return the pieces of segments, each of which starts where the last one ended."""
    pieces: list[Piece] = []
    position: float | None = 0.0
    before = False
    for segment, force in zip(segments, prescribe_forces(segments), strict=True):
        position = position if force == before else None
        added, position = segment.pieces(position, force)
        pieces, before = pieces + added, force
    return pieces
