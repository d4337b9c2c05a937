"""Coulomb's law, its smooth approximation from rate and stress, and elastic sliding."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import sqrt
from typing import Any

import ufl

from wovenfab.forms.balance import Balance
from wovenfab.forms.effect import DualFrictionLaw, InternalVariable, Term, Values
from wovenfab.forms.kinematics import Point, point_of

#: Points and weights of Gauss's rule on (0, 1).
GAUSS = ((0.5 - sqrt(0.15), 5 / 18), (0.5, 4 / 9), (0.5 + sqrt(0.15), 5 / 18))


def log_cosh(x: Any) -> Any:
    """Return log(cosh(x)) without overflow for any ``x``.

    The sign is a constant for differentiation, so that the second derivative is
    right at x = 0, where that of UFL's ``abs`` is not.
    """
    size = ufl.conditional(ufl.ge(x, 0), 1.0, -1.0) * x
    return size + ufl.ln(1 + ufl.exp(-2 * size)) - ufl.ln(2.0)


def smoothed_coulomb(rate: Any, strength: Any, slope: Any) -> Any:
    """Return zeta/eta log cosh(eta rate), whose derivative is zeta tanh(eta rate).

    Args:
        rate: Scalar rate.
        strength: Largest friction zeta, reached at high rates.
        slope: eta, the inverse of the rate at which friction saturates.
    """
    return strength / slope * log_cosh(slope * rate)


def mean_over_angles(value: Any, angle: Any | None, start: Any, end: Any) -> Any:
    """Return the mean of a value between two shear angles (rad), by three points of Gauss's rule.

    Args:
        value: A UFL scalar; exact if it is of fifth degree in the angle.
        angle: The variable in it that stands for the angle; None if there is none.
        start: First angle.
        end: Last angle.
    """
    if angle is None:
        return value
    return sum(
        weight * ufl.replace(value, {angle: start + point * (end - start)})
        for point, weight in GAUSS
    )


def elastic_potential(stretch: Any, strength: Any, stiffness: Any) -> Any:
    """Return the potential of a spring in series with a slider, convex with a continuous slope.

    It is k/2 s^2 where the spring bears it, else zeta |s| - zeta^2/(2k): the least over the sliding
    p of the step of k/2 (s - p)^2 + zeta |p|.

    Args:
        stretch: s, of the spring if the slider does not move in the step.
        strength: zeta, which the slider resists with.
        stiffness: k of the spring.
    """
    size = ufl.conditional(ufl.ge(stretch, 0), 1.0, -1.0) * stretch
    slides = strength * size - strength**2 / (2 * stiffness)
    return ufl.conditional(ufl.lt(stiffness * size, strength), stiffness / 2 * stretch**2, slides)


def sliding(stretch: Any, strength: Any, stiffness: Any) -> Any:
    """Return by how much the slider of :func:`elastic_potential` moves in the step."""
    most = strength / stiffness
    return ufl.max_value(stretch - most, 0) + ufl.min_value(stretch + most, 0)


@dataclass(frozen=True)
class ElasticSliding:
    """A friction that is elastic before it slides.

    Each component of its measure has a spring (``stiffness``) in series with a slider
    (``strength``): Jenkins's element (Iwan, J. Appl. Mech. 1966, doi:10.1115/1.3625199).

    Attributes:
        components: Returns the components of the measure.
        sliders: Names of the positions of the sliders, which are internal variables.
        unit: SI unit of the measure.
    """

    components: Callable[[Point], Sequence[Any]]
    sliders: tuple[str, ...]
    unit: str

    def energy(self, point: Point, values: Values) -> Any:
        """Return the potential of a step (J/m^2), which is the energy of springs that hold."""
        law = values["strength"], values["stiffness"]
        return sum(elastic_potential(s, *law) for s in self._stretches(point, values))

    def lost(self, moved: Sequence[Any], values: Values) -> Any:
        """Return what the sliders lose (J/m^2) as they move to where they are after a step."""
        pairs = zip(moved, self.sliders, strict=True)
        return sum(values["strength"] * abs(m - values[name]) for m, name in pairs)

    def slide(self, number: int, now: Point, before: Point, values: Values, step: Any) -> Any:
        """Return the position of a slider after a step."""
        stretch = self._stretches(now, values)[number]
        moved = sliding(stretch, values["strength"], values["stiffness"])
        return values[self.sliders[number]] + moved

    def memory(self) -> tuple[InternalVariable, ...]:
        """Return the internal variables."""
        return tuple(
            InternalVariable(name, self.unit, "position of the slider", partial(self.slide, i))
            for i, name in enumerate(self.sliders)
        )

    def _stretches(self, point: Point, values: Values) -> list[Any]:
        pairs = zip(self.components(point), self.sliders, strict=True)
        return [m - values[name] for m, name in pairs]


def smooth_bound(strength: Callable[[Values], Any]) -> DualFrictionLaw:
    """Return the smooth law from the stress, with a strength zeta and a slope eta of the values."""
    return DualFrictionLaw(strength, partial(_creep, strength))


def _creep(strength: Callable[[Values], Any], stress: Any, values: Values) -> Any:
    """Return the rate artanh(stress/zeta)/eta."""
    zeta = strength(values)
    return ufl.ln((zeta + stress) / (zeta - stress)) / (2 * values["slope"])


def _strength(values: Values) -> Any:
    return values["strength"]


#: The smooth law from the stress, and Coulomb's: no rate below the strength, any at it.
SMOOTH, COULOMB = smooth_bound(_strength), DualFrictionLaw(_strength)


def components_of(term: Term, balance: Balance) -> int:
    """Return the number of components of a friction's measure."""
    assert term.effect.measure is not None
    point = point_of(balance.field, balance.fibres, balance.second_gradient)
    shape = term.effect.measure(point).ufl_shape
    return int(shape[0]) if shape else 1
