"""Friction that is elastic before it slides: Masing's rules, losses, derivatives, resume."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import wovenfab
from tests import scenes
from tests.stepping.test_sensitivity import differences
from tests.verification.test_growing_friction import (
    ANGLE,
    SIDE,
    TOP,
    Array,
    picture_frame,
    sample,
)
from wovenfab.case import CaseError
from wovenfab.forms.effect import Target
from wovenfab.forms.friction import ELEMENTS
from wovenfab.interface import execute
from wovenfab.stepping.program import cycle, program_of
from wovenfab.stepping.step import Step

STIFFNESS, STRENGTH = 30.0, 3.0
ELASTIC = {"law": "elastic", "stiffness": "30 N/m", "strength": "3 N/m"}
EXACT = {"tolerance": 1e-12, "factor": "renewed"}


IWAN = {**ELASTIC, "law": "iwan"}
#: Where very many elements slide, all of them, rad; and where each of those of the law begins to.
LAST = 2 * STRENGTH / STIFFNESS
YIELDS = LAST * (np.arange(ELEMENTS) + 0.5) / ELEMENTS


def torques(found: Sequence[Step], angles: Array) -> Array:
    """Return the torque per area (N/m) of the friction in a picture frame at each angle (rad)."""
    lever = SIDE * np.sin((pi / 2 - angles) / 2)
    elastic = SIDE**2 * 40 * np.tan(angles) / np.cos(angles) ** 2
    return (np.array([s.force for s in found]) * lever - elastic) / SIDE**2


def test_a_loop_of_a_picture_frame_follows_masings_rules(tmp_path: Path) -> None:
    """The branches after a reversal are the first loading, twice as large (Masing 1926)."""
    points = [np.linspace(a, b, 13)[1:] for a, b in ((0, TOP), (TOP, -TOP), (-TOP, TOP))]
    angles = np.concatenate([[0.0], *points])
    found = list(wovenfab.steps(picture_frame(tmp_path, angles, ELASTIC, solver=EXACT)))

    def first(angle: Any) -> Any:
        return np.minimum(STIFFNESS * angle, STRENGTH)

    expected = np.concatenate(
        [
            first(angles[:13]),
            STRENGTH - 2 * first((TOP - angles[13:25]) / 2),
            -STRENGTH + 2 * first((TOP + angles[25:]) / 2),
        ]
    )
    assert torques(found, angles) == pytest.approx(expected, abs=1e-6 * STRENGTH)
    stored = [s.stored["spin_friction"] for s in found]
    assert stored == pytest.approx(SIDE**2 * expected**2 / (2 * STIFFNESS), abs=1e-8)
    most = STRENGTH / STIFFNESS
    loss = SIDE**2 * STRENGTH * (TOP - most + 2 * (2 * TOP - 2 * most))
    assert found[-1].dissipated["spin_friction"] == pytest.approx(loss, rel=1e-8)


def many(angle: Array) -> Array:
    """Return the torque per area (N/m) of very many elements at first loading (Iwan 1966)."""
    angle = np.minimum(angle, LAST)
    return STIFFNESS * angle - (STIFFNESS * angle) ** 2 / (4 * STRENGTH)


def some(angle: Array) -> Array:
    """Return the torque per area (N/m) of the elements of the law at first loading."""
    return STIFFNESS * np.minimum(angle[:, None], YIELDS).mean(axis=1)


def test_gradual_sliding_in_a_picture_frame_follows_masings_rules(tmp_path: Path) -> None:
    """Branches are twice the first loading, and a closed loop is forgotten (Masing 1926).

    The torque differs from that of very many elements by zeta/(4 n^2) just where one begins to
    slide, and by nothing halfway between.
    """
    half = LAST / (2 * ELEMENTS) * np.arange(11)  # to where some elements slide, and some do not
    turn = half[-1]
    angles = np.concatenate([half, turn - 2 * half[1:], -turn + 2 * half[1:], [TOP]])
    found = list(wovenfab.steps(picture_frame(tmp_path, angles, IWAN, solver=EXACT)))
    torque = torques(found, angles)

    def loop(first: Callable[[Array], Array]) -> Array:
        up, top, end = first(half), first(half)[-1], first(np.array([TOP]))
        return np.concatenate([up, top - 2 * up[1:], -top + 2 * up[1:], end])

    assert torque == pytest.approx(loop(some), abs=1e-7 * STRENGTH)  # yarns stretch by as much
    errors = (torque - loop(many)) / (STRENGTH / (4 * ELEMENTS**2))
    assert errors[:11] == pytest.approx(np.arange(11) % 2, abs=1e-4)
    assert np.abs(errors).max() == pytest.approx(2.0, abs=1e-4)
    travel = np.maximum(turn - YIELDS, 0) * 4 + np.maximum(TOP - YIELDS, 0)
    loss = SIDE**2 * STRENGTH * (YIELDS / YIELDS.sum()) @ travel
    assert found[-1].dissipated["spin_friction"] == pytest.approx(loss, rel=1e-8)
    held = SIDE**2 * STIFFNESS / (2 * ELEMENTS) * (YIELDS**2).sum()
    assert found[-1].stored["spin_friction"] == pytest.approx(held, rel=1e-8)


@pytest.mark.slow
def test_the_balance_of_growing_strength_closes_with_the_square_of_the_step(tmp_path: Path) -> None:
    friction = {**ELASTIC, "strength": "3 N/m * (1 + (gamma/20 deg)^2)"}
    misses = []
    for steps in (8, 64):
        there, back = np.linspace(0, TOP, steps + 1), np.linspace(TOP, 0, steps + 1)
        case = picture_frame(tmp_path, np.array([*there, *back[1:]]), friction)
        *_, last = wovenfab.steps(case)
        misses.append(scenes.imbalance(last))
    assert scenes.orders(misses)[0] / 3 > 1.8


def scene(name: str, **values: Any) -> Any:
    """Return a model of a short bias-extension sample with an elastic friction."""
    base = scenes.COUPLED if name.startswith("slip") else scenes.BONDED
    numerics = replace(scenes.PROTOTYPE, history=2, quadrature=4, friction=4)  # the same points
    given = {**scenes.TABLE_1, name.partition(":")[0]: values}
    return scenes.model(scenes.sheet(0.6, 0.3, 0.15), (*base, name), numerics, given)


@pytest.mark.parametrize(
    ("name", "law", "parameter"),
    [
        ("slip_friction", "elastic", "stiffness"),
        *(
            pytest.param(*scene, marks=pytest.mark.slow)
            for scene in (
                ("spin_friction", "iwan", "strength"),
                ("slip_friction", "elastic", "strength"),
                ("slip_friction", "iwan", "strength"),
                ("slip_friction", "iwan", "stiffness"),
                ("spin_friction", "elastic", "strength"),
                ("spin_friction", "elastic", "stiffness"),
                ("spin_friction", "iwan", "stiffness"),
            )
        ),
    ],
)
def test_derivatives_agree_with_differences(name: str, law: str, parameter: str) -> None:
    slips = name == "slip_friction"
    values = {"strength": 2e4, "stiffness": 1e8} if slips else {"strength": 30.0, "stiffness": 1e3}
    of = scene(f"{name}:{law}", **values)
    assert differences(of, [Target(name, parameter)], 1e-5).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["slip_friction", "spin_friction"])
def test_newton_needs_no_more_iterations_than_for_coulomb(name: str) -> None:
    slips = name == "slip_friction"
    strength, stiffness = (2e4, 1e8) if slips else (30.0, 1e3)
    program = program_of(cycle(0.0, 0.04, 4.0, 20))
    elastic = scenes.march(
        scene(f"{name}:elastic", strength=strength, stiffness=stiffness), program, "bdf2"
    )
    coulomb = scenes.march(scene(f"{name}:coulomb", strength=strength), program, "bdf2")
    few, many = (sum(s.iterations for s in steps) for steps in (elastic, coulomb))
    print(f"\n{name}: {few} iterations, Coulomb's law {many}")
    assert few <= many
    assert scenes.lost(elastic[-1]) < scenes.lost(coulomb[-1])


def test_a_stiff_spring_gives_the_loss_of_coulomb() -> None:
    program = program_of(cycle(0.0, 0.04, 4.0, 20))
    losses = [
        scenes.lost(scenes.march(scene(name, **values), program, "bdf2")[-1])
        for name, values in (
            ("spin_friction:elastic", {"strength": 30.0, "stiffness": 1e6}),
            ("spin_friction:coulomb", {"strength": 30.0}),
        )
    ]
    assert losses[0] == pytest.approx(losses[1], rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "friction",
    [ELASTIC, {**ELASTIC, "strength": "3 N/m * (1 + (gamma/20 deg)^2)"}, IWAN],
    ids=["elastic", "growing", "iwan"],
)
def test_a_run_that_was_stopped_goes_on_to_the_last_bit(
    friction: dict[str, str], tmp_path: Path
) -> None:
    case = sample(friction, time={"steps_per_cycle": 12}, solver=EXACT)
    whole = execute(case, tmp_path / "whole", comm=MPI.COMM_SELF).columns
    execute(case, tmp_path / "parts", comm=MPI.COMM_SELF, until=0.4)
    parts = execute(case, tmp_path / "parts", comm=MPI.COMM_SELF, resume=True).columns
    for name, values in whole.items():
        assert (parts[name] == values).all(), name


@pytest.mark.slow
@pytest.mark.mpi
def test_two_ranks_agree_with_one() -> None:
    case = sample(ELASTIC, time={"steps_per_cycle": 8})
    alone, together = (
        [(s.force, scenes.lost(s)) for s in wovenfab.steps(case, comm=comm)]
        for comm in (MPI.COMM_SELF, MPI.COMM_WORLD)
    )
    assert np.array(together) == pytest.approx(np.array(alone), rel=1e-7, abs=1e-9)


def test_the_midpoint_rule_is_refused_for_it() -> None:
    with pytest.raises(CaseError, match="end of a step"):
        sample(ELASTIC, time={"scheme": "midpoint"})


def test_strength_that_grows_is_that_of_the_present_angle(tmp_path: Path) -> None:
    angles = np.linspace(0, TOP, 13)
    friction = {**ELASTIC, "strength": "3 N/m * (1 + (gamma/20 deg)^2)"}
    found = list(wovenfab.steps(picture_frame(tmp_path, angles, friction, solver=EXACT)))
    stress = torques(found, angles)
    assert stress[4:] == pytest.approx(3 * (1 + (angles[4:] / ANGLE) ** 2), rel=1e-6)
