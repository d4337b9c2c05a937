"""Homogeneous states against closed forms, and motions that need no force."""

from __future__ import annotations

from math import cos, pi, sin, sqrt, tan

import numpy as np
import pytest
from dolfinx import fem

from tests import scenes
from wovenfab.model.constraints import Grip, Held
from wovenfab.model.model import Model
from wovenfab.solver.problem import SolverOptions

LENGTH, WIDTH = 0.9, 0.3
VALUES = {
    "stretch": {"stiffness": (1.27e8, 0.45e8)},
    "shear": {"stiffness": 400.0},
    "bending": {"stiffness": (254.1, 80.0)},
}
#: Left and bottom edges are planes of symmetry; the others move along their normals.
SLIDING = (Grip("left", (Held(), None)), Grip("bottom", (None, Held())))
#: The forces are small differences of those that the yarns' stretch would need.
TIGHT = SolverOptions(tolerance=1e-12)


in_both = pytest.mark.parametrize(
    "names", [scenes.BONDED, scenes.COUPLED], ids=["one", "two placements"]
)


def sheet_model(fibres: tuple[float, float]) -> Model:
    on = scenes.sheet(LENGTH, WIDTH, 0.15, fibres=fibres)
    return scenes.model(on, scenes.BONDED, scenes.PROTOTYPE, VALUES)


def stretched(model: Model, x: float, y: float) -> tuple[float, float]:
    """Return the forces (N) on the right and the top edge at stretches of the sheet."""
    right = Grip("right", (Held((x - 1) * LENGTH), None))
    top = Grip("top", (None, Held((y - 1) * WIDTH)))
    reactions = scenes.force(model, (*SLIDING, right, top), 1.0, TIGHT)
    return reactions["right"][0], reactions["top"][1]


def shear(gamma: float) -> tuple[float, float]:
    """Return the shear energy (J) and torque (N m) of the sheet at a shear angle."""
    area = LENGTH * WIDTH
    return 200.0 * tan(gamma) ** 2 * area, 400.0 * tan(gamma) / cos(gamma) ** 2 * area


@pytest.mark.parametrize("family", [0, 1])
def test_uniaxial_pull_along_a_fibre_meets_that_familys_stiffness(family: int) -> None:
    model = sheet_model(scenes.ALONG)
    size, across = (LENGTH, WIDTH) if family == 0 else (WIDTH, LENGTH)
    strain, edge = 0.01, ("right", "top")[family]
    pull = Grip(edge, (Held(1.0), None) if family == 0 else (None, Held(1.0)))
    reaction = scenes.force(model, (*SLIDING, pull), strain * size)[edge]
    stiffness = VALUES["stretch"]["stiffness"][family]
    assert reaction[family] == pytest.approx(stiffness * strain * across, rel=1e-10)
    stored = model.stored_energy()
    assert stored["stretch"] == pytest.approx(stiffness / 2 * strain**2 * size * across, rel=1e-10)
    assert stored["shear"] + abs(stored["bending"]) < 1e-15 * stored["stretch"]


def test_biaxial_pull_along_the_fibres_meets_each_familys_stiffness() -> None:
    right, top = stretched(sheet_model(scenes.ALONG), 1.01, 1.015)
    first, second = VALUES["stretch"]["stiffness"]
    assert right == pytest.approx(first * 0.01 * WIDTH, rel=1e-10)
    assert top == pytest.approx(second * 0.015 * LENGTH, rel=1e-10)


def test_biaxial_stretch_of_a_bias_sheet_has_the_closed_form_of_stretch_and_shear() -> None:
    # Equal families: otherwise the edges that slide freely would have to hold shear.
    x, y = 1.2, 0.8
    right, top = stretched(scenes.model(scenes.sheet(), scenes.BONDED, scenes.PROTOTYPE), x, y)
    length, k_e, k_s = sqrt((x * x + y * y) / 2), 2 * 1.27e8, 400.0
    # e_1·e_2 = (x² - y²)/(x² + y²), hence tan gamma = (x/y - y/x)/2
    pull, skew = k_e * (length - 1) / (2 * length), k_s / 4 * (x / y - y / x)
    assert right / WIDTH == pytest.approx(pull * x + skew * (1 / y + y / x**2), rel=1e-10)
    assert top / LENGTH == pytest.approx(pull * y - skew * (x / y**2 + 1 / x), rel=1e-10)


def test_a_picture_frame_along_the_bias_meets_shear_alone() -> None:
    model = sheet_model(scenes.BIAS)
    gamma = 0.6
    x, y = sqrt(1 + sin(gamma)), sqrt(1 - sin(gamma))  # yarns keep their length
    right, top = stretched(model, x, y)
    torque = (right * LENGTH / x - top * WIDTH / y) * cos(gamma) / 2
    energy, expected = shear(gamma)
    assert torque == pytest.approx(expected, rel=1e-10)
    assert model.stored_energy()["shear"] == pytest.approx(energy, rel=1e-10)


