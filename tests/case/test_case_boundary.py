"""What can be prescribed on an edge, and what cannot."""

from __future__ import annotations

import math
from collections.abc import Callable
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from tests.case.reading import EXAMPLE, again, told
from wovenfab.case import Component, EdgeCondition, Expression, conditions_of, read_case
from wovenfab.case.boundary import free_motion

BAD = YAML(typ="safe").load(EXAMPLE.with_name("bad_edges.yaml"))
FREE = Component(held=False)
HELD = Component()
PULL = "left: {displacement: [0, free]}\nright: {displacement: [program, 0]}"
Change = Callable[..., Path]


@pytest.fixture
def with_edges(example: str, write_case: Callable[[str], Path]) -> Change:
    """Return a function that writes the example with other conditions at its edges."""
    start, end = example.index("boundary:"), example.index("program:\n")

    def write(edges: str, **replaced: str) -> Path:
        lines = "".join(f"  {line}\n" for line in edges.split("\n"))
        text = f"{example[:start]}boundary:\n{lines}{example[end:]}"
        for old, new in replaced.items():
            assert f"  {old}:" in text
            text = "".join(new if f"  {old}:" in r else r for r in text.splitlines(True))
        return write_case(text)

    return write


def test_families_are_held_apart(with_edges: Change) -> None:
    case = read_case(
        with_edges(
            "left: clamp\n"
            "right: [{family: 1, clamp: rotation}, {family: 2, displacement: [program, 0]}]\n"
            "top: {family: 2, displacement: [free, 0]}"
        )
    )
    assert case.boundary["right"] == (
        EdgeCondition(displacement=(0, 0), rotation="held", family=1),
        EdgeCondition(displacement=("program", 0), family=2),
    )
    one, two = case.boundary["right"]
    assert (one.families, one.components, one.rotation) == ((1,), (HELD, HELD), True)
    assert (two.families, two.components, two.rotation) == (
        (2,),
        (Component(factor=1), HELD),
        False,
    )
    assert [(c.families, c.moves) for c in case.boundary["top"]] == [((2,), False)]
    assert [(name, i) for name, i, _ in conditions_of(case.boundary)] == [
        ("left", 0), ("right", 0), ("right", 1), ("top", 0)
    ]  # fmt: skip


def test_displacements_are_formulas_of_x_y_and_the_program(with_edges: Change) -> None:
    turn = ("x*(cos(program/0.3 m)-1) - y*sin(program/0.3 m)",
            "x*sin(program/0.3 m) + y*(cos(program/0.3 m)-1)")  # fmt: skip
    case = read_case(with_edges(f"left: clamp\nright: {{displacement: ['{turn[0]}', '{turn[1]}']}}"
                                .replace("left: clamp\n", "")))  # fmt: skip
    (right,) = case.boundary["right"]
    assert right.moves
    assert right.components[0] == Component(expression=Expression(turn[0], "m"))
    x, y, angle = np.full(5, 0.9), np.linspace(0, 0.3, 5), 0.1
    moved = [c.at(x, y, 0.03) for c in right.components]
    assert np.allclose(x + moved[0], x * math.cos(angle) - y * math.sin(angle), rtol=0, atol=1e-15)
    assert np.allclose(y + moved[1], x * math.sin(angle) + y * math.cos(angle), rtol=0, atol=1e-15)


def test_a_formula_without_variables_is_a_length(with_edges: Change) -> None:
    case = read_case(with_edges("left: clamp\nright: {displacement: [program, 2*5 mm]}"))
    assert case.boundary["right"][0].components[1] == Component(offset=0.01)


def test_a_formula_without_the_program_does_not_move(with_edges: Change) -> None:
    path = with_edges("left: clamp\nright: {displacement: [y/10, 0]}")
    assert "no edge uses the program" in told(path)


def test_every_component_gives_its_displacement_at_points() -> None:
    x = np.array([0.0, 1.0])
    assert Component(factor=-1.0, offset=0.5).at(x, x, 0.2) == pytest.approx([0.3, 0.3])
    assert Component(expression=Expression("x*2", "m")).at(x, x, 0.2) == pytest.approx([0, 2])
    assert Component(expression=Expression("program^2/1 m", "m")).at(x, x, 0.2) == pytest.approx(
        [0.04, 0.04]
    )


