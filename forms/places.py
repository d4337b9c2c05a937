"""From displacement fields to the measures at points, facets and edges.

Each function also gives the variation of the measures, which are linear in the
displacement: the same expressions of the test or trial field, less the constant
reference part.
"""

from __future__ import annotations

from typing import Any

import ufl

from .kinematics import Edge, Facet, Pair, Point, along, twice_along


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
