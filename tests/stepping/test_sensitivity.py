"""Derivatives of runs by parameters, against differences of whole runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from runpy import run_path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from tests import scenes
from wovenfab.case import Case, read_case
from wovenfab.case.objects import differentiate, sheet_of, simulation_of
from wovenfab.forms import effects
from wovenfab.forms.effect import Target, Term
from wovenfab.forms.table import TABLE, ForceTable
from wovenfab.model.constraints import EdgeLoad, Grip
from wovenfab.model.model import Model, build_model
from wovenfab.solver import equilibrium
from wovenfab.solver.problem import SolverOptions
from wovenfab.stepping.program import cycle, program_of
from wovenfab.stepping.schemes import SCHEMES
from wovenfab.stepping.sensitivity import TargetError
from wovenfab.stepping.time_stepper import TimeStepper

ROOT = Path(__file__).parents[2]
PRECISE = SolverOptions(tolerance=1e-12)
VALUES = {
    **scenes.TABLE_1,
    "coupling": {"stiffness": 6.0e6},
    "power_shear": {"stiffness": 300.0, "power": 2.5},
    "viscous_slip": {"viscosity": 2e5},
    "crimp": {"stiffness": (1e8, 1e8), "crimp": (0.08, 0.08), "resistance": 1e7},
}
#: Changes of parameters whose remainders are compared, and remainders that are round-off.
SHARES, ROUND_OFF = (2e-2, 1e-2), 5e-6
LOOP = program_of(cycle(0.0, 0.03, 0.3, 8))
#: All smooth laws of Table 1, with the memory of every scheme: tests share these kernels.
SMOOTH = (*scenes.COUPLED, "slip_friction", "spin_friction")
NUMERICS = replace(scenes.PROTOTYPE, history=max(scheme.memory for scheme in SCHEMES.values()))


def curves(
    of: Model,
    targets: Sequence[Target] = (),
    scheme: str = "bdf2",
    grips: Sequence[Grip] = scenes.PULL,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return force and dissipated energy of each step, or their derivatives by the targets."""
    of.field.x.array[:] = 0
    solver = scenes.solver(of, grips, PRECISE)
    stepper = TimeStepper(solver, LOOP, SCHEMES[scheme], 1 / 64)
    if targets:
        stepper.differentiate(targets)
    steps = list(stepper.steps())
    solver.destroy()
    if targets:
        rows = [step.derivatives for step in steps]
        assert all(rows)
        return np.array([r.force for r in rows]), np.array([r.dissipated for r in rows])
    lost = [sum(step.dissipated.values()) for step in steps]
    return np.array([step.reactions["right"][0] for step in steps]), np.array(lost)


def term_of(of: Model, target: Target) -> Term:
    terms = (*of.balance.terms, *(f.term for f in of.friction_stresses))
    return next(t for t in terms if t.effect.name == target.effect)


@contextmanager
def changed(of: Model, target: Target, share: float) -> Iterator[float]:
    """Change a parameter by a share of its value; yield the change."""
    value = term_of(of, target).values[target.parameter]
    constants = [value[f] for f in target.families] if isinstance(value, tuple) else [value]
    before = float(constants[0].value)
    for constant in constants:
        constant.value = before * (1 + share)
    yield before * share
    for constant in constants:
        constant.value = before


def assert_second_order(of: Model, targets: Sequence[Target], **how: Any) -> None:
    """Test that what derivatives leave of a change is as of second order, for force and loss."""
    base, slopes = curves(of, **how), curves(of, targets, **how)
    for k, target in enumerate(targets):
        rest = []
        for share in SHARES:
            with changed(of, target, share) as change:
                first = [change * slope[:, k] for slope in slopes]
                ways = [now - before for now, before in zip(curves(of, **how), base, strict=True)]
            rest.append(
                [
                    np.abs(way - line).max() / (np.abs(line).max() or 1.0)
                    for way, line in zip(ways, first, strict=True)
                ]
            )
        for large, small in zip(*rest, strict=True):
            assert falls_by_half(large, small), (target, large, small)


def scene(names: Sequence[str], values: Any = VALUES, mesh_size: float = 0.3, **more: Any) -> Model:
    on = scenes.sheet(0.6, 0.3, mesh_size)
    return scenes.model(on, names, NUMERICS, values, **more)


def falls_by_half(large: float, small: float) -> bool:
    """Return whether remainders over the first-order change are as of second order."""
    return large < ROUND_OFF or (small < 0.02 and 1.85 < large / small < 2.15)


def parameters(names: Sequence[str]) -> list[Target]:
    """Return each parameter of some effects of the catalogue."""
    return [Target(name, p.name) for name in names for p in effects()[name].parameters]