def test_directions_may_be_held_alone(with_edges: Change) -> None:
    case = read_case(with_edges(
        "left: clamp\nright: {displacement: [program, 0]}\ntop: {rotation: held}\n"
        "bottom: {rotation: held, family: 1}"
    ))  # fmt: skip
    (top,), (bottom,) = case.boundary["top"], case.boundary["bottom"]
    assert (top.components, top.rotation, top.families) == ((FREE, FREE), True, (1, 2))
    assert (bottom.components, bottom.rotation, bottom.families) == ((FREE, FREE), True, (1,))
    assert not top.moves


def test_dead_loads_are_numbers_or_formulas(with_edges: Change) -> None:
    case = read_case(with_edges(
        "left: clamp\nright: {force: [1 kN/m, 0], displacement: [free, program]}\n"
        "top: {force: [0, '10 N/m*x/0.9 m']}"
    ))  # fmt: skip
    (right,), (top,) = case.boundary["right"], case.boundary["top"]
    assert right.force == (1000.0, 0.0)
    assert right.components == (FREE, Component(factor=1.0))
    assert top.force == (0.0, Expression("10 N/m*x/0.9 m", "N/m"))
    assert top.components == (FREE, FREE)


def test_a_dead_load_alone_takes_a_hold(with_edges: Change) -> None:
    edges = "left: clamp\nright: {force: [1 kN/m, 0]}"
    path = with_edges(edges)
    assert told(path) == (
        "case.yaml:16: program: no edge uses the program. A force may follow it, as in "
        "'10 N/m * program/40 mm'; one that is there from the start takes "
        "{type: hold, duration: 1 s, steps: 1}."
    )
    hold = {"type": "  type: hold\n  duration: 1 s\n", "amplitudes": "", "max_velocity": ""}
    assert read_case(with_edges(edges, **hold)).boundary["right"][0].force == (1000.0, 0.0)


def test_a_force_may_follow_the_program_alone(with_edges: Change) -> None:
    case = read_case(with_edges("left: clamp\nright: {force: [10 N/m * program/40 mm, 0]}"))
    (right,) = case.boundary["right"]
    assert right.follows == {"program"} and not right.moves and not right.acts_initially


@pytest.mark.parametrize(
    "given", ["force: [9 N/m, 0]", "displacement: [1 mm, 0]", "displacement: [free, y/9]"]
)
def test_what_is_there_from_the_start_needs_a_rest_without_friction(
    given: str, with_edges: Change
) -> None:
    edges = f"left: {{displacement: [program, 0]}}\nright: {{{given}}}"
    assert read_case(with_edges(edges)).boundary["right"][0].acts_initially
    assert told(with_edges(edges, coupling="")) == (
        "case.yaml:14: boundary.right: acts from the start, but without friction nothing ties the "
        "two families together where they are not held, so that there is no rest. Let it follow "
        "the program, as in '10 N/m * program/40 mm' or 'min(program, 5 mm)'."
    )
    grows = edges.replace(given, "force: [9 N/m * program/1 m, 0]")
    assert read_case(with_edges(grows, coupling="")).boundary["right"][0].follows


@pytest.mark.parametrize("row", BAD, ids=lambda row: row["edges"].replace("\n", "; "))
def test_what_makes_no_sense_at_an_edge_is_refused(row: dict[str, Any], with_edges: Change) -> None:
    assert told(with_edges(row["edges"])) == "\n".join(
        [says] if isinstance(says := row["says"], str) else says
    )


def test_a_force_of_zero_may_stand_where_all_is_held(with_edges: Change) -> None:
    path = with_edges(f"{PULL}\nbottom: {{force: [0, 0], displacement: [free, 0]}}")
    assert read_case(path).boundary["bottom"][0].force == (0.0, 0.0)


def test_edges_may_meet_where_formulas_agree(with_edges: Change) -> None:
    both = "{displacement: [x*program/0.9 m, 'y*if(program > 0, program, 0)/0.9 m']}"
    case = read_case(with_edges("\n".join(f"{e}: {both}" for e in ("left", "bottom", "right"))))
    assert len(case.boundary) == 3


