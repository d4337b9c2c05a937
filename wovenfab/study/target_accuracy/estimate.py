"""Estimated errors of a case: from elements and from steps, each measured by itself.

Both parts add up to leading order. That of the elements follows with few steps from three
degrees on the mesh of the case; that of the steps on a coarse mesh from three numbers of steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import copysign, log
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.optimize import brentq

from wovenfab.case import Case
from wovenfab.compat import corners_of
from wovenfab.forms.balance import second_variation
from wovenfab.forms.kinematics import point_of, point_variation
from wovenfab.model.assembly import compile_form
from wovenfab.model.model import Model
from wovenfab.parallel import on_root
from wovenfab.record.field_file import ERROR
from wovenfab.record.fields import FieldSeries
from wovenfab.record.history import index_of_peak
from wovenfab.record.results import write_whole
from wovenfab.sheet.lattice import Lattice
from wovenfab.sheet.sheet import Sheet
from wovenfab.study.response import (
    Budget,
    Response,
    peak_of_spline,
    prolongated,
    response_of,
    with_elements,
    with_steps,
)

Array = NDArray[np.float64]
#: Slowest and fastest convergence that is believed: exponents of degree. Beside a singularity
#: r^l an energy converges like p^-4l (Babuska and Suri 1987), and l is 1/4 at least: where a
#: clamped side of a cut meets its free one.
SLOWEST, FASTEST = 1.0, 40.0
#: Fastest convergence that is believed with set-valued and with other friction. Where yarns begin
#: to slide the solution has a kink, or bends sharply, at fronts that cells do not follow; two
#: degrees may agree by chance.
FASTEST_SET_VALUED, FASTEST_FRICTION = 5.0, 10.0
#: Fastest convergence that is believed where four degrees show no faster one, and where the values
#: turn: layers that coarse cells do not resolve let the loss change little from degree 4 to degree
#: 5, and yet be too large. Degree 2 is too soft there and degree 3 too stiff, as is the next.
FASTEST_UNSHOWN = 5.0
#: Error of the highest degree over the last change, at least, where values have a trend and where
#: they have none: with friction one degree may be too soft and the next one too stiff.
UNCONFIRMED, WITHOUT_TREND = 2 / 3, 2.0
#: Share of the usual number of steps that is enough to compare elements: with half as many,
#: what they dissipate in a cycle with slip is half as wrong as with many.
FEW = 0.15
#: Estimated errors that are stated, over the estimates: these are not exact.
SAFETY = 1.25
PEAK, DISSIPATED = "peak_force_N", "dissipated_J"
ERRORS = "error.csv"


def error_of_degrees(
    degrees: Sequence[int], values: Sequence[float], fastest: float = FASTEST
) -> tuple[float, float, float]:
    """Return the errors of three values from elements of three degrees on one mesh.

    The values are taken to follow ``limit + C p^-r``, as they do where corners are
    singular; where they converge faster, r comes out large and the error of each is
    nearly its distance from the next. A last change that is smaller than the fastest
    convergence explains is taken to be as large as that: two degrees may agree by chance,
    above all where the values turn. A degree below the three tells more: changes may fall
    geometrically, as those of smooth solutions do.

    Args:
        degrees: Three degrees, one after another, or four.
        values: The values.
        fastest: Largest r that is believed.

    Returns:
        Signed errors of the last three, each its value minus the limit.
    """
    low, middle, high = degrees[-3:]
    *before, first, second = (a - b for a, b in pairwise(values))
    if first * second < 0:
        fastest = min(fastest, FASTEST_UNSHOWN)

    def ratio(r: float) -> float:
        return float((low**-r - middle**-r) / (middle**-r - high**-r))

    def exponent(observed: float) -> float:
        if observed <= ratio(SLOWEST):
            return SLOWEST
        most = min(observed, ratio(fastest))
        return float(brentq(lambda r: ratio(r) - most, SLOWEST, fastest))

    least = abs(first) / ratio(fastest)
    if before and before[-1]:
        least = max(least, min(abs(first) / ratio(FASTEST_UNSHOWN), first**2 / abs(before[-1])))
    if abs(second) < least:
        second = copysign(least, second)
        r = exponent(abs(first / second))
    elif first * second <= 0:  # no trend: the last change is all that is known
        r = fastest if abs(second) <= abs(first) else SLOWEST
    else:
        r = exponent(first / second)
    last = second / ((high / middle) ** r - 1)
    return first + second + last, second + last, last


def error_of_degree(
    degrees: Sequence[int], values: Sequence[float], degree: int, fastest: float = FASTEST
) -> float:
    """Return the signed error of the value from one of the degrees, on the safe side.

    No higher degree confirms the highest one: its error is at least two thirds of the last
    change, as far as that is believed, and twice the last change if there is no trend. Without a
    trend no higher degree confirms the one below it either: that has the last change besides.

    Args:
        degrees: Three degrees, one after another, or four.
        values: The values.
        degree: The degree of the value, the highest one or that below it.
        fastest: Largest exponent of convergence that is believed.
    """
    _, middle, high = error_of_degrees(degrees, values, fastest)
    first, second = (a - b for a, b in pairwise(values[-3:]))
    turns, change = first * second < 0, middle - high
    highest = max(high, (WITHOUT_TREND if turns else UNCONFIRMED) * change, key=abs)
    if degree == max(degrees):
        return highest
    return change + highest if turns else middle


def error_and_order(
    counts: Sequence[int], values: Sequence[float], highest: float
) -> tuple[float, float]:
    """Return the signed error of the last of three values, and the order in which it falls.

    The order is the one that the values show: where steps do not resolve how friction lets go,
    it is lower than the scheme's.

    Args:
        counts: Three numbers of steps, one after another.
        values: The values.
        highest: Order of the scheme.
    """
    _, middle, last = error_of_degrees(counts, values, highest)
    if not last:
        return 0.0, highest
    return last, min(log(middle / last) / log(counts[2] / counts[1]), highest)


def fastest_convergence(case: Case) -> float:
    """Return the largest exponent of convergence in the degree that is believed for a case."""
    if any(entry.effect.set_valued for entry in case.scene):
        return FASTEST_SET_VALUED
    return FASTEST_FRICTION if case.needs.history else FASTEST


@dataclass(frozen=True)
class DegreeRefinement:
    """Responses with three or four degrees on one mesh, with the same few steps.

    Attributes:
        degrees: The degrees, one after another.
        responses: The responses.
        fastest: Largest exponent of convergence that is believed.
    """

    degrees: tuple[int, ...]
    responses: tuple[Response, ...]
    fastest: float = FASTEST

    def error(self, values: Sequence[float], degree: int) -> float:
        """Return the signed error of the value with elements of one of the degrees."""
        return error_of_degree(self.degrees, values, degree, self.fastest)

    def errors(self, degree: int) -> dict[str, float]:
        """Return the signed error of each figure over it, with elements of one of the degrees."""
        figures = [r.figures for r in self.responses]
        return {
            name: self.error([f[name] for f in figures], degree) / value
            for name, value in figures[self.degrees.index(degree)].items()
            if value
        }


def response_with_degree(
    case: Case,
    sheet: Sheet,
    degree: int,
    share: float = FEW,
    lower: Response | None = None,
    budget: Budget | None = None,
) -> Response:
    """Return the response of a case with another degree and a share of its steps; collective.

    The response of a lower degree with the same steps is the initial guess. It is given up
    after so many seconds of wall time.
    """
    trial = with_elements(with_steps(case, share), degree=degree)
    return response_of(trial, sheet, lower, with_states=True, budget=budget)


@dataclass(frozen=True)
class StepRefinement:
    """Responses with three numbers of steps on the same elements.

    Attributes:
        responses: The responses, one after another.
        highest: Order of the scheme.
    """

    responses: Sequence[Response]
    highest: float

    def errors_and_orders(self) -> dict[str, tuple[float, float]]:
        """Return each figure's signed error over it with most steps, and the order of that.

        That of the peak is the error of the curve; what steps miss of it is another matter.
        """
        counts = [r.count for r in self.responses]
        values = {
            PEAK: [peak_of_spline(r.times, r.forces)[1] for r in self.responses],
            DISSIPATED: [r.figures[DISSIPATED] for r in self.responses],
        }
        result = {}
        for name, value in self.responses[-1].figures.items():
            if value:
                error, order = error_and_order(counts, values[name], self.highest)
                result[name] = error / abs(value), order
        return result


@dataclass(frozen=True)
class Estimate:
    """The errors of a case and where they come from.

    Attributes:
        refinement: Responses with three or four degrees.
        degree: Degree of the elements of the case, the highest or that below it.
        time: Signed errors of the steps over the figures; None where they were not chosen.
        missed: Share of the peak of the force that is missed between steps.
    """

    refinement: DegreeRefinement
    degree: int
    time: Mapping[str, float] | None = None
    missed: float = 0.0

    @property
    def response(self) -> Response:
        """The response with the elements of the case, with few steps."""
        return self.refinement.responses[self.refinement.degrees.index(self.degree)]

    @property
    def space(self) -> dict[str, float]:
        """Signed errors of the elements over the figures."""
        return self.refinement.errors(self.degree)

    @property
    def relative(self) -> dict[str, float]:
        """Size of both errors together over the figure, by name, on the safe side."""
        time, missed = self.time or {}, {PEAK: self.missed}
        return {
            name: stated_error(e, time.get(name, 0.0), missed.get(name, 0.0))
            for name, e in self.space.items()
        }

    @property
    def worst(self) -> float:
        """The largest relative error of all figures."""
        return max(self.relative.values(), default=0.0)

    @property
    def models(self) -> tuple[Model, Model]:
        """Two models by whose difference the error is seen, with their fields.

        They are those of the case's degree and of the next higher one, or else of the highest two.
        """
        responses = self.refinement.responses
        place = min(self.refinement.degrees.index(self.degree), len(responses) - 2)
        return responses[place].model, responses[place + 1].model

    def history(self) -> dict[str, Array]:
        """Return the errors of the elements against time: columns of ``error.csv`` by name."""
        responses, own = self.refinement.responses, self.response
        columns = {"time_s": own.times, "displacement_m": own.displacements}
        names = {"force": ("forces", "N"), "dissipated": ("dissipated", "J")}
        for what, (name, unit) in names.items():
            values = np.array([getattr(r, name) for r in responses]).T
            errors = [self.refinement.error(v, self.degree) for v in values]
            columns[f"{what}_{unit}"] = getattr(own, name)
            columns[f"{what}_error_of_elements_{unit}"] = np.array(errors)
        return columns


def stated_error(elements: float, steps: float, missed: float = 0.0) -> float:
    """Return the size of all errors on the safe side; they might add up.

    Args:
        elements: Estimated error, which is not exact.
        steps: The same.
        missed: What is missed of a peak, which is measured.
    """
    return SAFETY * (abs(elements) + abs(steps)) + missed


def worst(errors: Mapping[str, float]) -> float:
    """Return the largest of signed errors in size."""
    return max(map(abs, errors.values()), default=0.0)


def error_shares(low: Model, high: Model) -> Array:
    """Return each own cell's share of the error of elements; all together they make 1.

    The error of the energy is half the second variation by the correction, which is the
    difference of the responses of both degrees; that is summed over cells, by size. Facets
    are left out: their part is that of the cells beside them.

    Args:
        low: The model whose field has the error, on the same mesh as
        high: that of higher degree, both with their fields.
    """
    correction = fem.Function(high.space)
    correction.x.array[:] = high.field.x.array - prolongated(low.field.x.array, low, high)
    balance = high.balance
    kind = balance.fibres, balance.second_gradient
    variation = point_variation(correction, *kind)
    stored = [t for t in balance.terms if not t.effect.dissipative]
    density = second_variation(
        lambda point: sum(t.effect.stored(point, t.values) for t in stored),
        point_of(high.field, *kind),
        variation,
        variation,
    )
    test = ufl.TestFunction(fem.functionspace(high.sheet.mesh, ("DG", 0)))
    form = compile_form(test * density * ufl.dx(metadata={"quadrature_degree": balance.quadrature}))
    own = high.sheet.mesh.topology.index_map(2).size_local
    sizes = np.abs(fem.assemble_vector(form).array[:own])
    total = high.comm.allreduce(float(sizes.sum()), op=MPI.SUM)
    return np.asarray(sizes / total if total else sizes)


def write_errors(estimate: Estimate, directory: Path) -> None:
    """Write ``error.csv``, ``error.xdmf`` and ``error.h5``; collective."""
    columns = estimate.history()
    low, high = estimate.models
    comm, mesh = low.comm, low.sheet.mesh
    rows = [
        ",".join(columns),
        *(",".join(map(repr, map(float, r))) for r in zip(*columns.values(), strict=True)),
    ]
    on_root(comm, lambda: write_whole(directory / ERRORS, "\n".join(rows) + "\n"))
    shares = error_shares(low, high)
    corners = mesh.geometry.x[corners_of(mesh)[: len(shares)], :2]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]) / 2
    series = FieldSeries(
        directory,
        comm,
        Lattice(1),
        corners.reshape(-1, 2),
        low.sheet.original_cells[: len(shares)],
        {"error_share": "1", "error_density": "1/m^2"},
        ERROR,
    )
    at_peak = float(columns["time_s"][index_of_peak(columns["force_N"])])
    fields = {"error_share": np.repeat(shares, 3), "error_density": np.repeat(shares / area, 3)}
    series.write(0, at_peak, fields)
