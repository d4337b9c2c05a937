"""Shear that is linear in the angle: K/2 gamma^2."""

from wovenfab.forms.effect import Effect, Parameter
from wovenfab.forms.kinematics import shear_angle


def energy(point, values):
    """Return the energy density (J/m^2) at a point of the sheet."""
    gamma = shear_angle(point.f, point.fibres)
    return values["stiffness"] / 2 * gamma**2


EFFECT = Effect(
    name="my_effect",
    summary="Shear that is linear in the angle",
    parameters=(Parameter("stiffness", "N/m", "shear stiffness K"),),
    energy=energy,
    resists=frozenset({"shearing"}),
)