def test_edges_of_different_families_may_part(with_edges: Change) -> None:
    path = with_edges(
        "left: {family: 1, clamp: placement}\nbottom: {family: 2, displacement: [0, program]}"
    )
    assert len(read_case(path).boundary) == 2


@pytest.mark.parametrize("condition", ["displacement: [free, 0]", "force: [1, 0]"])
def test_one_family_alone_takes_two_placements(condition: str, with_edges: Change) -> None:
    without = {"coupling": "", "slip_friction": "", "fields": ""}
    message = told(with_edges(f"{PULL}\ntop: {{family: 2, {condition}}}", **without))
    assert message.startswith("case.yaml:14: boundary.top.family: both families have the same")
    assert "Leave 'family' out, or add 'coupling', 'slip_friction'" in message


def test_one_family_alone_may_hold_its_directions(with_edges: Change) -> None:
    without = {"coupling": "", "slip_friction": "", "fields": ""}
    case = read_case(with_edges(f"{PULL}\ntop: {{family: 2, rotation: held}}", **without))
    assert case.needs.placements == 1


@pytest.mark.parametrize(
    "edges",
    [
        "left: [{family: 1, clamp: rotation}, {family: 2, displacement: [program, 0]}]",
        "left: clamp\nright: {force: [1 kN/m, 0], displacement: [free, -program]}",
        "left: clamp\nright: {displacement: ['program*(1+y/1 m)', free], force: [0, 'x*1 Pa']}",
        "left: clamp\nright: {displacement: [program, 1 mm]}\ntop: {rotation: held}",
        "left: [clamp]\nright: [{displacement: [program, 0]}]",
    ],
)  # fmt: skip
def test_edges_are_written_and_read_as_the_same(
    edges: str, with_edges: Change, tmp_path: Path
) -> None:
    case = read_case(with_edges(edges))
    assert again(case, tmp_path).boundary == case.boundary


CLAMPED = EdgeCondition.model_validate("clamp")
X_HELD = EdgeCondition.model_validate({"displacement": [0, "free"]})
Y_HELD = EdgeCondition.model_validate({"displacement": ["free", 0]})
DIRECTIONS_HELD = EdgeCondition.model_validate({"rotation": "held"})
DIRECTION_1_HELD = EdgeCondition.model_validate({"rotation": "held", "family": 1})
DIRECTION_2_HELD = EdgeCondition.model_validate({"rotation": "held", "family": 2})
LOADED = EdgeCondition.model_validate({"force": [1, 1]})
BIAS, ALONG = (pi / 4, -pi / 4), (0.0, pi / 2)
TURN, SHEAR = "turn as a whole", "turn as a whole or shear uniformly"


@pytest.mark.parametrize(
    ("fibres", "shear_resisted", "boundary", "motion"),
    [
        (BIAS, True, {"left": CLAMPED}, None),
        (BIAS, True, {}, "move along x"),
        (BIAS, True, {"left": X_HELD, "right": X_HELD}, "move along y"),
        (BIAS, True, {"left": X_HELD, "bottom": Y_HELD}, None),
        (BIAS, True, {"left": Y_HELD, "bottom": X_HELD}, TURN),
        (BIAS, True, {"left": Y_HELD, "right": Y_HELD, "bottom": X_HELD}, None),
        # Only bending: an edge along a fibre does not keep that family from turning.
        (BIAS, False, {"left": CLAMPED}, None),
        (ALONG, False, {"left": CLAMPED}, SHEAR),
        (ALONG, False, {"left": CLAMPED, "right": CLAMPED}, None),
        (ALONG, False, {"left": CLAMPED, "bottom": Y_HELD}, None),
        (ALONG, False, {"left": CLAMPED, "top": DIRECTIONS_HELD}, None),
        (BIAS, False, {"left": X_HELD, "bottom": Y_HELD}, SHEAR),
        # With the left edge clamped, which lies along family 2, only family 1 can turn.
        (ALONG, False, {"left": CLAMPED, "top": DIRECTION_1_HELD}, None),
        (ALONG, False, {"left": CLAMPED, "top": DIRECTION_2_HELD}, SHEAR),
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
    assert free_motion((3 * scale, scale), BIAS, {"left": (CLAMPED,)}, False) is None
    assert free_motion((3 * scale, scale), ALONG, {"left": (CLAMPED,)}, False) == SHEAR
