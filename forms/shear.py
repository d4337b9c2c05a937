"""Shear between the families: K_s/2 tan^2(gamma), eqs. (2), (4)."""

from __future__ import annotations

from typing import Any

from wovenfab.forms.effect import Effect, Parameter, Values
from wovenfab.forms.kinematics import Point, shear_tangent


def energy(point: Point, values: Values) -> Any:
    """Return the shear energy density (J/m^2); infinite where the yarns would overlap."""
    return values["stiffness"] / 2 * shear_tangent(point.f, point.fibres) ** 2


EFFECT = Effect(
    name="shear",
    summary="Shear with a barrier against overlapping yarns, paper eqs. (2) and (4)",
    parameters=(Parameter("stiffness", "N/m", "shear stiffness K_s", usual=(0.01, 1e6)),),
    energy=energy,
    resists=frozenset({"shearing"}),
)
