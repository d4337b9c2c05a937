"""The load program: displacement or force against time, and the times that must be hit."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import accumulate, chain, pairwise
from math import ceil, cos, pi

import numpy as np


@dataclass(frozen=True)
class Piece:
    """A part of the program between two reversals or kinks, in equal steps.

    Attributes:
        duration: s.
        steps: Number of planned steps.
        path: Value, a displacement (m) or a force (N), against the time since its start (s) and
            the value that was there when the kind of value last changed.
        jump: The velocity jumps at its start.
        starts_cycle: A load cycle starts with it.
        ends_cycle: A load cycle ends with it.
        force: Its values are forces.
    """

    duration: float
    steps: int
    path: Callable[[float, float], float]
    jump: bool
    starts_cycle: bool = False
    ends_cycle: bool = False
    force: bool = False

    @property
    def ends(self) -> tuple[float, float, float]:
        """Duration (s), and the value at its start and end."""
        return self.duration, self.path(0.0, 0.0), self.path(self.duration, 0.0)


@dataclass(frozen=True)
class Milestone:
    """A planned time.

    Attributes:
        time: s.
        value: Displacement (m) or force (N). Where it depends on the value at a change from one
            to the other, that one counts as zero.
        jump: The velocity jumps here.
    """

    time: float
    value: float
    jump: bool = False


@dataclass(frozen=True)
class Program:
    """A load program, and a second one beside it.

    Attributes:
        milestones: Planned times in order, the start included; reversals are among them.
        beside: The second program, with the same planned times, or None.
    """

    milestones: tuple[Milestone, ...]
    _pieces: tuple[Piece, ...]
    _places: tuple[tuple[Piece, float], ...]  # of the milestones
    beside: Program | None = None

    @cached_property
    def _planned(self) -> dict[float, tuple[Piece, float]]:
        return {m.time: place for m, place in zip(self.milestones, self._places, strict=True)}

    def _place(self, time: float) -> tuple[Piece, float]:
        """Return the piece that leads to a time (s), and the time since its start (s)."""
        if time in self._planned:  # bit for bit, which t - start could miss
            return self._planned[time]
        number = bisect_left(self._ends, time)
        if number == len(self._ends):
            return self._places[-1]
        return self._pieces[number], time - (self._ends[number - 1] if number else 0.0)

    @cached_property
    def _ends(self) -> list[float]:
        return list(accumulate(s.duration for s in self._pieces))

    def value(self, time: float, before: float = 0.0) -> float:
        """Return the displacement (m) or force (N) at a time (s); the end value beyond the end.

        Args:
            time: s.
            before: The value that was there when the program last changed from displacements to
                forces or back.
        """
        piece, since = self._place(time)
        return piece.path(since, before)

    def second(self, time: float) -> float:
        """Return the displacement (m) of the second program at a time (s); zero without one."""
        return self.beside.value(time) if self.beside else 0.0

    def prescribes_force(self, time: float) -> bool:
        """Return whether a force is prescribed on the way to a time (s)."""
        return self._place(time)[0].force

    def same_times(self, other: Program, time: float) -> list[float]:
        """Return the times (s) at which this program is where a shorter one is at a time (s).

        Args:
            other: A program of some of these pieces, such as the largest of several cycles.
            time: s.
        """
        piece, since = other._place(time)
        starts = zip((0.0, *self._ends), self._pieces, strict=False)
        return [start + since for start, s in starts if s.ends == piece.ends]

    @cached_property
    def changes(self) -> dict[float, bool]:
        """Times (s) from which forces are prescribed after displacements (true), or the reverse."""
        time, force, found = 0.0, False, {}
        for s, end in zip(self._pieces, self._ends, strict=True):
            if s.force != force:
                found[time] = s.force
            time, force = end, s.force
        return found

    @cached_property
    def largest_force(self) -> float:
        """The largest planned force, N; zero where none is prescribed."""
        places = zip(self.milestones, self._places, strict=True)
        return max((abs(m.value) for m, (s, _) in places if s.force), default=0.0)

    @property
    def cycles(self) -> list[tuple[float, float]]:
        """Start and end (s) of each load cycle; other pieces belong to none."""
        found, begun, time = [], 0.0, 0.0
        for s, end in zip(self._pieces, self._ends, strict=True):
            begun = time if s.starts_cycle else begun
            time = end
            if s.ends_cycle:
                found.append((begun, time))
        return found

    @cached_property
    def reversals(self) -> frozenset[float]:
        """Planned times (s) from which an edge moves the other way; after a hold its end."""
        moves = []
        for (start, end), (piece, _) in zip(
            pairwise(self.milestones), self._places[1:], strict=True
        ):
            first = piece.path(0.0, 0.0) if start.time in self.changes else start.value
            if end.value != first:
                moves.append((start.time, end.value > first))
        others = self.beside.reversals if self.beside else ()
        own = (time for (_, before), (time, after) in pairwise(moves) if before != after)
        return frozenset((*own, *others))


def program_of(pieces: Sequence[Piece]) -> Program:
    """Return the program that runs through the pieces one after the other."""
    places = [(pieces[0], 0.0)]
    milestones = [Milestone(0.0, pieces[0].path(0.0, 0.0), pieces[0].jump)]
    start = 0.0
    for number, s in enumerate(pieces):
        following = pieces[number + 1] if number + 1 < len(pieces) else None
        for i in range(1, s.steps + 1):
            last = i == s.steps
            since = s.duration if last else s.duration * i / s.steps  # the end bit for bit
            jump = last and following is not None and following.jump
            places.append((s, since))
            milestones.append(Milestone(start + since, s.path(since, 0.0), jump))
        start += s.duration
    return Program(tuple(milestones), tuple(pieces), tuple(places))


#: Relative difference below which two times, two displacements and two numbers of steps are one.
SAME = 1e-9


def side_by_side(*programs: Sequence[Piece], extra: Sequence[float] = ()) -> list[list[Piece]]:
    """Return the pieces of programs beside each other, with the same steps.

    Each end of a piece is a planned time, and so are extra times (s) before the last end.
    Between two of them there are as many equal steps as the finest program asks for. A shorter
    one stays where it ends.

    Args:
        *programs: Pieces of the program, which has the cycles and may prescribe forces (N), and
            of those beside it, displacements (m).
        extra: Times that steps shall end at, too.
    """
    ends = [list(accumulate(s.duration for s in one)) for one in programs]
    whole = max(e[-1] for e in ends)
    times = [0.0]
    for end in sorted(chain(*ends, extra)):
        if times[-1] + SAME * whole < end <= whole:
            times.append(end)
    columns: list[list[Piece]] = [[] for _ in programs]
    for parts in zip(*(_cut(one, times) for one in programs), strict=True):
        steps, jump = max(s.steps for s in parts), any(s.jump for s in parts)
        for column, part in zip(columns, parts, strict=True):
            column.append(replace(part, steps=steps, jump=jump))
    return columns


def _cut(pieces: Sequence[Piece], times: Sequence[float]) -> Iterator[Piece]:
    """Yield pieces cut at times (s) that all their ends are among; a hold after the last."""
    slack, last = SAME * times[-1], pieces[-1]
    ends = list(accumulate(s.duration for s in pieces))
    if (rest := times[-1] - ends[-1]) > slack:
        stay = Piece(rest, 1, lambda _, b: last.path(last.duration, b), True, force=last.force)
        pieces, ends = [*pieces, stay], [*ends, times[-1]]
    for begin, end in pairwise(times):
        number = bisect_left(ends, (begin + end) / 2)
        s, start = pieces[number], ends[number] - pieces[number].duration
        first, final = begin - start <= slack, end >= ends[number] - slack
        since, until = 0.0 if first else begin - start, s.duration if final else end - start
        yield Piece(
            end - begin,
            max(1, ceil(s.steps * (until - since) / s.duration - SAME)),
            partial(_within, s.path, since, until, end - begin),
            first and s.jump,
            first and s.starts_cycle,
            final and s.ends_cycle,
            s.force,
        )


def _within(
    path: Callable[[float, float], float],
    since: float,
    until: float,
    duration: float,
    t: float,
    before: float,
) -> float:
    """Return the value of a path at t (s) within a part of it, which begins and ends exactly."""
    return path(since + t if t < duration else until, before)


def cycle(
    base: float | None, amplitude: float, period: float, steps: int, force: bool = False
) -> list[Piece]:
    """Return one cycle base + A/2 (1 - cos(2 pi t/T)), split at its reversal.

    Args:
        base: Displacement (m) or force (N) at its start and end; None for that which
            was there when the program last changed from displacements to forces or back.
        amplitude: A, m or N.
        period: T, s.
        steps: Even number of steps.
        force: Its values are forces.
    """

    def path(offset: float) -> Callable[[float, float], float]:
        def at(t: float, before: float) -> float:
            start = before if base is None else base
            return start + amplitude / 2 * (1 - cos(2 * pi * (t + offset) / period))

        return at

    half = period / 2
    halves = (Piece(half, steps // 2, path(t), jump=False, force=force) for t in (0.0, half))
    return load_cycle(list(halves))


def ramp(
    start: float | None, end: float | None, duration: float, steps: int, force: bool = False
) -> Piece:
    """Return a straight line in time (s); a hold if both ends (m or N) are equal.

    An end that is None is the value that was there when the program last changed from displacements
    to forces or back.
    """

    def path(t: float, before: float) -> float:
        first, last = (before if value is None else value for value in (start, end))
        return last if t >= duration else first + (last - first) * (t / duration)

    return Piece(duration, steps, path, jump=True, force=force)


def table(
    start: float | None,
    times: Sequence[float],
    values: Sequence[float],
    divisions: Sequence[int] = (),
    force: bool = False,
) -> list[Piece]:
    """Return one piece a row of a table, linear in between, beginning at ``start`` (m or N).

    The velocity counts as jumping where it changes by more than half of the larger
    of its values, as at a corner; not from row to row of a sampled smooth curve, and not where
    forces are prescribed, since friction is then continuous as they are.

    Args:
        start: Displacement (m) or force (N) where it begins; None as in :func:`ramp`.
        times: Of the rows, s.
        values: Displacements (m) or forces (N) of the rows.
        divisions: Number of steps to each row from the one before or the start; one unless given.
        force: The values are forces.
    """
    first: float | None = values[0]
    if times[0] > 0:
        first = start
        times, values = (0.0, *times), (start or 0.0, *values)
    velocity = np.diff(values) / np.diff(times)
    before = np.concatenate([[0.0], velocity[:-1]])
    jumps = np.abs(velocity - before) > 0.5 * np.maximum(np.abs(velocity), np.abs(before))
    starts = [first, *values[1:]]
    divisions = divisions or (1,) * len(jumps)
    rows = zip(pairwise(times), starts, values[1:], jumps, divisions, strict=False)
    return [
        replace(ramp(d0, d1, t1 - t0, steps, force), jump=bool(jump) and not force)
        for (t0, t1), d0, d1, jump, steps in rows
    ]


def load_cycle(pieces: Sequence[Piece]) -> list[Piece]:
    """Return pieces that together are a load cycle."""
    first, *others = pieces
    *between, last = others
    return [replace(first, starts_cycle=True), *between, replace(last, ends_cycle=True)]
