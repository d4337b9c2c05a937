"""Viscous sliding of the families: R = c/2 |w|^2, w the rate of chi_1 - chi_2.

The linear limit of slip friction at low rates, with c = zeta eta.
"""

from __future__ import annotations

from typing import Any

import ufl

from wovenfab.forms.effect import Effect, Needs, Parameter, Values
from wovenfab.forms.slip_friction import slip


def dissipation(rate: Any, values: Values) -> Any:
    """Return the Rayleigh potential (W/m^2) of a slip rate, shape (2,), m/s."""
    return values["viscosity"] / 2 * ufl.dot(rate, rate)


EFFECT = Effect(
    name="viscous_slip",
    summary="Viscous sliding of the yarns, the linear limit of slip friction",
    parameters=(Parameter("viscosity", "N*s/m^3", "stress c per rate of slip"),),
    needs=Needs(placements=2, rate=True),
    dissipation=dissipation,
    measure=slip,
    resists=frozenset({"slipping"}),
)
