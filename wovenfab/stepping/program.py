"""The load program: displacement against time, and the times that must be hit."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise
from math import cos, pi

import numpy as np


@dataclass(frozen=True)
class Segment:
    """A stretch of the program between two reversals or kinks, in equal steps.

    Attributes:
        duration: s.
        steps: Number of planned steps.
        path: Displacement (m) against the time since its start (s).
        jump: The velocity jumps at its start.
        starts_cycle: A load cycle starts with it.
        ends_cycle: A load cycle ends with it.
    """

    duration: float
    steps: int
    path: Callable[[float], float]
    jump: bool
    starts_cycle: bool = False
    ends_cycle: bool = False


@dataclass(frozen=True)
class Milestone:
    """A planned time.

    Attributes:
        time: s.
        displacement: m.
        jump: The velocity jumps here.
    """

    time: float
    displacement: float
    jump: bool = False


@dataclass(frozen=True)
class Program:
    """A load program.

    Attributes:
        milestones: Planned times in order, the start included; reversals are among them.
    """

    milestones: tuple[Milestone, ...]
    _stretches: tuple[Segment, ...]

    @cached_property
    def _planned(self) -> dict[float, float]:
        return {m.time: m.displacement for m in self.milestones}

    def displacement(self, time: float) -> float:
        """Return the displacement (m) at a time (s); the end value beyond the end."""
        if time in self._planned:  # bit for bit, which t - start could miss
            return self._planned[time]
        number = bisect_left(self._ends, time)
        if number == len(self._ends):
            return self.milestones[-1].displacement
        return self._stretches[number].path(time - (self._ends[number - 1] if number else 0.0))

    @cached_property
    def _ends(self) -> list[float]:
        return list(accumulate(s.duration for s in self._stretches))

    @property
    def cycles(self) -> list[tuple[float, float]]:
        """Start and end (s) of each load cycle; other segments belong to none."""
        found, begun, time = [], 0.0, 0.0
        for s, end in zip(self._stretches, self._ends, strict=True):
            begun = time if s.starts_cycle else begun
            time = end
            if s.ends_cycle:
                found.append((begun, time))
        return found

    @cached_property
    def reversals(self) -> frozenset[float]:
        """Planned times (s) from which the edge moves the other way; after a hold its end."""
        moves = [
            (start.time, end.displacement > start.displacement)
            for start, end in pairwise(self.milestones)
            if end.displacement != start.displacement
        ]
        return frozenset(time for (_, before), (time, after) in pairwise(moves) if before != after)


def program_of(stretches: Sequence[Segment]) -> Program:
    """Return the program that runs through the stretches one after the other."""
    milestones = [Milestone(0.0, stretches[0].path(0.0), stretches[0].jump)]
    start = 0.0
    for number, s in enumerate(stretches):
        following = stretches[number + 1] if number + 1 < len(stretches) else None
        for i in range(1, s.steps + 1):
            last = i == s.steps
            since = s.duration if last else s.duration * i / s.steps  # the end bit for bit
            milestones.append(
                Milestone(
                    start + since,
                    s.path(since),
                    jump=last and following is not None and following.jump,
                )
            )
        start += s.duration
    return Program(tuple(milestones), tuple(stretches))


def cycle(base: float, amplitude: float, period: float, steps: int) -> list[Segment]:
    """Return one cycle base + A/2 (1 - cos(2 pi t/T)), split at its reversal.

    Args:
        base: Displacement at its start and end, m.
        amplitude: A, m.
        period: T, s.
        steps: Even number of steps.
    """

    def path(offset: float) -> Callable[[float], float]:
        return lambda t: base + amplitude / 2 * (1 - cos(2 * pi * (t + offset) / period))

    half = period / 2
    halves = (Segment(half, steps // 2, path(since), jump=False) for since in (0.0, half))
    return load_cycle(list(halves))


def ramp(start: float, end: float, duration: float, steps: int) -> Segment:
    """Return a ramp at constant velocity (m and s); a hold if both ends are equal."""

    def path(t: float) -> float:
        return end if t >= duration else start + (end - start) * (t / duration)

    return Segment(duration, steps, path, jump=True)


def table(
    start: float,
    times: Sequence[float],
    displacements: Sequence[float],
    divisions: Sequence[int] = (),
) -> list[Segment]:
    """Return one stretch a row of a table, linear in between, beginning at ``start`` (m).

    The velocity counts as jumping where it changes by more than half of the larger
    of its values, as at a corner; not from row to row of a sampled smooth curve.

    Args:
        start: Displacement where it begins, m.
        times: Of the rows, s.
        displacements: Of the rows, m.
        divisions: Number of steps to each row from the one before or the start; one unless given.
    """
    if times[0] > 0:
        times, displacements = (0.0, *times), (start, *displacements)
    velocity = np.diff(displacements) / np.diff(times)
    before = np.concatenate([[0.0], velocity[:-1]])
    jumps = np.abs(velocity - before) > 0.5 * np.maximum(np.abs(velocity), np.abs(before))
    rows = pairwise(zip(times, displacements, strict=True))
    return [
        replace(ramp(d0, d1, t1 - t0, steps), jump=bool(jump))
        for ((t0, d0), (t1, d1)), jump, steps in zip(
            rows, jumps, divisions or (1,) * len(jumps), strict=True
        )
    ]


def load_cycle(stretches: Sequence[Segment]) -> list[Segment]:
    """Return stretches that together are a load cycle."""
    first, *others = stretches
    *between, last = others
    return [replace(first, starts_cycle=True), *between, replace(last, ends_cycle=True)]