#: Effects that can do without those of SMOOTH, with what they need.
OTHERS = ("crimp", "power_shear", "viscous_slip")


@pytest.mark.parametrize(
    ("names", "targets"),
    [
        (("stretch", "power_shear"), parameters(["stretch", "power_shear"])),
        pytest.param(SMOOTH, parameters(SMOOTH), marks=pytest.mark.slow),
        pytest.param(
            ("stretch", "bending", "coupling", *OTHERS), parameters(OTHERS), marks=pytest.mark.slow
        ),
    ],
    ids=["elastic", "every smooth law", "every other"],
)
def test_what_the_derivative_leaves_falls_with_the_square_of_the_change(
    names: Sequence[str], targets: Sequence[Target]
) -> None:
    assert {*SMOOTH, *OTHERS} == {*effects()}
    # Yarns so soft that the force depends on them: else a change by theirs is near round-off.
    soft = {**VALUES, "stretch": {"stiffness": (1e6, 1e6)}}
    assert_second_order(scene(names, soft), targets)


def test_the_same_holds_for_an_effect_of_the_user_and_the_factor_of_a_table() -> None:
    own = run_path(str(ROOT / "docs" / "examples" / "my_effect.py"))["EFFECT"]
    chosen = [scenes.effect("stretch:table"), scenes.effect("bending"), own]
    on = scenes.sheet(0.6, 0.3, 0.3)
    table = (ForceTable((0.01, 0.02), (2e5, 9e5)),) * 2
    values = {
        **VALUES,
        "my_effect": {"stiffness": 400.0},
        "stretch": {"scale": (1.0, 1.2), TABLE: table},
    }
    of = build_model(on, [Term(e, values[e.name]) for e in chosen], (), scenes.PROTOTYPE)
    assert_second_order(of, [Target("my_effect", "stiffness"), Target("stretch", "scale", (1,))])


@pytest.mark.slow
def test_the_same_holds_for_the_factor_of_a_table_of_shear() -> None:
    names = [f"{n}:table" if n == "shear" else n for n in scenes.BONDED]
    table = {"scale": 1.2, TABLE: ForceTable((0.01, 0.02), (2.0, 5.0))}
    assert_second_order(scene(names, {**VALUES, "shear": table}), [Target("shear", "scale")])


#: Parameters of all kinds.
TARGETS = [
    Target("bending", "stiffness", (1,)),
    Target("shear", "stiffness"),
    Target("slip_friction", "slope"),
    Target("spin_friction", "strength"),
]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_derivatives_are_those_of_the_scheme(scheme: str) -> None:
    assert differences(scene(SMOOTH), TARGETS, scheme=scheme).max() < 1e-5


def differences(
    of: Model, targets: Sequence[Target], share: float = 1e-4, **how: Any
) -> NDArray[np.float64]:
    """Return the distances from central differences of force and loss, over their size.

    Their shape is (parameters, 2).
    """
    slopes, result = curves(of, targets, **how), []
    for k, target in enumerate(targets):
        sides = []
        for side in (share, -share):
            with changed(of, target, side) as change:
                sides.append(curves(of, **how))
        for slope, up, down in zip(slopes, *sides, strict=True):
            difference = (up - down) / (2 * abs(change))
            size = np.abs(difference).max() or 1.0
            result.append(np.abs(slope[:, k] - difference).max() / size)
    return np.array(result).reshape(-1, 2)


@pytest.mark.parametrize("scheme", ["bdf2", pytest.param("midpoint", marks=pytest.mark.slow)])
def test_derivatives_with_stress_at_points_agree_with_differences(scheme: str) -> None:
    # Steps at which points begin to slide have kinks, so that differences are less exact.
    targets = [
        Target("slip_friction", "strength"),
        Target("coupling", "stiffness"),
        Target("bending", "stiffness"),
    ]
    of = scene((*scenes.COUPLED, "slip_friction:coulomb"), mesh_size=0.15)
    assert differences(of, targets, share=1e-5, scheme=scheme).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("parameter", ["strength", "slope"])
