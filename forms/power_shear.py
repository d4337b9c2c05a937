"""Shear by a power of the angle: K/2 |gamma|^n.

The law of the published pantographic sheets (dell'Isola et al. 2016; Maurin et al.
2019 with n = 1.36 or 2), where pivots between the families resist rotation. It has no
pole: the step limit alone keeps the families from crossing.
"""

from __future__ import annotations

from typing import Any

from wovenfab.forms.effect import Effect, Parameter, Values
from wovenfab.forms.kinematics import Point, shear_angle

#: Angle (rad) below which the law is rounded: for n < 2 its stiffness has no bound at rest.
ROUNDING = 1e-6


def energy(point: Point, values: Values) -> Any:
    """Return the shear energy density (J/m^2), zero at rest."""
    power = values["power"]
    rounded = (shear_angle(point.f, point.fibres) ** 2 + ROUNDING**2) ** (power / 2)
    return values["stiffness"] / 2 * (rounded - ROUNDING**power)


EFFECT = Effect(
    name="power_shear",
    summary="Shear by a power of the angle, as in pantographic sheets (Maurin et al. 2019)",
    parameters=(
        Parameter("stiffness", "N/m", "shear stiffness K", usual=(0.01, 1e6)),
        Parameter("power", "1", "exponent n of |gamma|", above=1.0),
    ),
    energy=energy,
    resists=frozenset({"shearing"}),
)
