"""Effects with internal variables: closed forms, orders, energy balance, rejected steps, ranks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from scipy.integrate import solve_ivp

from tests import scenes
from tests.stepping.test_sensitivity import assert_second_order, differences
from tests.verification.test_closed_forms import (
    AREA,
    DRIVE,
    ETA,
    K_C,
    SECOND_AT_REST,
    STROKE,
    TWO_STEPS,
    whole,
)
from wovenfab.forms.effect import (
    DualFrictionLaw,
    Effect,
    InternalVariable,
    Needs,
    Parameter,
    Target,
    Term,
)
from wovenfab.forms.kinematics import shear_tangent
from wovenfab.model.constraints import Condition, EdgeLoad
from wovenfab.model.model import Model, Numerics, build_model
from wovenfab.sheet.sheet import Sheet
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.problem import SolveResult, SolverOptions
from wovenfab.stepping.program import cycle, program_of, ramp
from wovenfab.stepping.schemes import SCHEMES
from wovenfab.stepping.step import Step

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "wear.yaml"
WEAR: Effect = run_path(str(EXAMPLE.with_suffix(".py")))["EFFECT"]
#: The same as a set-valued law.
COULOMB = replace(
    WEAR,
    parameters=WEAR.parameters[:3],
    needs=Needs(placements=2, increment=True),
    dissipation=None,
    bound=DualFrictionLaw(WEAR.bound.strength),  # type: ignore[union-attr]
)


def largest(now: Any, before: Any, values: Any, step: Any) -> Any:
    """Return the largest square of the shear so far."""
    import ufl

    return ufl.max_value(values["largest"], shear_tangent(now.f, now.fibres) ** 2)


#: Shear whose stiffness falls with the largest shear so far (Mullins' effect).
SOFTENING = Effect(
    name="softening",
    summary="Shear that softens",
    parameters=(
        Parameter("stiffness", "N/m", "at first"),
        Parameter("square", "1", "square of the shear at which half is left"),
    ),
    memory=(InternalVariable("largest", "1", "largest square of the shear", largest),),
    energy=lambda point, values: (
        values["stiffness"]
        / (2 * (1 + values["largest"] / values["square"]))
        * shear_tangent(point.f, point.fibres) ** 2
    ),
    resists=frozenset({"shearing"}),
)
START, END, LENGTH = 2e5, 1e5, 0.02
VALUES = {
    **scenes.TABLE_1,
    "stretch": {"stiffness": (1.27e8, 1.27e8)},
    "coupling": {"stiffness": K_C},
    "wear": {"strength": START, "end": END, "length": LENGTH, "slope": ETA},
    "softening": {"stiffness": 4e4, "square": 0.01},
}


def strength(slid: float) -> float:
    return float(END + (START - END) * np.exp(-slid / LENGTH))


def loss_of(slid: float) -> float:
    """Return the energy per area (J/m^2) that Coulomb's law with this strength loses."""
    return END * slid + (START - END) * LENGTH * (1 - float(np.exp(-slid / LENGTH)))


def built(
    on: Sheet,
    chosen: Sequence[str | Effect],
    numerics: Numerics = TWO_STEPS,
    values: Any = VALUES,
    conditions: Sequence[Condition] = (),
) -> Model:
    """Return a model of effects by name, or as they are."""
    effects = [scenes.effect(e) if isinstance(e, str) else e for e in chosen]
    terms = [Term(e, values[e.name]) for e in effects]
    return build_model(on, terms, conditions, numerics)


def slider(friction: Effect, history: int = 2) -> Model:
    on = whole(0.2, 0.1, 0.1, scenes.ALONG)
    return built(on, ("coupling", friction), Numerics(1, history=history))


