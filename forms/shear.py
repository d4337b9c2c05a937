"""Shear between the families: K_s/2 tan^2(gamma), eqs. (2), (4), or a measured law."""

from __future__ import annotations

from functools import partial
from typing import Any

import ufl

from wovenfab.forms.effect import Effect, Parameter, Strain, Values
from wovenfab.forms.kinematics import Point, rest_angle, shear_angle, shear_tangent
from wovenfab.forms.table import TABLE, Column, TableParameter, end_of_table, table_energy


def energy(point: Point, values: Values) -> Any:
    """Return the shear energy density (J/m^2); infinite where the yarns would overlap."""
    return values["stiffness"] / 2 * shear_tangent(point.f, point.fibres) ** 2


def tabulated_strains(point: Point, values: Values) -> tuple[Strain, ...]:
    """Return the shear angle with its measured law, the same for both signs."""
    rest = rest_angle(point.fibres)
    law = partial(_tabulated_energy, rest=rest, pieces=values[TABLE])
    return (Strain(shear_angle(point.f, point.fibres), values["scale"], law=law, mixed=False),)


def _tabulated_energy(gamma: Any, rest: Any, pieces: Any) -> Any:
    """Return the shear energy density (J/m^2) of a table; infinite where the yarns would overlap.

    Beyond the last angle the torque grows by that of the energy k/2 c^4 (tan - tan_end)^2, with c
    the cosine there: it has the slope k of the curve, which it replaces.

    Args:
        gamma: Shear angle, rad.
        rest: Its value at rest, which ``gamma`` is less, rad.
        pieces: Coefficients of the curve.
    """
    end, slope = end_of_table(pieces)
    side = ufl.conditional(ufl.lt(gamma, 0), -1.0, 1.0)  # kernels would divide integers as such
    size, last = side * gamma, rest + side * end
    barrier = ufl.cos(last) ** 2 * (ufl.tan(rest + gamma) - ufl.tan(last))
    beyond = slope / 2 * (barrier**2 - (size - end) ** 2)
    return table_energy(size, pieces) + ufl.conditional(ufl.gt(size, end), beyond, 0)


EFFECT = Effect(
    name="shear",
    summary="Shear with a barrier against overlapping yarns, paper eqs. (2) and (4)",
    parameters=(Parameter("stiffness", "N/m", "shear stiffness K_s", usual=(0.01, 1e6)),),
    energy=energy,
    resists=frozenset({"shearing"}),
    law="tangent",
    laws=(
        Effect(
            name="shear",
            summary="Shear by a measured curve, with a barrier beyond it",
            parameters=(Parameter("scale", "1", "factor of all torques", default=1.0),),
            strains=tabulated_strains,
            resists=frozenset({"shearing"}),
            law="table",
            table=TableParameter(
                Column("angle", "rad", "shear angle gamma"),
                Column("force", "N/m", "torque per area dW/dgamma"),
            ),
        ),
    ),
)
