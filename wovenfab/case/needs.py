"""What follows from the effects of a scene, and whether they make a sheet at all."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from forms import catalogue
from forms.effect import Needs

#: Parameter values in SI by name; a pair where they are given for each family.
Values = Mapping[str, float | tuple[float, float]]


def needs_of(effects: Iterable[str]) -> Needs:
    """Return what all the named effects need together."""
    needs = [catalogue.effects()[name].needs for name in effects]
    return Needs(
        placements=max((n.placements for n in needs), default=1),
        second_gradient=any(n.second_gradient for n in needs),
        rate=any(n.rate for n in needs),
    )


def resisted(effects: Mapping[str, Values]) -> frozenset[str]:
    """Return what the effects keep from moving freely; one with a zero does not count."""
    acting = [name for name, values in effects.items() if all(map(_positive, values.values()))]
    return frozenset().union(*(catalogue.effects()[name].resists for name in acting))


def lacking(effects: Mapping[str, Values]) -> tuple[str, str] | None:
    """Return what no effect resists and that in a sentence, or None for a sound sheet.

    Bending does in place of shear: among fibres that keep their length, the only
    displacements without curvature are a_1 + a_2 y along x and b_1 + b_2 x along y
    (x, y along the fibres), that is, rigid motions and one uniform shear, which the
    held edges must exclude; ``mobility.free_motion`` tells whether they do.
    """
    resists = resisted(effects)
    if "stretch" not in resists:
        return "stretch", "nothing resists stretching of the yarns"
    if not resists & {"shear", "bending"}:
        return "shear", "nothing resists shear between the families"
    if needs_of(effects).placements == 2 and "slip" not in resists:
        return "slip", "nothing ties the two families together where they are not held"
    return None


def providers(resistance: str) -> list[str]:
    """Return the names of all effects that resist something."""
    return [name for name, effect in catalogue.effects().items() if resistance in effect.resists]


def with_second_gradient() -> list[str]:
    """Return the names of all effects that depend on second derivatives."""
    return [name for name, e in catalogue.effects().items() if e.needs.second_gradient]


def _positive(value: float | tuple[float, float]) -> bool:
    return min(value) > 0 if isinstance(value, tuple) else value > 0