@pytest.mark.parametrize(
    "scheme", ["backward-euler", "midpoint", "bdf2", pytest.param("bdf3", marks=pytest.mark.slow)]
)
def test_a_driven_slider_is_as_its_scalar_equations(scheme: str) -> None:
    """One point: force and loss of each step, integrated again with numbers alone."""
    how, count, period = SCHEMES[scheme], 20, 0.5
    program = program_of(cycle(0.0, 1.0, period, count))
    steps = scenes.march(slider(WEAR, max(2, how.memory)), program, scheme, DRIVE)
    slips = np.array([s.displacement * STROKE for s in steps])
    slid = lost = power_before = 0.0
    for n in range(1, count + 1):
        weights = how.weights(4 * [period / count])
        stage = slips[n - 1] + how.stage * (slips[n] - slips[n - 1])
        earlier = (stage, slips[n - 1], slips[max(n - 2, 0)], slips[max(n - 3, 0)])
        rate = sum(w * b for w, b in zip(weights, earlier, strict=False))
        friction = strength(slid) * np.tanh(ETA * rate)
        power = friction @ rate * AREA
        lost += period / count * (power if how.stage < 1 else (power + power_before) / 2)
        power_before = power
        assert steps[n].dissipated["wear"] == pytest.approx(lost, rel=1e-11)
        if how.stage == 1:
            force = (K_C * slips[n] + friction) * AREA
            assert steps[n].reactions["first"] == pytest.approx(force, rel=1e-10)
        slid += np.abs(slips[n] - slips[n - 1]).sum()
    assert slid == pytest.approx(2 * STROKE.sum(), rel=1e-12)


@pytest.mark.slow
def test_a_slider_with_coulombs_law_loses_its_closed_form_with_order_one() -> None:
    """The strength lags by one step: the only error, which is of first order in the step."""
    model, errors = slider(COULOMB), []
    for count in (20, 40, 80):
        steps = scenes.march(model, program_of(cycle(0.0, 1.0, 1.0, count)), "bdf2", DRIVE)
        model = slider(COULOMB)
        exact = loss_of(2 * STROKE.sum()) * AREA
        errors.append(scenes.lost(steps[-1]) / exact - 1)
        slips = [s.displacement * STROKE.sum() for s in steps]
        ways = np.abs(np.diff(slips))
        lagging = sum(strength(s) * w for s, w in zip(np.cumsum([0, *ways]), ways, strict=False))
        assert scenes.lost(steps[-1]) == pytest.approx(lagging * AREA, rel=1e-9)
    print(f"\nerrors of the loss {np.round(errors, 4)}")
    assert scenes.orders(errors) == pytest.approx(1.0, abs=0.1)


def test_a_pushed_slider_creeps_as_its_equation_says_with_order_one() -> None:
    """K_c b + zeta(s) tanh(eta db/dt) = f, pushed suddenly; its strength falls as it slides."""
    length, duration, push = 0.2, 0.5, 0.45 * START

    def rate(_: float, b: np.ndarray) -> np.ndarray:
        return np.arctanh((push - K_C * b) / strength(b[0])) / ETA

    exact = solve_ivp(rate, (0, duration), [0.0], "Radau", rtol=1e-11, atol=1e-15).y[0, -1]
    load = EdgeLoad("right", (0,), (lambda x, program, _: push * length * program, 0.0))
    stiff = {**VALUES, "stretch": {"stiffness": (1e13, 1e13)}}
    errors = []
    for count in (40, 80, 160):
        on = whole(length, 0.1, 0.1, scenes.ALONG)
        model = built(on, ("stretch", "coupling", WEAR), values=stiff, conditions=[load])
        suddenly = ramp(0.0, 1.0, 1e-6 * duration, 1)
        program = program_of([suddenly, ramp(1.0, 1.0, duration, count)])
        scenes.march(model, program, "bdf2", (SECOND_AT_REST,))
        errors.append(model.field.x.array.reshape(-1, 4)[:, 0].mean() / exact - 1)
    print(f"\nerrors of the slip {errors}")
    assert scenes.orders(errors) == pytest.approx(1.0, abs=0.1)
    assert abs(errors[-1]) < 1e-4


