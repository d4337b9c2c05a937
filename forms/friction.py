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


#: Springs with sliders in parallel of the law that yields gradually. Its force differs from that of
#: very many by zeta/(4 n^2) at most, 0.4 % of the strength; measured loops scatter by more.
ELEMENTS = 8


@dataclass(frozen=True)
class ElasticSliding:
    """A friction that is elastic before it slides.

    Each component of its measure has elements in parallel, each a spring in series with a slider
    (Iwan, J. Appl. Mech. 1966, doi:10.1115/1.3625199). Springs are equal; strengths are spread
    evenly, such that n elements have k and zeta in all: k/n, and zeta (2i - 1)/n^2 of the i-th.
    One element bears k s up to zeta. Very many bear k s - (k s)^2/(4 zeta) up to s = 2 zeta/k.

    Attributes:
        components: Returns the components of the measure.
        names: Of the positions of the sliders of each component.
        unit: SI unit of the measure.
        elements: Number n of elements in parallel.
    """

    components: Callable[[Point], Sequence[Any]]
    names: tuple[str, ...]
    unit: str
    elements: int = 1

    def energy(self, point: Point, values: Values) -> Any:
        """Return the potential of a step (J/m^2), which is the energy of springs that hold."""
        return sum(
            elastic_potential(measure - values[name], *self._law(i, values))
            for measure, name, i in self._sliders(self.components(point))
        )

    def lost(self, moved: Sequence[Any], values: Values) -> Any:
        """Return what the sliders lose (J/m^2) as they move to where they are after a step."""
        sliders = zip(moved, self._sliders(self.names), strict=True)
        return sum(self._law(i, values)[0] * abs(m - values[name]) for m, (_, name, i) in sliders)

    def slide(self, number: int, now: Point, before: Point, values: Values, step: Any) -> Any:
        """Return the position of a slider after a step."""
        measure, name, i = self._sliders(self.components(now))[number]
        return values[name] + sliding(measure - values[name], *self._law(i, values))

    def memory(self) -> tuple[InternalVariable, ...]:
        """Return the internal variables."""
        return tuple(
            InternalVariable(name, self.unit, "position of the slider", partial(self.slide, number))
            for number, (_, name, _) in enumerate(self._sliders(self.names))
        )

    def _law(self, element: int, values: Values) -> tuple[Any, Any]:
        """Return strength and stiffness of an element, counted from 0."""
        n = self.elements
        return values["strength"] * ((2 * element + 1) / n**2), values["stiffness"] / n

    def _sliders[T](self, components: Sequence[T]) -> list[tuple[T, str, int]]:
        """Return the component, the name and the element of each slider."""
        return [
            (component, name if self.elements == 1 else f"{name}_{i + 1}", i)
            for component, name in zip(components, self.names, strict=True)
            for i in range(self.elements)
        ]


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
