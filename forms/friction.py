"""Coulomb's law, its smooth approximation from rate and stress, and elastic sliding."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import ufl

from wovenfab.forms.balance import Balance
from wovenfab.forms.effect import DualFrictionLaw, InternalVariable, Term, Values
from wovenfab.forms.kinematics import Point, point_of

#: Gauss's rule on (-1, 1).
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(3)


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
        weight / 2 * ufl.replace(value, {angle: start + (1 + point) / 2 * (end - start)})
        for point, weight in zip(POINTS.tolist(), WEIGHTS.tolist(), strict=True)
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


def elastic_sliding(
    components: Callable[[Point], Sequence[Any]], names: Sequence[str], unit: str
) -> dict[str, Any]:
    """Return the energy, the loss and the memory of a friction that is elastic before it slides.

    Each component of its measure has a spring (``stiffness``) in series with a slider
    (``strength``): Jenkins's element (Iwan, J. Appl. Mech. 1966, doi:10.1115/1.3625199).

    Args:
        components: Returns the components of the measure.
        names: Of the internal variables, the position of each slider.
        unit: SI unit of the measure.
    """

    def stretches(point: Point, values: Values) -> list[Any]:
        return [m - values[n] for m, n in zip(components(point), names, strict=True)]

    def law(values: Values) -> tuple[Any, Any]:
        return values["strength"], values["stiffness"]

    def energy(point: Point, values: Values) -> Any:
        return sum(elastic_potential(s, *law(values)) for s in stretches(point, values))

    def lost(moved: Sequence[Any], values: Values) -> Any:
        return sum(
            values["strength"] * abs(m - values[n]) for m, n in zip(moved, names, strict=True)
        )

    def slide(number: int, now: Point, before: Point, values: Values, step: Any) -> Any:
        stretch = stretches(now, values)[number]
        return values[names[number]] + sliding(stretch, *law(values))

    memory = tuple(
        InternalVariable(name, unit, "position of the slider", partial(slide, i))
        for i, name in enumerate(names)
    )
    return {"energy": energy, "lost": lost, "memory": memory}


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