SCENES = {
    "wear": ("stretch", "shear", "bending", "coupling", WEAR),
    "coulomb": ("stretch", "shear", "bending", "coupling", COULOMB),
    "softening": ("stretch", "bending", SOFTENING),
    "both": ("stretch", "bending", "coupling", WEAR, SOFTENING),
}


def sheet(scene: str, comm: MPI.Comm = MPI.COMM_WORLD, mesh_size: float = 0.15) -> Model:
    on = scenes.sheet(0.6, 0.3, mesh_size, comm=comm)
    return built(on, SCENES[scene], scenes.PROTOTYPE_TWO_STEPS)


LOOP = program_of(cycle(0.0, 0.04, 0.8, 20))


@pytest.mark.parametrize(
    ("scene", "scheme"),
    [
        ("both", "midpoint"),
        pytest.param("coulomb", "bdf2", marks=pytest.mark.slow),
        pytest.param("wear", "midpoint", marks=pytest.mark.slow),
        pytest.param("both", "bdf2", marks=pytest.mark.slow),
        pytest.param("softening", "midpoint", marks=pytest.mark.slow),
    ],
)
def test_work_is_stored_or_lost_to_second_order_and_nothing_is_gained(
    scene: str, scheme: str
) -> None:
    model, shares = sheet(scene), []
    for count in (20, 40, 80):
        steps = scenes.march(model, program_of(cycle(0.0, 0.04, 0.8, count)), scheme)
        shares.append(max(abs(scenes.imbalance(s)) for s in steps) / scenes.lost(steps[-1]))
        for name, lost in steps[-1].dissipated.items():
            assert (np.diff([s.dissipated[name] for s in steps]) >= 0).all() and lost > 0
    print(f"\n{scene}, {scheme}: imbalance {shares}, orders {scenes.orders(shares)}")
    assert scenes.orders(shares).mean() > 1.8
    assert shares[-1] < 3e-3


class Refusing(EquilibriumSolver):
    """A solver that calls every third solution a failure."""

    calls = 0

    def solve(self, allow_fallback: bool = True) -> SolveResult:
        """Solve, and call it a failure or not."""
        result = super().solve(allow_fallback)
        self.calls += 1
        return replace(result, converged=result.converged and self.calls % 3 != 0)