@pytest.mark.parametrize("fibres", [scenes.ALONG, (pi / 2, 0.0), scenes.BIAS, (0.2, 0.2 - pi / 2)])
@pytest.mark.parametrize("gamma", [0.5, -0.9])
def test_homogeneous_shear_has_its_energy_and_torque(
    fibres: tuple[float, float], gamma: float
) -> None:
    model = sheet_model(fibres)
    first, second = model.sheet.fibres
    side = np.sign(np.linalg.det(model.sheet.fibres))

    def turned(angle: float) -> np.ndarray:
        """Return the gradient that turns the families by half the angle each."""
        half = side * angle / 2
        turn = np.array([[cos(half), -sin(half)], [sin(half), cos(half)]])
        return np.outer(turn @ first, first) + np.outer(turn.T @ second, second)

    scenes.set_field(model.field, lambda x: (turned(gamma) - np.eye(2)) @ x[:2])
    (energy, torque), stored, step = shear(gamma), model.stored_energy(), 1e-3
    assert stored["shear"] == pytest.approx(energy, rel=1e-10)
    assert sum(stored.values()) == pytest.approx(stored["shear"], rel=1e-10)
    # The derivative of the rotations is the same gradient a quarter turn of 2x half on.
    velocity = (turned(gamma + pi) - turned(gamma - pi)) / 4
    approximate = (turned(gamma + step) - turned(gamma - step)) / (2 * step)
    assert velocity == pytest.approx(approximate, abs=1e-6)
    motion = fem.Function(model.space)
    scenes.set_field(motion, lambda x: velocity @ x[:2])
    assert scenes.internal_force(model) @ motion.x.array == pytest.approx(torque, rel=1e-10)


@pytest.mark.parametrize("fibres", [(0.3, -0.9), (0.0, 0.5), (0.1, 2.9)])
def test_fibres_that_are_not_orthogonal_rest_without_stress(fibres: tuple[float, float]) -> None:
    model = sheet_model(fibres)
    model.field.x.array[:] = 0
    assert sum(abs(e) for e in model.stored_energy().values()) < 1e-20
    assert np.abs(scenes.internal_force(model)).max() < 1e-7  # round-off of 1e8 N/m
    reactions = scenes.force(model, scenes.PULL, 0.0)
    assert np.abs(list(reactions.values())).max() < 1e-7


def test_moving_both_grips_together_by_a_metre_needs_no_force() -> None:
    model = sheet_model((0.3, -0.9))
    together = (Held(1.0), Held(-0.7))
    reactions = scenes.force(model, (Grip("left", together), Grip("right", together)), 1.0)
    assert np.abs(list(reactions.values())).max() < 1e-6
    assert model.field.x.array.reshape(-1, 2) == pytest.approx(
        np.tile([1.0, -0.7], (model.unknowns // 2, 1)), abs=1e-12
    )


def test_turning_both_grips_together_needs_no_force() -> None:
    model = sheet_model(scenes.BIAS)
    turn = (
        Held(field=lambda x, y, angle, _: (cos(angle) - 1) * x - sin(angle) * y),
        Held(field=lambda x, y, angle, _: sin(angle) * x + (cos(angle) - 1) * y),
    )
    equilibrium = scenes.solver(model, (Grip("left", turn), Grip("right", turn)))
    constraints = equilibrium.problem.constraints
    for angle in np.linspace(0, pi / 2, 9):
        constraints.set(angle)
        assert equilibrium.solve().converged
    exact = fem.Function(model.space)
    scenes.set_field(exact, lambda x: np.array([-x[0] - x[1], x[0] - x[1]]))
    assert model.field.x.array == pytest.approx(exact.x.array, abs=1e-9)
    needed = 1.27e8 * WIDTH  # what a stretch of one would need
    assert np.abs(equilibrium.problem.force).max() < 1e-12 * needed
    assert sum(model.stored_energy().values()) < 1e-12
    equilibrium.destroy()


@in_both
def test_the_reaction_is_the_slope_of_the_solved_energy(names: tuple[str, ...]) -> None:
    model = scenes.model(scenes.sheet(), names, scenes.PROTOTYPE)

    def at(displacement: float) -> tuple[float, float]:
        model.field.x.array[:] = 0
        return scenes.pull(model, displacement), scenes.energy(model)

    slopes = [(at(0.03 + h)[1] - at(0.03 - h)[1]) / (2 * h) for h in (2e-3, 1e-3)]
    errors = np.abs(np.array(slopes) / at(0.03)[0] - 1)
    assert errors[1] < 1e-3
    assert scenes.orders(errors) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("pattern", ["crossed", "right"])
@in_both
def test_grips_balance_without_transverse_force(names: tuple[str, ...], pattern: str) -> None:
    model = scenes.model(scenes.sheet(pattern=pattern), names, scenes.PROTOTYPE)
    reactions = scenes.force(model, scenes.PULL, 0.04)
    (left_x, left_y), (right_x, right_y) = reactions["left"], reactions["right"]
    assert abs(left_x + right_x) + abs(left_y + right_y) < 1e-8 * right_x
    if pattern == "crossed":
        assert abs(right_y) < 1e-8 * right_x
    else:  # the mesh leans to one side: a test that the sum would show a lost share
        assert abs(right_y) > 1e-5 * right_x
