"""Friction whose strength depends on the shear angle: closed forms, order, derivatives, resume."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from math import pi, radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

import wovenfab
from tests import scenes
from wovenfab.case import Case
from wovenfab.case.objects import differentiate
from wovenfab.forms.effect import OfShearAngle, Target
from wovenfab.interface import execute
from wovenfab.stepping.program import cycle, program_of
from wovenfab.stepping.schemes import SCHEMES

Array = NDArray[np.float64]
SIDE, TOP, ANGLE = 0.3, 0.6, radians(20)
GROWING = "3 N/m * (1 + (gamma/20 deg)^2)"


def travel(angle: Array) -> Array:
    """Return the travel of the crosshead (m) of a picture frame sheared by an angle (rad)."""
    return 2 * SIDE * np.cos((pi / 2 - angle) / 2) - np.sqrt(2) * SIDE


def picture_frame(folder: Path, angles: Array, friction: Mapping[str, Any], **more: Any) -> Case:
    """Return a picture frame that is sheared to each angle (rad) within a second."""
    rows = [f"{float(i)!r},{float(d)!r}\n" for i, d in enumerate(travel(angles))]
    (folder / "program.csv").write_text("time_s,displacement_m\n" + "".join(rows))
    frame = {"frame": {"length": SIDE}}
    return Case(
        sheet={"shape": "rectangle", "length": SIDE, "width": SIDE, "fibres": ["0 deg", "90 deg"]},
        effects={
            "stretch": {"stiffness": "1e9 N/m"},
            "shear": {"stiffness": "40 N/m"},
            "spin_friction": friction,
        },
        boundary=dict.fromkeys(("right", "left", "top", "bottom"), frame),
        program=[{"type": "table", "file": str(folder / "program.csv"), "tolerance": 1e-12}],
        discretisation={"degree": 2, "mesh_size": SIDE / 2},
        output={"pictures": False},
        **more,
    )


@pytest.mark.parametrize("steps", [pytest.param(8, marks=pytest.mark.slow), 16])
def test_coulomb_friction_in_a_picture_frame_has_its_closed_form(
    steps: int, tmp_path: Path
) -> None:
    """W = A (K/2 tan^2 gamma), and a torque per area zeta(gamma) against each change of gamma.

    The steps are even in the angle: what the strength is taken at is then exact but in the first.
    """
    there, back = np.linspace(0, TOP, steps + 1), np.linspace(TOP, 0, steps + 1)[1:]
    angles = np.array([*there, *back])
    case = picture_frame(tmp_path, angles, {"law": "coulomb", "strength": GROWING})
    found = list(wovenfab.steps(case))
    zeta = 3 * (1 + (angles / ANGLE) ** 2)
    sign = np.sign(np.diff(angles, prepend=-1))
    torque = SIDE**2 * (40 * np.tan(angles) / np.cos(angles) ** 2 + sign * zeta)
    force = torque / (SIDE * np.sin((pi / 2 - angles) / 2))
    assert [s.force for s in found][2:] == pytest.approx(force[2:], abs=1e-8 * force.max())
    loss = 2 * SIDE**2 * 3 * (TOP + TOP**3 / (3 * ANGLE**2))
    assert found[-1].dissipated["spin_friction"] == pytest.approx(loss, rel=1e-8)


def test_coulomb_friction_that_begins_without_any_bound_comes_to_its_loss(tmp_path: Path) -> None:
    """The bound at the start of the first step is zero everywhere."""
    angles = np.array([*np.linspace(0, TOP, 17), *np.linspace(TOP, 0, 17)[1:]])
    law = {"law": "coulomb", "strength": "3 N/m * (gamma/20 deg)^2"}
    found = list(wovenfab.steps(picture_frame(tmp_path, angles, law)))
    loss = 2 * SIDE**2 * 3 * TOP**3 / (3 * ANGLE**2)
    assert found[-1].dissipated["spin_friction"] == pytest.approx(loss, rel=0.01)


@pytest.mark.slow
def test_the_balance_of_energy_closes_with_the_square_of_the_step(tmp_path: Path) -> None:
    misses = []
    for steps in (8, 16, 32):
        angles = np.linspace(0, TOP, steps + 1)
        case = picture_frame(tmp_path, angles, {"law": "coulomb", "strength": GROWING})
        *_, last = wovenfab.steps(case)
        misses.append(scenes.imbalance(last))
    assert min(scenes.orders(misses)) > 1.9


def grown(factor: float) -> OfShearAngle:
    """Return a strength that grows with the angle from a value (SI)."""
    return OfShearAngle(lambda x, gamma: factor * (1 + (gamma / ANGLE) ** 2))


def scene(name: str, strength: Any, scheme: str = "bdf2", size: float = 0.15) -> Any:
    """Return a model of a short bias-extension sample with one friction."""
    slips = name.startswith("slip")
    values = {**scenes.TABLE_1, name.partition(":")[0]: {"strength": strength, "slope": 40.0}}
    if name.endswith("coulomb"):
        del values[name.partition(":")[0]]["slope"]
    numerics = replace(scenes.PROTOTYPE, history=max(2, SCHEMES[scheme].memory))
    base = scenes.COUPLED if slips else ("stretch", "shear", "bending")
    return scenes.model(scenes.sheet(0.6, 0.3, size), (*base, name), numerics, values)


SCENES = [
    ("spin_friction", "bdf2"),
    *(
        pytest.param(*scene, marks=pytest.mark.slow)
        for scene in (
            ("spin_friction:coulomb", "bdf2"),
            ("slip_friction", "bdf2"),
            ("spin_friction", "midpoint"),
            ("slip_friction:coulomb", "bdf2"),
            ("spin_friction:coulomb", "midpoint"),
        )
    ),
]


@pytest.mark.parametrize(("name", "scheme"), SCENES)
def test_largest_force_and_loss_are_of_second_order_in_the_step(name: str, scheme: str) -> None:
    of = scene(name, grown(2e4 if name.startswith("slip") else 30.0), scheme, 0.3)
    results = []
    for count in (16, 32, 64):
        steps = scenes.march(of, program_of(cycle(0.0, 0.04, 4.0, count)), scheme)
        results.append((max(scenes.forces(steps)), scenes.lost(steps[-1])))
    (force, loss), (finer_force, finer_loss) = (
        np.abs(np.subtract(a, b)) / results[-1] for a, b in pairwise(results)
    )
    assert finer_loss < max(loss / 3, 3e-4)
    assert finer_force < max(force / 3, 3e-4)


@pytest.mark.parametrize(
    "name",
    [
        "spin_friction",
        pytest.param("slip_friction:coulomb", marks=pytest.mark.slow),
        pytest.param("spin_friction:coulomb", marks=pytest.mark.slow),
    ],
)
def test_newton_needs_no_more_iterations_than_with_constant_strength(name: str) -> None:
    program = program_of(cycle(0.0, 0.04, 4.0, 20))
    size = 2e4 if name.startswith("slip") else 30.0
    grow, same = (
        sum(s.iterations for s in scenes.march(scene(name, strength), program, "bdf2"))
        for strength in (grown(size), size)
    )
    print(f"\n{name}: {grow} iterations, with constant strength {same}")
    assert grow <= 1.1 * same


def sample(friction: Mapping[str, Any], **more: Any) -> Case:
    """Return a cycle of a short bias-extension sample."""
    return Case(
        sheet={
            "shape": "rectangle",
            "length": 0.6,
            "width": 0.3,
            "fibres": ["45 deg", "-45 deg"],
        },
        effects={
            "stretch": {"stiffness": "1e5 N/m"},
            "shear": {"stiffness": "40 N/m"},
            "bending": {"stiffness": "1e-3 N*m"},
            "spin_friction": friction,
        },
        boundary={"left": "clamp", "right": {"displacement": ["program", 0]}},
        program={"type": "cycles", "amplitudes": "40 mm", "frequency": "1 Hz"},
        discretisation={"degree": 2, "mesh_size": 0.3},
        output={"pictures": False, "checkpoint": 2},
        **more,
    )


@pytest.mark.slow
def test_strength_by_a_formula_is_that_of_the_same_function() -> None:
    case = sample({"law": "coulomb", "strength": GROWING}, time={"steps_per_cycle": 12})
    terms = [
        wovenfab.stretch(1e5),
        wovenfab.shear(40.0),
        wovenfab.bending(1e-3),
        wovenfab.spin_friction(law="coulomb", strength=grown(3.0)),
    ]
    sheet = wovenfab.sheet_of(case, MPI.COMM_SELF)
    edges = [wovenfab.clamp("left"), wovenfab.move("right", (wovenfab.PROGRAM, 0.0))]
    of = wovenfab.build_model(sheet, terms, edges, wovenfab.Numerics(degree=2))
    program = program_of(cycle(0.0, 0.04, 1.0, 12))
    of_library = list(wovenfab.Simulation(wovenfab.Problem(of), program).steps())
    of_case = list(wovenfab.steps(case, comm=MPI.COMM_SELF))
    largest = max(s.force for s in of_case)
    assert [s.force for s in of_library] == pytest.approx(
        [s.force for s in of_case], abs=1e-8 * largest
    )


#: Laws of friction in a case.
LAWS = [
    pytest.param({"law": "coulomb"}, id="coulomb"),
    pytest.param({"slope": "2 s"}, id="smooth", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.slow  # elastic friction that grows goes on in make test
@pytest.mark.parametrize("scheme", ["bdf2", "midpoint"])
def test_a_run_that_was_stopped_goes_on_to_the_last_bit(
    scheme: str, law: dict[str, str], tmp_path: Path
) -> None:
    time = {"steps_per_cycle": 12, "scheme": scheme}
    case = sample({**law, "strength": GROWING}, time=time, solver={"factor": "renewed"})
    whole = execute(case, tmp_path / "whole", comm=MPI.COMM_SELF).columns
    execute(case, tmp_path / "parts", comm=MPI.COMM_SELF, until=0.4)
    parts = execute(case, tmp_path / "parts", comm=MPI.COMM_SELF, resume=True).columns
    for name, values in whole.items():
        assert (parts[name] == values).all(), name


@pytest.mark.parametrize("scheme", ["bdf2", "midpoint"])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("coefficient", [1, 3])
@pytest.mark.slow
def test_derivatives_by_a_number_of_the_formula_agree_with_differences(
    coefficient: int, law: dict[str, str], scheme: str
) -> None:
    def case(share: float = 0.0) -> Case:
        first, third = (v * (1 + share * (n == coefficient)) for n, v in ((1, 3.0), (3, 1.0)))
        formula = f"{first!r} N/m * (1 + {third!r} * (gamma/20 deg)^2)"
        time = {"steps_per_cycle": 8, "scheme": scheme}
        # A law that is nearly obeyed has nearly its slope, and the midpoint rule forgets nothing.
        solver = {"tolerance": 1e-14, "factor": "renewed"}
        return sample({**law, "strength": formula}, time=time, solver=solver)

    def curves(share: float) -> tuple[Array, Array]:
        found = list(wovenfab.steps(case(share), comm=MPI.COMM_SELF))
        return np.array([s.force for s in found]), np.array([scenes.lost(s) for s in found])

    target = Target("spin_friction", "strength", coefficient=coefficient)
    simulation = wovenfab.simulation_of(case(), wovenfab.sheet_of(case(), MPI.COMM_SELF))
    differentiate(simulation, case(), [target])
    rows = [step.derivatives for step in simulation.steps()]
    slopes = [np.array([getattr(r, n)[0] for r in rows if r]) for n in ("force", "dissipated")]
    share, value = 1e-4, {1: 3.0, 3: 1.0}[coefficient]
    for slope, up, down in zip(slopes, curves(share), curves(-share), strict=True):
        difference = (up - down) / (2 * share * value)
        assert np.abs(slope - difference).max() < 1e-3 * np.abs(difference).max()


def test_a_stiffness_of_the_angle_is_no_stiffness() -> None:
    with pytest.raises(TypeError, match="shear angle"):
        wovenfab.shear(grown(40.0))