def test_rejected_steps_do_not_change_the_history(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run with rejected steps is one whose steps were planned as they were accepted."""
    model = sheet("both", mesh_size=0.3)
    precise = SolverOptions(tolerance=1e-13)
    with monkeypatch.context() as patch:
        patch.setattr(scenes, "EquilibriumSolver", Refusing)
        steps = scenes.run(model, program_of([ramp(0.0, 0.04, 1.0, 6)]), precise).steps
    variables = [v.accepted[0] for v in model.memory.variables]  # type: ignore[union-attr]
    assert sum(s.cutbacks for s in steps) > 2
    planned = [ramp(a.displacement, b.displacement, b.time - a.time, 1) for a, b in pairwise(steps)]
    again = scenes.run(model, program_of(planned), precise).steps
    assert sum(s.cutbacks for s in again) == 0 and len(again) == len(steps)
    assert scenes.forces(again) == pytest.approx(scenes.forces(steps), rel=1e-8)
    for one, other in zip(variables, model.memory.variables, strict=True):  # type: ignore[union-attr]
        assert one.max() > 0
        assert other.accepted[0] == pytest.approx(one, abs=1e-8 * one.max())


@pytest.mark.parametrize(
    ("scene", "scheme", "names"),
    [
        pytest.param("wear", "bdf2", ("wear",), marks=pytest.mark.slow),
        pytest.param("both", "midpoint", ("wear", "softening"), marks=pytest.mark.slow),
        pytest.param("softening", "backward-euler", ("softening",), marks=pytest.mark.slow),
    ],
)
def test_what_the_derivative_leaves_falls_with_the_square_of_the_change(
    scene: str, scheme: str, names: Sequence[str]
) -> None:
    """By every parameter; the variables have derivatives of their own, which go into it."""
    targets = [Target(n, p) for n in names for p in VALUES[n]]
    assert_second_order(sheet(scene), targets, scheme=scheme)


@pytest.mark.slow
def test_derivatives_with_stress_at_points_agree_with_differences() -> None:
    model = sheet("coulomb")
    for scheme, *parameters in (("bdf2", "end"), ("midpoint", "end", "length")):
        targets = [Target("wear", parameter) for parameter in parameters]
        force, lost = differences(model, targets, share=1e-5, scheme=scheme).T
        assert force.max() < 1e-3 and lost.max() < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["bdf2", "midpoint"])
def test_derivatives_by_every_parameter_agree_with_differences(scheme: str) -> None:
    targets = [Target("wear", parameter) for parameter in ("strength", "end", "length")]
    force, lost = differences(sheet("coulomb"), targets, share=1e-5, scheme=scheme).T
    assert force.max() < 1e-3 and lost.max() < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("weaker", [2.0**-20, pytest.param(1e-6, marks=pytest.mark.slow)])
def test_a_bound_that_starts_at_zero_is_solved_alike_on_a_weak_sheet(weaker: float) -> None:
    """A bound that grows from nothing has no scale of its own: that of the sheet counts.

    All stiffnesses and strengths are multiplied by the same number, and so are forces and losses.
    """
    grows = {**VALUES, "wear": {"strength": 0.0, "end": END, "length": LENGTH}}
    chosen = SCENES["coulomb"]
    weak = {
        effect: {
            name: v if name == "length" else np.multiply(weaker, v) for name, v in some.items()
        }
        for effect, some in grows.items()
    }
    on, numerics = scenes.sheet(0.6, 0.3, 0.15), scenes.PROTOTYPE_TWO_STEPS
    strong, scaled = (
        scenes.march(built(on, chosen, numerics, values), LOOP, "bdf2") for values in (grows, weak)
    )
    print(f"\n{[s.iterations for s in strong]}, {[s.iterations for s in scaled]}")
    assert [s.iterations for s in scaled] == [s.iterations for s in strong]
    forces = scenes.forces(strong)
    assert scenes.forces(scaled) == pytest.approx(weaker * forces, abs=1e-9 * weaker * forces.max())
    assert scenes.lost(strong[-1]) > 0
    assert scenes.lost(scaled[-1]) == pytest.approx(weaker * scenes.lost(strong[-1]), rel=1e-9)


def test_a_scene_without_internal_variables_builds_nothing_of_them() -> None:
    plain = scenes.model(scenes.sheet(), (*scenes.COUPLED, "slip_friction"))
    assert plain.memory is None and plain.loss == {}


@pytest.mark.mpi
@pytest.mark.mpi4
@pytest.mark.parametrize("scene", ["both", pytest.param("coulomb", marks=pytest.mark.slow)])
def test_ranks_together_have_the_history_of_one(scene: str) -> None:
    def figures(comm: MPI.Comm) -> tuple[list[Step], list[float]]:
        model = sheet(scene, comm=comm)
        steps = scenes.march(model, LOOP, "bdf2")
        sums = [v.accepted[0].sum() for v in model.memory.variables]  # type: ignore[union-attr]
        return steps, comm.allreduce(np.array(sums))

    (steps, sums), (alone, expected) = figures(MPI.COMM_WORLD), figures(MPI.COMM_SELF)
    force = scenes.forces(alone)
    assert scenes.forces(steps) == pytest.approx(force, abs=1e-8 * force.max())
    assert scenes.lost(steps[-1]) == pytest.approx(scenes.lost(alone[-1]), rel=1e-8)
    assert sums == pytest.approx(expected, rel=1e-7)
