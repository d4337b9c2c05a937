"""Errors of elements: from the responses of three or four degrees on one mesh, with few steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.case import Case
from wovenfab.forms.balance import second_variation
from wovenfab.forms.kinematics import Point, across, point_of, point_variation
from wovenfab.model.assembly import compile_form
from wovenfab.model.model import Model
from wovenfab.sheet.sheet import Sheet
from wovenfab.study.errors.refinement import FASTEST, error_of_degrees
from wovenfab.study.response import (
    Budget,
    Response,
    is_set_valued,
    prolongated,
    response_of,
    with_elements,
    with_steps,
)

Array = NDArray[np.float64]
#: Fastest convergence that is believed with set-valued and with other friction. Where yarns begin
#: to slide the solution has a kink, or bends sharply, at fronts that cells do not follow; two
#: degrees may agree by chance.
FASTEST_SET_VALUED, FASTEST_FRICTION = 5.0, 10.0
#: Error of the highest degree over the last change, at least, where values have a trend and where
#: they have none: with friction one degree may be too soft and the next one too stiff.
UNCONFIRMED, WITHOUT_TREND = 2 / 3, 2.0
#: Share of cells whose elements may be too large for waves: those beside corners of clamps, where
#: forces have no bound, always are.
UNRESOLVED = 0.05
#: Share of the usual number of steps that is enough to compare elements: with half as many,
#: what they dissipate in a cycle with slip is half as wrong as with many.
FEW = 0.15


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


def fastest_convergence(case: Case) -> float:
    """Return the largest exponent of convergence in the degree that is believed for a case."""
    if is_set_valued(case):
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
            if value and all(name in f for f in figures)
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
    where it takes more than the budget.
    """
    trial = with_elements(with_steps(case, share), degree=degree)
    return response_of(trial, sheet, lower, with_states=True, budget=budget)


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


def resolves_waves(model: Model) -> bool:
    """Return whether elements are small enough for the waves that compressed yarns may form.

    Where they are not, coarse elements of all degrees may agree on a sheet that stays straight,
    and finer ones find one that is softer. A yarn that is compressed by c (N/m) more than its shear
    resists, and that yarns across hold as an elastic foundation does, buckles with the wave number
    k = (c / 2B)^(1/2), B its bending stiffness (Hetenyi, Beams on Elastic Foundation, 1946).
    Elements of size h and degree p resolve that for k h < 2p + 1 (Ainsworth, doi:
    10.1137/S0036142903423460). Collective.

    Args:
        model: With the field that is judged.
    """
    balance = model.balance
    if not balance.second_gradient:
        return True
    point = point_of(model.field, balance.fibres, second_gradient=True)
    stored = [t for t in balance.terms if not t.effect.dissipative]

    def second(variation: Point) -> Any:
        both = variation.measures, variation.measures
        return second_variation(
            lambda p: sum(t.effect.stored(p, t.values) for t in stored), point, *both
        )

    mesh, none = model.sheet.mesh, ufl.as_vector((0, 0))
    still = point.with_measures([none for _ in point.measures])
    test = ufl.TestFunction(fem.functionspace(mesh, ("DG", 0, (2,))))
    total = 0
    for family, f in enumerate(point.f):
        normal = across(f)
        pair = (normal, none) if family == 0 else (none, normal)
        bending = second(replace(still, g=pair))
        excess = -second(replace(still, f=pair))
        squared = ufl.conditional(ufl.gt(bending, 0), excess / (2 * bending), 0)  # k^2
        total += test[family] * squared
    form = compile_form(2 * total * ufl.dx(metadata={"quadrature_degree": balance.quadrature}))
    own = mesh.topology.index_map(2).size_local
    # h^2 is twice the area of a cell, which the integral has once.
    squares = fem.assemble_vector(form).array[: 2 * own].reshape(-1, 2)
    short = int((squares.max(axis=1, initial=0.0) > (2 * balance.degree + 1) ** 2).sum())
    short, cells = model.comm.allreduce(np.array([short, own]), op=MPI.SUM)
    return bool(short <= UNRESOLVED * cells)
