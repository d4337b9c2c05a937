"""Friction of yarns that slide over each other, eqs. (7) to (9).

R = zeta/eta sum_i log cosh(eta w_i), with w_i the components of the rate of
chi_1 - chi_2 along the reference directions D_1 and D_2. Its limit as eta grows is
Coulomb's law for each component. Yarns that stick may be elastic before they slide,
all at once or little by little.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import ufl

from wovenfab.forms.effect import Effect, Needs, Parameter, Values
from wovenfab.forms.friction import (
    COULOMB,
    ELEMENTS,
    SMOOTH,
    ElasticSliding,
    smoothed_coulomb,
)
from wovenfab.forms.kinematics import Point


def slip(point: Point) -> Any:
    """Return chi_1 - chi_2 along D_1 and D_2, shape (2,), m."""
    return ufl.as_vector([ufl.dot(point.slip, d) for d in point.fibres])


def components(point: Point) -> list[Any]:
    """Return the two components of the slip, m."""
    found = slip(point)
    return [found[0], found[1]]


def dissipation(rate: Any, values: Values) -> Any:
    """Return the Rayleigh potential (W/m^2) of a slip rate, shape (2,), m/s."""
    return sum(smoothed_coulomb(rate[i], values["strength"], values["slope"]) for i in range(2))


STRENGTH = Parameter(
    "strength", "N/m^2", "largest friction stress zeta", usual=(1.0, 1e8), of_angle=True
)
STIFFNESS = Parameter("stiffness", "N/m^3", "stress per slip before sliding", above=0.0)
ELASTIC = ElasticSliding(components, ("slid_1", "slid_2"), "m")
IWAN = replace(ELASTIC, elements=ELEMENTS)

EFFECT = Effect(
    name="slip_friction",
    summary="Friction between sliding yarns, paper eqs. (7) to (9)",
    parameters=(
        STRENGTH,
        Parameter("slope", "s/m", "eta, one over the slip rate of saturation", zero_allowed=False),
    ),
    needs=Needs(placements=2, rate=True),
    dissipation=dissipation,
    measure=slip,
    bound=SMOOTH,
    resists=frozenset({"slipping"}),
    law="smooth",
    laws=(
        Effect(
            name="slip_friction",
            summary="Friction between sliding yarns, the limit of a large slope",
            parameters=(STRENGTH,),
            needs=Needs(placements=2, increment=True),
            measure=slip,
            bound=COULOMB,
            resists=frozenset({"slipping"}),
            law="coulomb",
        ),
        Effect(
            name="slip_friction",
            summary="Friction between yarns that stick elastically before they slide",
            parameters=(STRENGTH, STIFFNESS),
            needs=Needs(placements=2),
            resists=frozenset({"slipping"}),
            law="elastic",
            energy=ELASTIC.energy,
            lost=ELASTIC.lost,
            memory=ELASTIC.memory(),
        ),
        Effect(
            name="slip_friction",
            summary="Friction between yarns that begin to slide little by little",
            parameters=(STRENGTH, STIFFNESS),
            needs=Needs(placements=2),
            resists=frozenset({"slipping"}),
            law="iwan",
            energy=IWAN.energy,
            lost=IWAN.lost,
            memory=IWAN.memory(),
        ),
    ),
)
