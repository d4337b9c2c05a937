"""The errors of a case's answers: from elements and from steps, each measured by itself.

Both parts add up to leading order. That of the elements is found with few steps, from three
degrees on the mesh of the case; that of the steps from half as many steps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.case import Case
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.assemble import scheme_of
from wovenfab.simulation.trace import Trace, discretised, keeps_its_steps, paced, steps_in, trace_of
from wovenfab.study.extrapolate import error_of_degrees, error_of_steps

Array = NDArray[np.float64]
Tell = Callable[[str], None]
#: Share of the steps of a case that is enough to compare elements.
FEW = 0.25


@dataclass(frozen=True)
class Error:
    """The error of one figure.

    Attributes:
        value: The figure.
        space: Part of the elements, signed, in its unit.
        time: Part of the steps, signed; None where they cannot be changed.
    """

    value: float
    space: float
    time: float | None

    @property
    def size(self) -> float:
        """Size of both parts together; they might add up."""
        return abs(self.space) + abs(self.time or 0.0)

    @property
    def relative(self) -> float | None:
        """Size over the figure; None where that is zero."""
        return self.size / abs(self.value) if self.value else None

    def as_dict(self) -> dict[str, float | None]:
        """Return the parts by name for the summary."""
        return {
            "value": self.value,
            "error": self.size,
            "error_of_elements": self.space,
            "error_of_steps": self.time,
            "relative_error": self.relative,
        }


@dataclass(frozen=True)
class Ladder:
    """Answers from three degrees on one mesh, with the same few steps.

    Attributes:
        degrees: The degrees, one after another.
        traces: The answers.
    """

    degrees: tuple[int, ...]
    traces: tuple[Trace, ...]

    def errors(self, degree: int) -> dict[str, float]:
        """Return the error of each figure with elements of one of the degrees."""
        place = self.degrees.index(degree)
        figures = [t.figures for t in self.traces]
        return {
            name: error_of_degrees(self.degrees, [f[name] for f in figures])[place]
            for name in figures[0]
        }


@dataclass(frozen=True)
class Pair:
    """Answers from two numbers of steps with the same elements.

    Attributes:
        steps: The fewer, the more.
        traces: The answers.
        order: Order of the scheme.
    """

    steps: tuple[int, int]
    traces: tuple[Trace, Trace]
    order: int

    def errors(self) -> dict[str, float]:
        """Return the error of each figure with more steps."""
        fewer, more = (t.figures for t in self.traces)
        return {
            name: error_of_steps(self.steps, (fewer[name], more[name]), self.order)[1]
            for name in more
        }


def degrees_around(case: Case) -> tuple[int, int, int]:
    """Return three degrees, that of the case among them and not the last."""
    least = 2 if case.needs.second_gradient else 1
    first = max(least, case.discretisation.degree - 1)
    return first, first + 1, first + 2


def ladder_of(case: Case, sheet: Sheet, tell: Tell) -> Ladder:
    """Return the answers of a case from three degrees around its own; collective."""
    few, degrees = paced(case, FEW), degrees_around(case)
    traces = []
    for degree in degrees:
        tell(f"estimating the error of the elements: degree {degree}, {steps_in(few)} steps")
        traces.append(trace_of(discretised(few, degree=degree), sheet))
    return Ladder(degrees, tuple(traces))


def pair_of(case: Case, sheet: Sheet, tell: Tell) -> Pair | None:
    """Return the answers of a case from half its steps and from all; collective.

    None where nothing depends on history, or the program fixes its steps.
    """
    if not case.needs.history or keeps_its_steps(case):
        return None
    cases = paced(case, 0.5), case
    counts = steps_in(cases[0]), steps_in(case)
    if counts[0] == counts[1]:
        return None
    traces = []
    for c, n in zip(cases, counts, strict=True):
        tell(f"estimating the error of the steps: {n} steps")
        traces.append(trace_of(c, sheet))
    return Pair(counts, (traces[0], traces[1]), scheme_of(case).order)


@dataclass(frozen=True)
class Estimate:
    """The errors of a case and where they come from.

    Attributes:
        errors: By the name of the figure.
        ladder: Answers from three degrees.
        pair: Answers from two numbers of steps, or None.
        degree: Degree of the elements of the case.
    """

    errors: Mapping[str, Error]
    ladder: Ladder
    pair: Pair | None
    degree: int

    def as_dict(self) -> dict[str, Any]:
        """Return the errors for the summary; figures that are zero have none."""
        return {name: e.as_dict() for name, e in self.errors.items() if e.value}

    @property
    def worst(self) -> float:
        """The largest relative error of all figures."""
        return max((e.relative for e in self.errors.values() if e.relative is not None), default=0)

    def history(self) -> dict[str, Array]:
        """Return the errors against time: columns of ``error.csv`` by name."""
        place = self.ladder.degrees.index(self.degree)
        traces = self.ladder.traces
        own = traces[place]
        columns = {"time_s": own.times, "displacement_m": own.displacements}
        for name, unit in (("forces", "N"), ("dissipated", "J")):
            values = np.array([getattr(t, name) for t in traces]).T
            found = [error_of_degrees(self.ladder.degrees, v)[place] for v in values]
            what = {"forces": "force", "dissipated": "dissipated"}[name]
            columns[f"{what}_error_of_elements_{unit}"] = np.array(found)
            if self.pair is not None:
                fewer, more = (
                    np.interp(own.times, t.times, getattr(t, name)) for t in self.pair.traces
                )
                gain = (self.pair.steps[1] / self.pair.steps[0]) ** self.pair.order
                columns[f"{what}_error_of_steps_{unit}"] = (fewer - more) / (gain - 1)
        return columns


def estimate(case: Case, sheet: Sheet, tell: Tell) -> Estimate:
    """Return the errors of a case; collective. It takes about three times as long as its run.

    Args:
        case: The case with its elements and steps.
        sheet: Its meshed sheet.
        tell: Called with what is being done.
    """
    ladder, pair = ladder_of(case, sheet, tell), pair_of(case, sheet, tell)
    return combined(case.discretisation.degree, ladder, pair)


def combined(degree: int, ladder: Ladder, pair: Pair | None) -> Estimate:
    """Return the errors from both kinds of answers."""
    space, time = ladder.errors(degree), pair.errors() if pair else None
    trace = pair.traces[1] if pair else ladder.traces[ladder.degrees.index(degree)]
    errors = {
        name: Error(value, space[name], time[name] if time else None)
        for name, value in trace.figures.items()
    }
    return Estimate(errors, ladder, pair, degree)
