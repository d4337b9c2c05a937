"""First and second variation of energies that are written at a point.

Differentiation is by the few measures at a point (or facet, or edge) rather than
by the field: kernels are smaller and compile faster, and nothing is typed by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import ufl

from forms.effect import Strain
from forms.kinematics import Edge, Facet, Point, label

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


def strain_variation(
    strains: Callable[[Any], tuple[Strain, ...]],
    place: Place,
    trial: Sequence[Any],
    test: Sequence[Any],
    geometric_weight: Any = 1,
    last: Place | None = None,
) -> Any:
    """Return the second variation of a sum of terms that are quadratic in strains.

    That of k/2 s^2 is k ds ds + (k s) dds: an elastic part and a geometric one, by the force. The
    elastic parts of all squares together have no negative eigenvalue: the positive part.

    In a mixed term the force k s of that part is replaced by its linearisation from the last
    iterate, so that a large rotation of a stiff yarn is not taken for a large force
    (Magisano, Leonetti, Garcea, CMAME 2017). At the solution both are the same.

    Args:
        strains: The terms as a function of the place.
        place: A point, facet or edge of the present state.
        trial: Variations of the place's measures by the trial field.
        test: The same by the test field.
        geometric_weight: Factor of all but the positive part.
        last: The place at the last iterate; None for no linearisation.
    """
    labelled, before = label(place), None if last is None else label(last)

    def linearised(old: Any) -> Any:
        assert last is not None and before is not None
        growths = zip(before.measures, place.measures, last.measures, strict=True)
        return old + sum(ufl.inner(ufl.diff(old, m), p - q) for m, p, q in growths)

    def first(measure: Any, variation: Sequence[Any]) -> Any:
        pairs = zip(labelled.measures, variation, strict=True)
        return sum(ufl.inner(ufl.diff(measure, m), v) for m, v in pairs)

    def second(measure: Any) -> Any:
        return sum(
            ufl.inner(ufl.dot(ufl.diff(ufl.diff(measure, n), m), s), t)
            for n, t in zip(labelled.measures, test, strict=True)
            for m, s in zip(labelled.measures, trial, strict=True)
        )

    total = 0
    terms = strains(labelled)
    for now, old in zip(terms, terms if before is None else strains(before), strict=True):
        force = linearised if now.mixed and before is not None else lambda measure: measure
        source = old if now.mixed else now
        for (a, b), (u, v) in zip(_products(now), _products(source), strict=True):
            if now.other is None:
                part = first(a, trial) * first(a, test) + geometric_weight * force(u) * second(a)
            else:
                part = first(a, trial) * first(b, test) + first(b, trial) * first(a, test)
                part = geometric_weight * (part + force(u) * second(b) + force(v) * second(a))
            total += now.stiffness * part
    return total


def _products(strain: Strain) -> list[tuple[Any, Any]]:
    """Return the scalars whose products make up the term."""
    a, b = strain.measure, strain.measure if strain.other is None else strain.other
    return [(a[i], b[i]) for i in range(len(a))] if ufl.shape(a) else [(a, b)]


def _slopes(energy: Callable[[Any], Any], place: Place) -> tuple[Any, list[Any]]:
    labelled = label(place)
    density = energy(labelled)
    return labelled, [ufl.diff(density, m) for m in labelled.measures]
