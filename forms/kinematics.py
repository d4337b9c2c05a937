"""Deformation measures of a sheet of two yarn families (paper, section 2).

All functions take and return UFL expressions. ``f_a`` is the derivative of the
placement of family ``a`` along its reference fibre direction ``D_a`` (shape (2,),
no unit) and ``g_a`` the second such derivative (shape (2,), 1/m).

From displacement fields to the measures at points, facets and edges.

Each function also gives the variation of the measures, which are linear in the
displacement: the same expressions of the test or trial field, less the constant
reference part.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import ufl

Pair = tuple[Any, Any]


@dataclass(frozen=True)
class Point:
    """What the energy densities may depend on at a point of the sheet.

    Attributes:
        f: For each family, derivative of the placement along its fibre, shape (2,).
        g: For each family, second derivative along the fibre, shape (2,), 1/m.
        slip: chi_1 - chi_2, shape (2,), m; None with one placement.
        fibres: Reference directions D_1, D_2, shape (2,) each.
    """

    f: Pair
    g: Pair | None
    slip: Any | None
    fibres: Pair

    @property
    def measures(self) -> list[Any]:
        """The independent quantities, in a fixed order."""
        return [*self.f, *(self.g or ()), *(() if self.slip is None else (self.slip,))]

    def with_measures(self, measures: list[Any]) -> Point:
        """Return this point with other quantities, in the order of ``measures``."""
        rest = list(measures)
        f = (rest.pop(0), rest.pop(0))
        g = None if self.g is None else (rest.pop(0), rest.pop(0))
        slip = None if self.slip is None else rest.pop(0)
        return Point(f, g, slip, self.fibres)


@dataclass(frozen=True)
class Facet:
    """One family on both sides of an interior facet; n points from + to -.

    Attributes:
        f_plus, f_minus: First fibre derivatives, shape (2,).
        g_plus, g_minus: Second fibre derivatives, shape (2,), 1/m.
        along: D·n, the fibre's component across the facet.
        family: 0 or 1.
        penalty: Stabilisation over length sigma/h, 1/m.
    """

    f_plus: Any
    f_minus: Any
    g_plus: Any
    g_minus: Any
    along: Any
    family: int
    penalty: Any

    @property
    def measures(self) -> list[Any]:
        """The independent quantities, in a fixed order."""
        return [self.f_plus, self.f_minus, self.g_plus, self.g_minus]

    def with_measures(self, measures: list[Any]) -> Facet:
        """Return this facet with other quantities, in the order of ``measures``."""
        f_plus, f_minus, g_plus, g_minus = measures
        return Facet(f_plus, f_minus, g_plus, g_minus, self.along, self.family, self.penalty)


@dataclass(frozen=True)
class Edge:
    """One family on a boundary facet where its yarn direction is held.

    Attributes:
        f: First fibre derivative, shape (2,).
        g: Second fibre derivative, shape (2,), 1/m.
        held: The direction that the yarn is held in, unit vector, shape (2,).
        along: D·n with the outward normal.
        family: 0 or 1.
        penalty: Stabilisation over length sigma/h, 1/m.
    """

    f: Any
    g: Any
    held: Any
    along: Any
    family: int
    penalty: Any

    @property
    def measures(self) -> list[Any]:
        """The independent quantities, in a fixed order."""
        return [self.f, self.g]

    def with_measures(self, measures: list[Any]) -> Edge:
        """Return this edge with other quantities, in the order of ``measures``."""
        f, g = measures
        return Edge(f, g, self.held, self.along, self.family, self.penalty)


def as_variables(place: Any) -> Any:
    """Return the place with each measure made a variable to differentiate by."""
    return place.with_measures([ufl.variable(m) for m in place.measures])


def unlabelled(place: Any) -> Any:
    """Return the place with the values of its measures, which no derivative by them sees."""
    variable = ufl.classes.Variable
    values = (m.ufl_operands[0] if isinstance(m, variable) else m for m in place.measures)
    return place.with_measures(list(values))


def along(direction: Any, field: Any) -> Any:
    """Return the derivative of a vector field along ``direction``."""
    return ufl.dot(ufl.grad(field), direction)


def twice_along(direction: Any, field: Any) -> Any:
    """Return the second derivative of a vector field along a constant ``direction``."""
    return along(direction, along(direction, field))


def norm(v: Any) -> Any:
    """Return the Euclidean length of a vector."""
    return ufl.sqrt(ufl.dot(v, v))


def stretch(f: Any) -> Any:
    """Return the fibre stretch ``|f| - 1``, eq. (3)."""
    return norm(f) - 1


def tangent(f: Any) -> Any:
    """Return the unit tangent ``e = f/|f|`` of the current fibre."""
    return f / norm(f)


def across(f: Any) -> Any:
    """Return the unit vector across the current fibre, to its left."""
    e = tangent(f)
    return ufl.as_vector((-e[1], e[0]))


def cross(a: Any, b: Any) -> Any:
    """Return the out-of-plane component of a × b."""
    return a[0] * b[1] - a[1] * b[0]


def orientation(fibres: Pair) -> Any:
    """Return the reference value of D_1 × D_2; its sign must never be lost."""
    return cross(*fibres)


def shear_angle(f: Pair, fibres: Pair) -> Any:
    """Return gamma = arcsin(e_1·e_2), eq. (4), less its value at rest.

    Written with the two-argument arctangent, which is the same angle and has a
    bounded derivative up to the locking angle.
    """
    return _angle(*f, fibres) - rest_angle(fibres)


def rest_angle(fibres: Pair) -> Any:
    """Return arcsin(D_1·D_2), zero for orthogonal fibres."""
    return _angle(*fibres, fibres)


def _angle(a: Any, b: Any, fibres: Pair) -> Any:
    return ufl.atan2(ufl.dot(a, b), _facing(a, b, fibres))


def shear_tangent(f: Pair, fibres: Pair) -> Any:
    """Return tan(arcsin(e_1·e_2)) less its value at rest, eq. (2).

    It grows without bound as the families align. For orthogonal fibres the value
    at rest is zero and this is the paper's expression; for others it keeps the
    reference state free of stress.
    """
    rest = ufl.dot(*fibres) / _facing(*fibres, fibres)
    return ufl.dot(*f) / _facing(*f, fibres) - rest


def _facing(a: Any, b: Any, fibres: Pair) -> Any:
    """Return a × b counted positive in the orientation of the reference fibres."""
    return cross(a, b) * ufl.sign(orientation(fibres))


def curvature_vector(f: Any, g: Any) -> Any:
    """Return de/dD, the derivative of the unit tangent along the fibre, 1/m.

    Its length is kappa of eq. (5).
    """
    e = tangent(f)
    return (g - ufl.dot(e, g) * e) / norm(f)


def displacements(field: Any) -> Pair:
    """Return the displacement of each family from a field of 2 or 4 components.

    A field of 2 components is the one placement that both families share.
    """
    if field.ufl_shape == (2,):
        return field, field
    return ufl.as_vector((field[0], field[1])), ufl.as_vector((field[2], field[3]))


def point_of(field: Any, fibres: Pair, second_gradient: bool) -> Point:
    """Return the measures of a displacement field (m) inside a cell."""
    f, g, slip = _measures(field, fibres, second_gradient)
    return Point((f[0] + fibres[0], f[1] + fibres[1]), g, slip, fibres)


def point_variation(field: Any, fibres: Pair, second_gradient: bool) -> list[Any]:
    """Return the variations of the point's measures by ``field``, in their order."""
    f, g, slip = _measures(field, fibres, second_gradient)
    return Point(f, g, slip, fibres).measures


