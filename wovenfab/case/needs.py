"""What follows from the effects of a scene, and whether they make a sheet at all."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from forms import catalogue
from forms.effect import Effect, Needs

from .expression import Expression
from .scene import Scene, SceneEffect

#: What an effect may say that it resists.
RESISTIBLE = ("stretching", "shearing", "slipping", "curving")


def needs_of(effects: Iterable[Effect]) -> Needs:
    """Return what some effects need together."""
    needs = [effect.needs for effect in effects]
    return Needs(
        placements=max((n.placements for n in needs), default=1),
        second_gradient=any(n.second_gradient for n in needs),
        rate=any(n.rate for n in needs),
        increment=any(n.increment for n in needs),
    )


def needs_of_scene(scene: Scene) -> Needs:
    """Return what the effects of a scene need together."""
    return needs_of(e.effect for e in scene)


def acting(scene: Scene) -> list[SceneEffect]:
    """Return the effects without a zero among their values; formulas are taken as positive."""
    return [e for e in scene if all(map(_positive, e.values.values()))]


def resisted(effects: Iterable[SceneEffect]) -> frozenset[str]:
    """Return what some effects keep from moving freely."""
    return frozenset().union(*(e.effect.resists for e in effects))


def lacking(scene: Scene, act: Collection[SceneEffect]) -> tuple[str, str] | None:
    """Return what no effect resists and that in a sentence, or None for a sound sheet.

    Bending does in place of shear: among fibres that keep their length, the only
    displacements without curvature are a_1 + a_2 y along x and b_1 + b_2 x along y
    (x, y along the fibres), that is, rigid motions and one uniform shear, which the
    held edges must exclude; ``mobility.free_motion`` tells whether they do.

    Args:
        scene: All effects, which decide what is built.
        act: Those that act, which decide what is resisted.
    """
    resists = resisted(act)
    if "stretching" not in resists:
        return "stretching", "nothing resists stretching of the yarns"
    if not resists & {"shearing", "curving"}:
        return "shearing", "nothing resists shear between the families"
    if needs_of_scene(scene).placements == 2 and "slipping" not in resists:
        return "slipping", "nothing ties the two families together where they are not held"
    return None


def providers(resistance: str, scene: Scene = ()) -> list[str]:
    """Return the names of all effects that resist something, those of a scene included."""
    known = {**catalogue.effects(), **{e.name: e.effect for e in scene}}
    return [name for name, effect in known.items() if resistance in effect.resists]


def with_second_gradient() -> list[str]:
    """Return the names of all effects of forms/ that depend on second derivatives."""
    return [name for name, e in catalogue.effects().items() if e.needs.second_gradient]


def with_two_placements() -> list[str]:
    """Return the names of all effects of forms/ that need a placement for each family."""
    return [name for name, e in catalogue.effects().items() if e.needs.placements == 2]


def _positive(value: float | Expression | tuple[float | Expression, ...]) -> bool:
    if isinstance(value, tuple):
        return all(map(_positive, value))
    return isinstance(value, Expression) or value > 0
