"""Friction of yarns that turn on each other, eqs. (10) and (11).

R = zeta/eta log cosh(eta dgamma/dt), and Coulomb's law as eta grows. Yarns that stick may turn
elastically before they slide, all at once or little by little.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from wovenfab.forms.effect import Effect, Needs, Parameter, Values
from wovenfab.forms.friction import (
    COULOMB,
    ELEMENTS,
    SMOOTH,
    ElasticSliding,
    smoothed_coulomb,
)
from wovenfab.forms.kinematics import Point, shear_angle


def angle(point: Point) -> Any:
    """Return the shear angle gamma (rad)."""
    return shear_angle(point.f, point.fibres)


def components(point: Point) -> list[Any]:
    """Return the shear angle (rad) as the one component."""
    return [angle(point)]


def dissipation(rate: Any, values: Values) -> Any:
    """Return the Rayleigh potential (W/m^2) of a shear rate (rad/s)."""
    return smoothed_coulomb(rate, values["strength"], values["slope"])


STRENGTH = Parameter(
    "strength",
    "N/m",
    "largest friction torque per area zeta_spin",
    usual=(1e-3, 1e5),
    of_angle=True,
)
STIFFNESS = Parameter("stiffness", "N/m", "torque per area and angle before sliding", above=0.0)
ELASTIC = ElasticSliding(components, ("turned",), "rad")
IWAN = replace(ELASTIC, elements=ELEMENTS)

EFFECT = Effect(
    name="spin_friction",
    summary="Friction between yarns that rotate on each other, paper eqs. (10) and (11)",
    parameters=(
        STRENGTH,
        Parameter(
            "slope", "s", "eta_spin, one over the shear rate of saturation", zero_allowed=False
        ),
    ),
    needs=Needs(rate=True),
    dissipation=dissipation,
    measure=angle,
    bound=SMOOTH,
    resists=frozenset({"shearing"}),
    law="smooth",
    laws=(
        Effect(
            name="spin_friction",
            summary="Friction between yarns that rotate on each other, the limit of a large slope",
            parameters=(STRENGTH,),
            needs=Needs(increment=True),
            measure=angle,
            bound=COULOMB,
            resists=frozenset({"shearing"}),
            law="coulomb",
        ),
        Effect(
            name="spin_friction",
            summary="Friction between yarns that turn elastically on each other before they slide",
            parameters=(STRENGTH, STIFFNESS),
            resists=frozenset({"shearing"}),
            law="elastic",
            energy=ELASTIC.energy,
            lost=ELASTIC.lost,
            memory=ELASTIC.memory(),
        ),
        Effect(
            name="spin_friction",
            summary="Friction between yarns that begin to slide on each other little by little",
            parameters=(STRENGTH, STIFFNESS),
            resists=frozenset({"shearing"}),
            law="iwan",
            energy=IWAN.energy,
            lost=IWAN.lost,
            memory=IWAN.memory(),
        ),
    ),
)