def _measures(field: Any, fibres: Pair, second_gradient: bool) -> tuple[Pair, Pair | None, Any]:
    u = displacements(field)
    f = (along(fibres[0], u[0]), along(fibres[1], u[1]))
    g = (twice_along(fibres[0], u[0]), twice_along(fibres[1], u[1])) if second_gradient else None
    slip = u[0] - u[1] if field.ufl_shape == (4,) else None
    return f, g, slip


def facet_of(field: Any, fibres: Pair, family: int, penalty: Any, normal: Any) -> Facet:
    """Return the measures of one family on an interior facet."""
    direction = fibres[family]
    f, g = _line(field, direction, family)
    f = f + direction
    across = ufl.dot(direction, normal("+"))
    return Facet(f("+"), f("-"), g("+"), g("-"), across, family, penalty)


def facet_variation(field: Any, fibres: Pair, family: int) -> list[Any]:
    """Return the variations of the facet's measures by ``field``, in their order."""
    f, g = _line(field, fibres[family], family)
    return [f("+"), f("-"), g("+"), g("-")]


def edge_of(field: Any, fibres: Pair, family: int, penalty: Any, normal: Any) -> Edge:
    """Return the measures of one family on an edge that holds its reference direction."""
    direction = fibres[family]
    f, g = _line(field, direction, family)
    return Edge(f + direction, g, direction, ufl.dot(direction, normal), family, penalty)


def edge_variation(field: Any, fibres: Pair, family: int) -> list[Any]:
    """Return the variations of the edge's measures by ``field``, in their order."""
    return list(_line(field, fibres[family], family))


def _line(field: Any, direction: Any, family: int) -> Pair:
    u = displacements(field)[family]
    return along(direction, u), twice_along(direction, u)
