"""First and second variation of energies that are written at a point.

Differentiation is by the few measures at a point (or facet, or edge) rather than
by the field: kernels are smaller and compile faster, and nothing is typed by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import ufl

from .effect import Strain
from .kinematics import Edge, Facet, Point, label

Place = Point | Facet | Edge


def first_variation(energy: Callable[[Any], Any], place: Place, test: Sequence[Any]) -> Any:
    """Return the first variation of ``energy(place)``.

    Args:
        energy: Density as a function of the place.
        place: A point, facet or edge of the present state.
        test: Variations of its measures by the test field, in their order.
    """
    _, slopes = _slopes(energy, place)
    return sum(ufl.inner(s, t) for s, t in zip(slopes, test, strict=True))


def second_variation(
    energy: Callable[[Any], Any], place: Place, trial: Sequence[Any], test: Sequence[Any]
) -> Any:
    """Return the second variation of ``energy(place)``; arguments as above."""
    labelled, slopes = _slopes(energy, place)
    return sum(
        ufl.inner(ufl.dot(ufl.diff(slope, measure), s), t)
        for slope, t in zip(slopes, test, strict=True)
        for measure, s in zip(labelled.measures, trial, strict=True)
    )


def mixed_variation(
    strains: Callable[[Any], tuple[Strain, ...]],
    place: Point,
    last: Point,
    trial: Sequence[Any],
    test: Sequence[Any],
) -> Any:
    """Return the mixed-integration-point tangent of a sum of quadratic strain energies.

    The second variation of k/2 s^2 is k ds ds + (k s) dds. In the geometric part
    the force k s is replaced by its linearisation from the last iterate, so that a
    large rotation of a stiff yarn is not taken for a large force
    (Magisano, Leonetti, Garcea, CMAME 2017). At the solution both are the same.

    Args:
        strains: The quadratic terms as a function of the point.
        place: Point of the present iterate.
        last: Point of the last iterate.
        trial: Variations of the point's measures by the trial field.
        test: The same by the test field.
    """
    labelled = label(place)
    before = label(last)
    total = 0
    for now, old in zip(strains(labelled), strains(before), strict=True):
        slopes = [ufl.diff(now.measure, m) for m in labelled.measures]
        growth = sum(
            ufl.inner(ufl.diff(old.measure, m), p - q)
            for m, p, q in zip(before.measures, place.measures, last.measures, strict=True)
        )
        force = now.stiffness * (old.measure + growth)
        total += now.stiffness * _applied(slopes, trial) * _applied(slopes, test)
        total += force * sum(
            ufl.inner(ufl.dot(ufl.diff(slope, m), s), t)
            for slope, t in zip(slopes, test, strict=True)
            for m, s in zip(labelled.measures, trial, strict=True)
        )
    return total


def _applied(slopes: Sequence[Any], variation: Sequence[Any]) -> Any:
    return sum(ufl.inner(s, v) for s, v in zip(slopes, variation, strict=True))


def _slopes(energy: Callable[[Any], Any], place: Place) -> tuple[Any, list[Any]]:
    labelled = label(place)
    density = energy(labelled)
    return labelled, [ufl.diff(density, m) for m in labelled.measures]
