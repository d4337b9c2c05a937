"""Which scenes make a sheet, and what they need."""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from pathlib import Path

import pytest

from forms import catalogue
from forms.effect import Effect, Needs, Parameter
from wovenfab.case import CaseError, EdgeCondition, SceneEffect, read_case
from wovenfab.case.boundary import free_motion
from wovenfab.case.effects import Scene, Values, acting, lacking, needs_of_scene

HELD = EdgeCondition.model_validate("clamp")
X_HELD = EdgeCondition.model_validate({"displacement": [0, "free"]})
Y_HELD = EdgeCondition.model_validate({"displacement": ["free", 0]})
DIRECTIONS_HELD = EdgeCondition.model_validate({"rotation": "held"})
DIRECTION_1_HELD = EdgeCondition.model_validate({"rotation": "held", "family": 1})
DIRECTION_2_HELD = EdgeCondition.model_validate({"rotation": "held", "family": 2})
LOADED = EdgeCondition.model_validate({"force": [1, 1]})
BIAS, ALONG = (pi / 4, -pi / 4), (0.0, pi / 2)
TURN, SHEAR = "turn as a whole", "turn as a whole or shear uniformly"


def scene_of(*names: str, **values: Values) -> Scene:
    """Return a scene in which all values are one unless given."""
    return tuple(
        SceneEffect(effect, values.get(name, {p.name: 1.0 for p in effect.parameters}))
        for name, effect in catalogue.effects().items()
        if name in (*names, *values)
    )


def lack(scene: Scene) -> str | None:
    """Return what a scene does not resist."""
    found = lacking(scene, acting(scene))
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


@pytest.mark.parametrize(
    ("fibres", "shear_resisted", "boundary", "motion"),
    [
        (BIAS, True, {"left": HELD}, None),
        (BIAS, True, {}, "move along x"),
        (BIAS, True, {"left": X_HELD, "right": X_HELD}, "move along y"),
        (BIAS, True, {"left": X_HELD, "bottom": Y_HELD}, None),
        (BIAS, True, {"left": Y_HELD, "bottom": X_HELD}, TURN),
        (BIAS, True, {"left": Y_HELD, "right": Y_HELD, "bottom": X_HELD}, None),
        # Only bending: an edge along a fibre does not keep that family from turning.
        (BIAS, False, {"left": HELD}, None),
        (ALONG, False, {"left": HELD}, SHEAR),
        (ALONG, False, {"left": HELD, "right": HELD}, None),
        (ALONG, False, {"left": HELD, "bottom": Y_HELD}, None),
        (ALONG, False, {"left": HELD, "top": DIRECTIONS_HELD}, None),
        (BIAS, False, {"left": X_HELD, "bottom": Y_HELD}, SHEAR),
        # With the left edge clamped, which lies along family 2, only family 1 can turn.
        (ALONG, False, {"left": HELD, "top": DIRECTION_1_HELD}, None),
        (ALONG, False, {"left": HELD, "top": DIRECTION_2_HELD}, SHEAR),
        # A force holds nothing.
        (BIAS, True, {"left": LOADED}, "move along x"),
        (BIAS, True, {"left": X_HELD, "bottom": Y_HELD, "top": LOADED}, None),
    ],
)
def test_motions_that_cost_nothing_are_found(
    fibres: tuple[float, float],
    shear_resisted: bool,
    boundary: dict[str, EdgeCondition],
    motion: str | None,
) -> None:
    edges = {name: (condition,) for name, condition in boundary.items()}
    assert free_motion((0.9, 0.3), fibres, edges, shear_resisted) == motion


def test_what_holds_one_of_two_tied_families_holds_both() -> None:
    x_of_1 = EdgeCondition.model_validate({"displacement": [0, "free"], "family": 1})
    y_of_2 = EdgeCondition.model_validate({"displacement": ["free", 0], "family": 2})
    assert free_motion((0.9, 0.3), BIAS, {"left": (x_of_1,)}, True) == "move along y"
    edges = {"left": (x_of_1, y_of_2), "right": (y_of_2,)}
    assert free_motion((0.9, 0.3), BIAS, edges, True) is None


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_motions_do_not_depend_on_the_size_of_the_sheet(scale: float) -> None:
    assert free_motion((3 * scale, scale), BIAS, {"left": (HELD,)}, False) is None
    assert free_motion((3 * scale, scale), ALONG, {"left": (HELD,)}, False) == SHEAR


def test_bending_alone_needs_edges_that_hold_both_families(
    example: str, write_case: Callable[[str], Path]
) -> None:
    text = example.replace("  shear: {stiffness: 400 N/m}\n", "")
    assert "shear" not in read_case(write_case(text)).effects
    text = text.replace("[45 deg, -45 deg]", "[0, 90 deg]")
    text = text.replace("[program, 0]", "[program, free]")
    with pytest.raises(CaseError, match="shear uniformly"):
        read_case(write_case(text))


def test_a_new_effect_is_a_key_without_another_edit(
    example: str, write_case: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    drag = Effect(
        name="drag",
        summary="Something new",
        parameters=(Parameter("factor", "N*s/m^3", "how much", zero_allowed=False),),
        needs=Needs(placements=2, rate=True),
        dissipation=lambda rate, values: rate,
        measure=lambda point: point,
        resists=frozenset({"slipping"}),
    )
    known = {**catalogue.effects(), "drag": drag}
    monkeypatch.setattr(catalogue, "effects", lambda: known)
    old = "coupling: {stiffness: 6.0e7 N/m^3}"
    case = read_case(write_case(example.replace(old, "drag: {factor: 3 kN*s/m^3}")))
    assert case.effects["drag"] == {"factor": 3000.0}
    with pytest.raises(CaseError) as caught:
        read_case(write_case(example.replace(old, "drag: {factor: 0 N/m}")))
    assert str(caught.value) == (
        "case.yaml:11: effects.drag.factor: expected a value in N*s/m^3 such as '1 N*s/m^3', "
        "got 'N/m'."
    )
