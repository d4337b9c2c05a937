"""How far from its limit a sequence of answers is.

The errors of a case's answers: from elements and from steps, each measured by itself.

Both parts add up to leading order. That of the elements is found with few steps, from three
degrees on the mesh of the case; that of the steps on a coarse mesh, from half as many steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from wovenfab.case import Case
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.response import Response, discretised, paced, response_of

#: Slowest and fastest convergence that is believed: exponents of degree. Beside a singularity
#: r^l an energy converges like p^-4l (Babuska and Suri 1987), and l is 1/4 at least: where a
#: clamped side of a cut meets its free one.
SLOWEST, FASTEST = 1.0, 40.0


def error_of_degrees(degrees: Sequence[int], values: Sequence[float]) -> tuple[float, float, float]:
    """Return the errors of three answers from elements of three degrees on one mesh.

    The answers are taken to follow ``limit + C p^-r``, as they do where corners are
    singular; where they converge faster, r comes out large and the error of each is
    nearly its distance from the next.

    Args:
        degrees: Three degrees, one after another.
        values: The answers.

    Returns:
        Signed errors of the three, each its answer minus the limit.
    """
    low, middle, high = degrees
    first, second = values[0] - values[1], values[1] - values[2]

    def ratio(r: float) -> float:
        return float((low**-r - middle**-r) / (middle**-r - high**-r))

    if first * second <= 0:  # no trend: the last change is all that is known
        r = FASTEST if abs(second) <= abs(first) else SLOWEST
    else:
        found = first / second
        if found <= ratio(SLOWEST):
            r = SLOWEST
        elif found >= ratio(FASTEST):
            r = FASTEST
        else:
            r = float(brentq(lambda s: ratio(s) - found, SLOWEST, FASTEST))
    last = second / ((high / middle) ** r - 1)
    return first + second + last, second + last, last


def error_of_steps(
    steps: tuple[int, int], values: tuple[float, float], order: int
) -> tuple[float, float]:
    """Return the errors of two answers from two numbers of steps (Richardson).

    Args:
        steps: The fewer, the more.
        values: The answers.
        order: Order of the scheme.
    """
    gain = (steps[1] / steps[0]) ** order
    second = (values[0] - values[1]) / (gain - 1)
    return gain * second, second


Array = NDArray[np.float64]
#: Share of the usual number of steps that is enough to compare elements: with half as many,
#: what they dissipate in a cycle with slip is half as wrong as with many.
FEW = 0.15
PEAK, DISSIPATED = "peak_force_N", "dissipated_J"


@dataclass(frozen=True)
class Ladder:
    """Answers from three degrees on one mesh, with the same few steps.

    Attributes:
        degrees: The degrees, one after another.
        traces: The answers.
    """

    degrees: tuple[int, ...]
    traces: tuple[Response, ...]

    def errors(self, degree: int) -> dict[str, float]:
        """Return the signed error of each figure over it, with elements of one of the degrees."""
        place = self.degrees.index(degree)
        figures = [t.figures for t in self.traces]
        return {
            name: error_of_degrees(self.degrees, [f[name] for f in figures])[place] / value
            for name, value in figures[place].items()
            if value
        }


def rung(
    case: Case, sheet: Sheet, degree: int, share: float = FEW, below: Response | None = None
) -> Response:
    """Return the answer of a case with another degree and a share of its steps; collective.

    Args:
        case: The case.
        sheet: Its sheet.
        degree: Of the elements.
        share: Of the planned steps.
        below: The answer of a lower degree with the same steps, to begin from.
    """
    return response_of(discretised(paced(case, share), degree=degree), sheet, below, keep=True)


@dataclass(frozen=True)
class Pair:
    """Answers from two numbers of steps with the same elements.

    Attributes:
        fewer, more: The answers.
        order: Order of the scheme.
    """

    fewer: Response
    more: Response
    order: int

    def errors(self) -> dict[str, float]:
        """Return the signed error of each figure over it, with more steps.

        Steps miss the crest of the force, besides the error that they have there.
        """
        steps, found = (self.fewer.steps, self.more.steps), self.more.figures
        crests = self.fewer.crest, self.more.crest
        losses = self.fewer.figures[DISSIPATED], found[DISSIPATED]
        peak = error_of_steps(steps, crests, self.order)[1] + found[PEAK] - crests[1]
        errors = {PEAK: peak, DISSIPATED: error_of_steps(steps, losses, self.order)[1]}
        return {name: errors[name] / value for name, value in found.items() if value}


@dataclass(frozen=True)
class Estimate:
    """The errors of a case and where they come from.

    Attributes:
        ladder: Answers from three degrees.
        degree: Degree of the elements of the case.
        time: Signed errors of the steps over the figures; None where they were not chosen.
    """

    ladder: Ladder
    degree: int
    time: Mapping[str, float] | None = None

    @property
    def space(self) -> dict[str, float]:
        """Signed errors of the elements over the figures."""
        return self.ladder.errors(self.degree)

    @property
    def relative(self) -> dict[str, float]:
        """Size of both errors together over the figure, by name; they might add up."""
        time = self.time or {}
        return {name: abs(e) + abs(time.get(name, 0.0)) for name, e in self.space.items()}

    @property
    def worst(self) -> float:
        """The largest relative error of all figures."""
        return max(self.relative.values(), default=0.0)

    def as_dict(self, figures: Mapping[str, Any]) -> dict[str, dict[str, float | None]]:
        """Return the errors for the summary.

        Args:
            figures: The answers that have these errors, by name.
        """
        return {
            name: {
                "value": figures[name],
                "error": relative * abs(figures[name]),
                "error_of_elements": self.space[name] * figures[name],
                "error_of_steps": None if self.time is None else self.time[name] * figures[name],
                "relative_error": relative,
            }
            for name, relative in self.relative.items()
            if figures.get(name) is not None
        }

    def history(self) -> dict[str, Array]:
        """Return the errors of the elements against time: columns of ``error.csv`` by name."""
        place = self.ladder.degrees.index(self.degree)
        traces = self.ladder.traces
        own = traces[place]
        columns = {"time_s": own.times, "displacement_m": own.displacements}
        names = {"force": ("forces", "N"), "dissipated": ("dissipated", "J")}
        for what, (name, unit) in names.items():
            values = np.array([getattr(t, name) for t in traces]).T
            found = [error_of_degrees(self.ladder.degrees, v)[place] for v in values]
            columns[f"{what}_{unit}"] = getattr(own, name)
            columns[f"{what}_error_of_elements_{unit}"] = np.array(found)
        return columns


def worst(errors: Mapping[str, float]) -> float:
    """Return the largest of signed errors in size."""
    return max(map(abs, errors.values()), default=0.0)
