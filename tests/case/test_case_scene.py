"""Which scenes make a sheet, and what they need."""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain, combinations
from math import pi
from pathlib import Path

import pytest

from forms import catalogue
from forms.effect import Effect, Needs, Parameter
from wovenfab.case import CaseError, EdgeCondition, read_case
from wovenfab.case.mobility import free_motion
from wovenfab.case.needs import Values, lacking, needs_of

SIX = ("bending", "coupling", "shear", "slip_friction", "spin_friction", "stretch")
ONE: dict[str, Values] = {name: {"stiffness": 1.0} for name in SIX}
SCENES = [*chain.from_iterable(combinations(SIX, n) for n in range(7))]

HELD = EdgeCondition.model_validate("clamp")
X_HELD = EdgeCondition.model_validate({"displacement": [0, "free"]})
Y_HELD = EdgeCondition.model_validate({"displacement": ["free", 0]})
DIRECTIONS_HELD = EdgeCondition.model_validate(
    {"displacement": ["free", "free"], "rotation": "held"}
)
BIAS, ALONG = (pi / 4, -pi / 4), (0.0, pi / 2)
TURN, SHEAR = "turn as a whole", "turn as a whole or shear uniformly"


@pytest.mark.parametrize("scene", SCENES, ids="+".join)
def test_a_sheet_resists_stretch_and_shear(scene: tuple[str, ...]) -> None:
    sound = "stretch" in scene and ("shear" in scene or "bending" in scene)
    assert (lacking({name: ONE[name] for name in scene}) is None) == sound


def test_an_effect_with_a_zero_resists_nothing() -> None:
    scene = {**ONE, "stretch": {"stiffness": (1.0, 0.0)}}
    assert lacking(scene) == ("stretch", "nothing resists stretching of the yarns")
    free = {name: ONE[name] for name in ("stretch", "shear")} | {"coupling": {"stiffness": 0.0}}
    assert lacking(free) is not None


def test_needs_are_those_of_all_effects_together() -> None:
    assert needs_of(()) == Needs(placements=1, second_gradient=False, rate=False)
    assert needs_of(("stretch", "bending")) == Needs(1, second_gradient=True)
    assert needs_of(("bending", "coupling", "spin_friction")) == Needs(2, True, True)


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
    ],
)
def test_motions_that_cost_nothing_are_found(
    fibres: tuple[float, float],
    shear_resisted: bool,
    boundary: dict[str, EdgeCondition],
    motion: str | None,
) -> None:
    assert free_motion((0.9, 0.3), fibres, boundary, shear_resisted) == motion


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_motions_do_not_depend_on_the_size_of_the_sheet(scale: float) -> None:
    assert free_motion((3 * scale, scale), BIAS, {"left": HELD}, False) is None
    assert free_motion((3 * scale, scale), ALONG, {"left": HELD}, False) == SHEAR


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
        resists=frozenset({"slip"}),
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
