"""Bending of the yarns in the plane: K_b/2 kappa_a^2, eqs. (2), (5).

The elements are continuous, their slopes are not: on facets the jump of the
current unit tangent stands for the missing part of the curvature, and a penalty
holds it small (C0 interior penalty). Everything follows from one energy, so that
Newton's matrix is symmetric, and only from tangents, so that it is indifferent
to rotations; it vanishes on facets that run along the fibre.
"""

from __future__ import annotations

from typing import Any

import ufl

from .effect import Effect, Needs, Parameter, Values
from .kinematics import Edge, Facet, Point, curvature_vector, tangent


def energy(point: Point, values: Values) -> Any:
    """Return the bending energy density (J/m^2)."""
    assert point.g is not None
    curvatures = [curvature_vector(f, g) for f, g in zip(point.f, point.g, strict=True)]
    return sum(
        k_b / 2 * ufl.dot(k, k) for k, k_b in zip(curvatures, values["stiffness"], strict=True)
    )


def facet_energy(facet: Facet, values: Values) -> Any:
    """Return the energy per length (J/m) of one family on an interior facet."""
    mean = (
        curvature_vector(facet.f_plus, facet.g_plus)
        + curvature_vector(facet.f_minus, facet.g_minus)
    ) / 2
    jump = tangent(facet.f_plus) - tangent(facet.f_minus)
    return values["stiffness"][facet.family] * _interior_penalty(facet, mean, jump)


def edge_energy(edge: Edge, values: Values) -> Any:
    """Return the energy per length (J/m) of one family whose direction an edge holds."""
    jump = tangent(edge.f) - edge.held
    curvature = curvature_vector(edge.f, edge.g)
    return values["stiffness"][edge.family] * _interior_penalty(edge, curvature, jump)


def _interior_penalty(place: Facet | Edge, curvature: Any, jump: Any) -> Any:
    """Return consistency and penalty; moving along n, e changes by -jump."""
    consistency = -place.along * ufl.dot(curvature, jump)
    return consistency + place.penalty / 2 * place.along**2 * ufl.dot(jump, jump)


EFFECT = Effect(
    name="bending",
    summary="In-plane bending of the yarns, a second-gradient energy, paper eqs. (2) and (5)",
    parameters=(
        Parameter("stiffness", "N*m", "bending stiffness K_b of a family", per_family=True),
    ),
    needs=Needs(second_gradient=True),
    energy=energy,
    facet_energy=facet_energy,
    edge_energy=edge_energy,
    resists=frozenset({"curving"}),
)
