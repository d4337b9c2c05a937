"""Elastic tie between the two placements: K_c/2 |chi_2 - chi_1|^2, eqs. (2), (6)."""

from __future__ import annotations

from typing import Any

import ufl

from wovenfab.forms.effect import Effect, Needs, Parameter, Values
from wovenfab.forms.kinematics import Point


def energy(point: Point, values: Values) -> Any:
    """Return the coupling energy density (J/m^2)."""
    return values["stiffness"] / 2 * ufl.dot(point.slip, point.slip)


EFFECT = Effect(
    name="coupling",
    summary="Elastic tie between the two yarn families, paper eqs. (2) and (6)",
    parameters=(Parameter("stiffness", "N/m^3", "coupling stiffness K_c", usual=(1e3, 1e13)),),
    needs=Needs(placements=2),
    energy=energy,
    resists=frozenset({"slipping"}),
)
