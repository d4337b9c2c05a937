"""Newton's method on nearly inextensible yarns: few iterations, honest convergence."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from tests import scenes
from wovenfab.case import Case
from wovenfab.case.objects import sheet_of, simulation_of
from wovenfab.model.constraints import Grip, Held
from wovenfab.model.model import Model, Numerics
from wovenfab.solver.globalisation import SHORTEST, LineSearch
from wovenfab.solver.interior_point import InteriorPoint
from wovenfab.solver.newton import STUCK
from wovenfab.solver.problem import SolveResult, SolverOptions
from wovenfab.solver.tangent_spectrum import TangentSpectrum

CUBIC = Numerics(3)
LARGE = 0.1


def bonded(numerics: Numerics, mesh_size: float = 0.05) -> Model:
    held = ("left",) if numerics.degree == 3 else ()
    on = scenes.sheet(mesh_size=mesh_size)
    return scenes.model(on, scenes.BONDED, numerics, rotation_edges=held)


def one_step(
    model: Model, displacement: float, options: SolverOptions | None = None
) -> tuple[SolveResult, dict[str, tuple[float, float]]]:
    equilibrium = scenes.solver(model, options=options)
    constraints = equilibrium.problem.constraints
    constraints.set(displacement)
    result = equilibrium.solve()
    reactions = constraints.reactions(equilibrium.problem.force)
    equilibrium.destroy()
    return result, reactions


@pytest.mark.parametrize("numerics", [scenes.PROTOTYPE, CUBIC], ids=["P2", "P3"])
@pytest.mark.parametrize("mesh_size", [0.15, 0.05, 0.025])
def test_a_large_pull_from_rest_in_one_step_takes_at_most_ten_iterations(
    numerics: Numerics, mesh_size: float
) -> None:
    result, _ = one_step(bonded(numerics, mesh_size), LARGE)
    print(f"\nP{numerics.degree}, h = {1e3 * mesh_size:g} mm: {result.iterations} iterations")
    assert result.converged
    assert result.iterations <= 10


@pytest.mark.slow
def test_the_plain_tangent_needs_more_iterations_for_the_same_solution() -> None:
    mixed, plain = bonded(scenes.PROTOTYPE), bonded(replace(scenes.PROTOTYPE, mixed=False))
    own = SolverOptions(keep_factor=False)  # a tangent for each iteration
    (few, force), (many, same) = one_step(mixed, LARGE, own), one_step(plain, LARGE, own)
    print(f"\nmixed tangent {few.iterations} iterations, plain {many.iterations}")
    assert few.converged and many.converged
    assert few.iterations < many.iterations
    assert force["right"][0] == pytest.approx(same["right"][0], rel=1e-8)
    assert mixed.field.x.array == pytest.approx(plain.field.x.array, abs=1e-10)


@pytest.mark.parametrize("displacement", [1e-3, 1e-5, 1e-7, 0.0])
@pytest.mark.parametrize("names", [scenes.BONDED, scenes.COUPLED], ids=["one", "two placements"])
def test_a_small_step_from_rest_converges_in_spite_of_round_off(
    names: tuple[str, ...], displacement: float
) -> None:
    model = scenes.model(scenes.sheet(fibres=(0.3, -0.9)), names, scenes.PROTOTYPE)
    result, reactions = one_step(model, displacement)
    assert result.converged and result.iterations <= 5
    stiffness = one_step(model, 1e-6)[1]["right"][0] / 1e-6
    tolerance = 1e-2 if displacement > 1e-4 else 1e-4
    assert reactions["right"][0] == pytest.approx(
        stiffness * displacement, rel=tolerance, abs=1e-9 * stiffness * 1e-3
    )


def test_convergence_is_judged_by_the_forces_of_the_state_not_of_the_way_there() -> None:
    """A bending yarn: its iterates meet huge forces of stretch, its equilibrium small ones."""
    values = {
        "stretch": {"stiffness": (1e8, 1e8)},
        "shear": {"stiffness": 0.0},
        "bending": {"stiffness": (1.0, 1.0)},
    }
    on = scenes.sheet(1.0, 0.25, 0.125, "right", fibres=(0.0, pi / 2))
    model = scenes.model(on, scenes.BONDED, CUBIC, values, rotation_edges=("left",))
    grips = (Grip("left", (Held(), Held())), Grip("right", (None, Held(1.0))))
    equilibrium = scenes.solver(model, grips)
    constraints = equilibrium.problem.constraints
    for deflection in (0.3, 0.5):
        constraints.set(deflection)
        result = equilibrium.solve()
        assert result.converged
        assert result.residual < 1e-6 * np.linalg.norm(equilibrium.problem.force)
    equilibrium.destroy()


def test_iterates_lower_the_potential_once_the_prescribed_placements_are_attained() -> None:
    model = scenes.model(scenes.sheet(0.6, mesh_size=0.05), scenes.BONDED, scenes.PROTOTYPE)
    equilibrium = scenes.solver(model)
    constraints = equilibrium.problem.constraints
    energies: list[float] = []

    def watch(*_: object) -> None:
        if not constraints.unmet(model.field):
            energies.append(scenes.energy(model))

    equilibrium.newton.snes.setMonitor(watch)
    constraints.set(0.15)
    assert equilibrium.solve().converged
    assert len(energies) > 3
    assert (np.diff(energies) <= 1e-9 * max(energies)).all()
    equilibrium.destroy()


def test_two_live_solvers_have_petsc_options_of_their_own() -> None:
    model, before = bonded(scenes.PROTOTYPE, 0.15), PETSc.Options().getAll()
    gmres = SolverOptions(options={"ksp_type": "gmres", "snes_max_it": 7})
    first, second = scenes.solver(model, options=gmres), scenes.solver(model)
    assert (first.linear.method[0], second.linear.method[0]) == ("gmres", "preonly")
    assert first.newton.snes.getTolerances()[3] == 7 != second.newton.snes.getTolerances()[3]
    first.destroy()  # what the second one still has to read stays
    second.problem.prescribe(1e-3)
    assert second.solve().converged
    assert second.linear.factor.getMumpsIcntl(13) == 1
    second.destroy()
    assert PETSc.Options().getAll() == before


@pytest.mark.parametrize("method", [pytest.param("gmres", marks=pytest.mark.slow), "cg"])
def test_an_iterative_linear_solver_attains_prescribed_displacements_near_zero(method: str) -> None:
    """At the end of a cycle friction leaves the sheet deformed while the grip is at zero."""
    case = Case(
        sheet={"length": 0.3, "width": 0.1, "fibres": ["45 deg", "-45 deg"]},
        effects={
            "stretch": {"stiffness": "50 kN/m"},
            "shear": {"stiffness": "30 N/m"},
            "spin_friction": {"strength": "5 N/m", "slope": "40 s"},
        },
        boundary={"left": "clamp", "right": {"displacement": ["program", 0]}},
        program={"type": "cycles", "amplitudes": "20 mm", "frequency": "0.1 Hz"},
        discretisation={"degree": 2, "mesh_size": 0.05},
        time={"steps_per_cycle": 10},
        solver={"petsc": {"ksp_type": method}},
    )
    with simulation_of(case, sheet_of(case, MPI.COMM_WORLD)) as simulation:
        steps = list(simulation.steps())
    assert len(steps) == 11 and not any(step.cutbacks for step in steps)
    assert max(step.iterations for step in steps) < 10


def test_options_of_the_command_line_reach_each_solver_and_win() -> None:
    model, database = bonded(scenes.PROTOTYPE, 0.15), PETSc.Options()
    database["ksp_type"] = "cg"
    try:
        equilibrium = scenes.solver(model, options=SolverOptions(options={"ksp_type": "gmres"}))
        assert equilibrium.linear.method[0] == "cg"
        equilibrium.destroy()
    finally:
        database.delValue("ksp_type")


def test_every_result_has_a_name() -> None:
    model = bonded(scenes.PROTOTYPE, 0.15)
    result, _ = one_step(model, LARGE, SolverOptions(max_iterations=1))
    assert result == SolveResult(False, "DIVERGED_MAX_IT", 1, result.residual)


def test_an_exception_restores_what_is_overwritten_for_a_moment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The weight of the geometric part, weights of effects, and the field in a line search."""

    def fail(*_: object) -> None:
        raise MemoryError

    model = bonded(scenes.PROTOTYPE, 0.15)
    equilibrium = scenes.solver(model)
    newton, constants = equilibrium.newton, [model.geometric_weight, *model.weights.values()]
    x, y = newton.solution.copy(), newton.solution.copy()
    y.set(1e-3)
    monkeypatch.setattr("wovenfab.model.model.assemble_scalar", fail)
    monkeypatch.setattr(type(equilibrium.problem), "energy", fail)
    monkeypatch.setattr(type(equilibrium.problem), "evaluate_tangent", fail)
    monkeypatch.setattr(TangentSpectrum, "saddle", True)
    monkeypatch.setattr(newton.line_search, "along", lambda *_, **__: 0.5)
    for attempt in (model.stored_energy, lambda: newton.search_line(x, y, 1.0)):
        with pytest.raises(MemoryError):
            attempt()
        assert [float(constant.value) for constant in constants] == [1.0] * len(constants)
    before, search = (
        model.field.x.array.copy(),
        LineSearch(equilibrium.problem),
    )
    search.potential = 0.0
    with pytest.raises(MemoryError):
        search.along(y.array_r, 1.0, 1.0, lambda energy: 0.0)
    assert (model.field.x.array == before).all()
    for vector in (x, y):
        vector.destroy()
    equilibrium.destroy()


def test_a_solve_with_stress_at_points_whose_steps_become_tiny_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tiny = SHORTEST / 10
    model = scenes.model(scenes.sheet(), (*scenes.COUPLED, "slip_friction:coulomb"))
    monkeypatch.setattr(InteriorPoint, "correct", lambda _, step, __: (step, tiny))
    result, _ = one_step(model, LARGE)
    assert result.reason == "DIVERGED_LINE_SEARCH"
    assert result.iterations == STUCK