def test_smooth_friction_that_needs_its_stress_at_points_has_derivatives(
    parameter: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_points = Mock(wraps=equilibrium.with_friction_stress)
    monkeypatch.setattr(equilibrium, "with_friction_stress", at_points)
    sharp = {**VALUES, "slip_friction": {"strength": 199.2e3, "slope": 1e5}}
    of = scene(SMOOTH, sharp, 0.15)
    assert differences(of, [Target("slip_friction", parameter)]).max() < 1e-3
    assert at_points.called


def test_dead_loads_and_held_directions_are_part_of_it() -> None:
    load = EdgeLoad("top", (0, 1), (0.0, 30.0))
    of = scene(scenes.BONDED, loads=[load], rotation_edges=["left", "right"])
    targets = [Target("bending", "stiffness"), Target("shear", "stiffness")]
    assert differences(of, targets).max() < 1e-5


def test_a_run_is_the_same_with_derivatives() -> None:
    of = scene(SMOOTH)
    plain = curves(of)[0]
    stepped = scenes.run(of, LOOP, PRECISE, scheme="bdf2").steps
    np.testing.assert_array_equal(plain, [s.reactions["right"][0] for s in stepped])


def test_a_parameter_that_the_scene_lacks_is_refused_by_name() -> None:
    with pytest.raises(TargetError, match=r"crimp\.stiffness is no parameter of this scene"):
        curves(scene(SMOOTH), [Target("crimp", "stiffness")])


#: A formula for each of these parameters, the coefficient that changes, and its change: from, to.
FORMULAS = {
    "shear.stiffness": ("400 N/m * (1 + exp(-x/0.3 m))", 3, "0.3 m", "0.30006 m", "0.29994 m"),
    "slip_friction.strength": (
        "20 kN/m^2 * (1.2 - y/0.5 m)", 2, "1.2", "1.20024", "1.19976",
    ),
}  # fmt: skip


#: Parameters, cases that have them, and how near differences come.
CASES = [
    ("shear.stiffness", "small", 1e-5),
    *(
        pytest.param(name, scene, most, marks=pytest.mark.slow)
        for name in ("shear.stiffness", "slip_friction.strength")
        for scene, most in (("bias-1x3", 1e-5), ("coulomb", 1e-2))
    ),
]


def case_of(name: str) -> Case:
    """Return a case of ``configs``, with one short cycle; or a small one without sliding yarns."""
    settings: dict[str, Any] = {
        "program.amplitudes": "[40 mm]",
        "time.steps_per_cycle": "8",
        "solver.tolerance": 1e-12,
    }
    if name == "small":
        name, elastic = "bias-1x3", {"stretch": "1e5 N/m", "shear": "400 N/m"}
        settings["effects"] = {effect: {"stiffness": value} for effect, value in elastic.items()}
        settings["discretisation"] = {"degree": 2, "mesh_size": "0.3 m"}
    return read_case(ROOT / "configs" / f"{name}.yaml", settings)


@pytest.mark.parametrize(("name", "scene", "most"), CASES)
def test_a_coefficient_of_a_formula_has_its_derivative(name: str, scene: str, most: float) -> None:
    formula, coefficient, value, *others = FORMULAS[name]
    base = case_of(scene)
    target = Target(*name.split("."), coefficient=coefficient)  # type: ignore[misc]

    def run(text: str, targets: Sequence[Target] = ()) -> Any:
        case = base.changed({f"effects.{name}": text})
        with simulation_of(case, sheet_of(case, MPI.COMM_SELF)) as simulation:
            if targets:
                differentiate(simulation, case, targets)
            return [
                step.derivatives.force[0] if step.derivatives else step.force
                for step in simulation.steps()
            ]

    slope = np.array(run(formula, [target]))
    up, down = (np.array(run(formula.replace(value, other))) for other in others)
    change = float(others[0].split()[0]) - float(others[1].split()[0])
    difference = (up - down) / change
    assert np.abs(difference).max() > 0
    assert np.abs(slope - difference).max() < most * np.abs(difference).max()


def test_a_coefficient_that_no_formula_has_is_refused() -> None:
    case = case_of("small")
    refused = pytest.raises(TargetError, match=r"shear\.stiffness#1 is no parameter")
    with simulation_of(case, sheet_of(case, MPI.COMM_SELF)) as simulation, refused:
        differentiate(simulation, case, [Target("shear", "stiffness", coefficient=1)])


@pytest.mark.mpi
def test_ranks_share_the_derivatives_of_a_case_whose_placements_jump() -> None:
    settings = {
        "program.amplitudes": "[40 mm]", "time.steps_per_cycle": "8", "discretisation.degree": "2"
    }  # fmt: skip
    case = read_case(ROOT / "configs" / "bias-1x3.yaml", settings)
    targets = [Target("bending", "stiffness"), Target("slip_friction", "slope")]
    rows = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        with simulation_of(case, sheet_of(case, comm)) as simulation:
            differentiate(simulation, case, targets)
            rows.append([step.derivatives.force for step in simulation.steps()])
    both, alone = (np.array(r) for r in rows)
    assert np.abs(both - alone).max(axis=0) == pytest.approx(0.0, abs=1e-6 * np.abs(alone).max())
