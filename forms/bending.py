"""Bending of the yarns in the plane: K_b/2 kappa_a^2, eqs. (2), (5).

The elements are continuous, their slopes are not: on facets the jump of the
current unit tangent stands for the missing part of the curvature, and a penalty
holds it small (C0 interior penalty). Everything follows from one energy, so that
Newton's matrix is symmetric, and only from tangents, so that it is indifferent
to rotations; it vanishes on facets that run along the fibre.
"""

from __future__ import annotations

from typing import Any

from wovenfab.forms.effect import Effect, Needs, Parameter, Strain, Values
from wovenfab.forms.kinematics import Edge, Facet, Point, curvature_vector, tangent


def strains(point: Point, values: Values) -> tuple[Strain, ...]:
    """Return the curvature of each family (1/m) with its stiffness (N m)."""
    assert point.g is not None
    families = zip(point.f, point.g, values["stiffness"], strict=True)
    return tuple(Strain(curvature_vector(f, g), k_b, mixed=False) for f, g, k_b in families)


def facet_strains(facet: Facet, values: Values) -> tuple[Strain, ...]:
    """Return jump and mean curvature of one family on an interior facet."""
    mean = (
        curvature_vector(facet.f_plus, facet.g_plus)
        + curvature_vector(facet.f_minus, facet.g_minus)
    ) / 2
    jump = tangent(facet.f_plus) - tangent(facet.f_minus)
    return _interior_penalty(facet, mean, jump, values["stiffness"][facet.family])


def edge_strains(edge: Edge, values: Values) -> tuple[Strain, ...]:
    """Return jump and curvature of one family whose direction an edge holds."""
    jump, curvature = tangent(edge.f) - edge.held, curvature_vector(edge.f, edge.g)
    return _interior_penalty(edge, curvature, jump, values["stiffness"][edge.family])


def _interior_penalty(
    place: Facet | Edge, curvature: Any, jump: Any, stiffness: Any
) -> tuple[Strain, ...]:
    """Return consistency and penalty; moving along n, e changes by -jump."""
    return (
        Strain(curvature, -place.along * stiffness, other=jump, mixed=False),
        Strain(jump, place.penalty * place.along**2 * stiffness, mixed=False),
    )


EFFECT = Effect(
    name="bending",
    summary="In-plane bending of the yarns, a second-gradient energy, paper eqs. (2) and (5)",
    parameters=(
        Parameter(
            "stiffness",
            "N*m",
            "bending stiffness K_b of a family",
            per_family=True,
            usual=(1e-8, 1e5),
        ),
    ),
    needs=Needs(second_gradient=True),
    strains=strains,
    facet_strains=facet_strains,
    edge_strains=edge_strains,
    resists=frozenset({"curving"}),
)
