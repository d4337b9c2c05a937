"""Penalty of the C0 interior penalty method, without guessing."""

from __future__ import annotations

from typing import Any

import ufl

#: Safety over the smallest penalty for which the linear problem is proven stable.
SAFETY = 2.0


def facet_penalty(mesh: Any, degree: int, factor: Any | None = None) -> Any:
    """Return sigma/h (1/m) on interior facets of triangles.

    Without ``factor`` it is the local value from the trace inequality, sharp for
    every degree p: 3 a p(p-1)/8 h_F (1/|T+| + 1/|T-|), a > 1 (Bringmann, Carstensen,
    Streitberger 2023).

    Args:
        mesh: UFL domain or mesh.
        degree: Degree p of the elements.
        factor: sigma of a penalty sigma/h with h the mean of |T|/|F|, to override it.
    """
    length = ufl.FacetArea(mesh)("+")  # the same from both sides
    volume = ufl.CellVolume(mesh)
    if factor is not None:
        return factor * length / ufl.avg(volume)
    trace = 3 * SAFETY * degree * (degree - 1) / 8
    return trace * length * (1 / volume("+") + 1 / volume("-"))


def edge_penalty(mesh: Any, degree: int, factor: Any | None = None) -> Any:
    """Return sigma/h (1/m) on boundary facets: 3 a p(p-1)/2 h_F/|T|, or with ``factor``."""
    inverse = ufl.FacetArea(mesh) / ufl.CellVolume(mesh)
    return (3 * SAFETY * degree * (degree - 1) / 2 if factor is None else factor) * inverse
