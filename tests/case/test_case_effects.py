"""Which scenes make a sheet, and what they need."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from wovenfab import forms
from wovenfab.case import CaseError, read_case
from wovenfab.case.effects import (
    Scene,
    SceneEffect,
    Values,
    acting_effects,
    missing_resistance,
    needs_of_scene,
)
from wovenfab.forms.effect import Needs


def scene_of(*names: str, **values: Values) -> Scene:
    """Return a scene in which all values are one unless given."""
    return tuple(
        SceneEffect(effect, values.get(name, {p.name: 1.0 for p in effect.parameters}))
        for name, effect in forms.effects().items()
        if name in (*names, *values)
    )


def lack(scene: Scene) -> str | None:
    """Return what a scene does not resist."""
    found = missing_resistance(scene, acting_effects(scene))
    return found[0] if found else None


def test_an_effect_with_a_zero_resists_nothing() -> None:
    assert lack(scene_of("stretch", "shear", "bending", "coupling")) is None
    assert lack(scene_of("shear", stretch={"stiffness": (1.0, 0.0)})) == "stretching"
    assert lack(scene_of("stretch", shear={"stiffness": 0.0})) == "shearing"
    assert lack(scene_of("stretch", "shear", coupling={"stiffness": 0.0})) == "slipping"


def test_needs_are_those_of_all_effects_together() -> None:
    assert needs_of_scene(()) == Needs(placements=1, second_gradient=False, rate=False)
    assert needs_of_scene(scene_of("stretch", "bending")) == Needs(1, second_gradient=True)
    assert needs_of_scene(scene_of("bending", "coupling", "spin_friction")) == Needs(2, True, True)


def test_bending_alone_needs_edges_that_hold_both_families(
    example: str, write_case: Callable[[str], Path]
) -> None:
    text = example.replace("  shear: {stiffness: 400 N/m}\n", "")
    assert "shear" not in read_case(write_case(text)).effects
    text = text.replace("[45 deg, -45 deg]", "[0, 90 deg]")
    text = text.replace("[program, 0]", "[program, free]")
    with pytest.raises(CaseError, match="shear uniformly"):
        read_case(write_case(text))
