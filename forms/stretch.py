"""Stretch of the yarns: K_e/2 (|f_a| - 1)^2 for each family, eqs. (2), (3)."""

from __future__ import annotations

from wovenfab.forms.effect import Effect, Parameter, Strain, Values
from wovenfab.forms.kinematics import Point, stretch


def strains(point: Point, values: Values) -> tuple[Strain, ...]:
    """Return the stretch of each family with its stiffness (N/m)."""
    return tuple(Strain(stretch(f), k) for f, k in zip(point.f, values["stiffness"], strict=True))


EFFECT = Effect(
    name="stretch",
    summary="Elastic stretch of the yarns, paper eqs. (2) and (3)",
    parameters=(
        Parameter(
            "stiffness",
            "N/m",
            "extensional stiffness K_e of a family",
            per_family=True,
            usual=(10.0, 1e11),
        ),
    ),
    strains=strains,
    resists=frozenset({"stretching"}),
)
