"""Crimp: yarns that become straight before they stretch, and that bend each other.

Both families are sawtooth lines through the crossings (Kawabata, Niwa, Kawai, J. Text. Inst. 64,
1973). A yarn with the crimp c has the length (1 + c) p between crossings at the distance p, and
rises by h there, h^2 = ((1 + c)^2 - 1) p^2, the same h for both. They stay in contact: the share t
of h that one family loses, the other one gains. With s = 1 - 1/(1 + c)^2 Green's strains are

    e_1 = (|f_1|^2 - 1) (1 - s_1)/2 + s_1 ((1 - t)^2 - 1)/2, and e_2 with 1 + t,

and the energy is the least over t of w_1(e_1) + w_2(e_2) + R t^2/2: the interchange is condensed
out. With b = R/(K s), w = K/4 e^2 (1 + e/((e^2 + b^2)^(1/2) + b)) is convex. Its slope, the force,
comes near K e in tension; in compression, where yarns buckle, its size is below R/(4 s). As e is
convex in stretch and t, there is one t. By the stretch f of a family, w has the second derivative
w'' (1 - s)^2 f^2 + w' (1 - s), which is above -R (1 - s)/(4 s); by t, the sum has more than
R - R/4 - R/4. So the condensed energy plus R (1 - s)/(8 s) f^2 of each family is convex. Where
R is small beside K s, states of compression come near the bound.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import ufl

from wovenfab.forms.effect import Effect, Parameter, Values
from wovenfab.forms.kinematics import Point, unlabelled

#: Newton's steps for the interchange, from none: rounding is reached in six to twelve.
ITERATIONS = 11


class _Yarn(NamedTuple):
    """A family at some interchange t.

    Attributes:
        energy, force, stiffness: w and its first two derivatives by the strain.
        growth, curvature: First two derivatives of the strain by t.
    """

    energy: Any
    force: Any
    stiffness: Any
    growth: Any
    curvature: Any


def _yarns(point: Point, values: Values, t: Any) -> list[_Yarn]:
    yarns = []
    families = zip((-1, 1), point.f, values["stiffness"], values["crimp"], strict=True)
    for sign, f, k, crimp in families:
        s, height = 1 - 1 / (1 + crimp) ** 2, 1 + sign * t
        e = ((ufl.dot(f, f) - 1) * (1 - s) + s * (height**2 - 1)) / 2
        b = values["resistance"] / (k * s)
        root = ufl.sqrt(e**2 + b**2)
        x = e / root
        energy = k / 4 * e**2 * (1 + e / (root + b))
        force = k / 4 * (2 * e + root * (1 + x**2) - b)
        stiffness = k / 4 * (2 + 3 * x - x**3)
        yarns.append(_Yarn(energy, force, stiffness, sign * s * height, s))
    return yarns


def _improved(point: Point, values: Values, t: Any) -> Any:
    """Return the interchange after one more step of Newton's method."""
    yarns, resistance = _yarns(point, values, t), values["resistance"]
    slope = resistance * t + sum(y.force * y.growth for y in yarns)
    return t - slope / (
        resistance + sum(y.stiffness * y.growth**2 + y.force * y.curvature for y in yarns)
    )


def energy(point: Point, values: Values) -> Any:
    """Return the energy density (J/m^2) of both families.

    As it is stationary in t, its first two derivatives need those of the last step alone: the
    others are left out of kernels, which compile in a fourth of the time.
    """
    fixed, t = unlabelled(point), ufl.as_ufl(0.0)
    for _ in range(ITERATIONS):
        t = _improved(fixed, values, t)
    t = _improved(point, values, t)
    return values["resistance"] / 2 * t**2 + sum(y.energy for y in _yarns(point, values, t))


def stretch_stiffness(values: Values) -> tuple[Any, Any]:
    """Return the least stiffness (N/m) of each family by its stretch, which is negative."""
    shares = [1 - 1 / (1 + crimp) ** 2 for crimp in values["crimp"]]
    first, second = (-values["resistance"] * (1 - s) / (4 * s) for s in shares)
    return first, second


EFFECT = Effect(
    name="crimp",
    summary="Stretch of crimped yarns with interchange between the families (Kawabata et al. 1973)",
    parameters=(
        Parameter(
            "stiffness", "N/m", "stiffness K of straight yarns", per_family=True, zero_allowed=False
        ),
        Parameter(
            "crimp",
            "1",
            "length c of a yarn over that of the fabric, less one",
            per_family=True,
            zero_allowed=False,
            usual=(1e-3, 0.5),
        ),
        Parameter(
            "resistance", "N/m", "resistance R of the crimp to interchange", zero_allowed=False
        ),
    ),
    energy=energy,
    stretch_stiffness=stretch_stiffness,
)
