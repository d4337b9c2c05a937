"""A failure names its cause and the place, and both are right."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np
import pytest
import ufl
from mpi4py import MPI
from petsc4py import PETSc

from tests import scenes
from wovenfab.compat import NOT_FINITE
from wovenfab.forms import effects
from wovenfab.forms.effect import Effect, Parameter, Term
from wovenfab.forms.kinematics import norm
from wovenfab.model.constraints import Grip
from wovenfab.model.model import Model, Numerics, build_model
from wovenfab.solver.diagnosis import Diagnosis, diagnose, null_vector, proven_penalty
from wovenfab.solver.problem import SolveResult, SolverOptions
from wovenfab.stepping.program import program_of, ramp
from wovenfab.stepping.schemes import SCHEMES
from wovenfab.stepping.step import StepFailedError, UnsoundSheetError
from wovenfab.stepping.time_stepper import TimeStepper

SHORT = 0.6


def failure(
    model: Model, displacement: float, steps: int = 1, options: SolverOptions | None = None,
    smallest: float = 1 / 8, grips: tuple[Grip, ...] = scenes.PULL,
) -> StepFailedError:  # fmt: skip
    """Return how a pull fails."""
    model.field.x.array[:] = 0
    equilibrium = scenes.solver(model, grips, options)
    program = program_of([ramp(0.0, displacement, 1.0, steps)])
    march = TimeStepper(equilibrium, program, SCHEMES["backward-euler"], smallest)
    with pytest.raises(StepFailedError) as caught:
        list(march.steps())
    equilibrium.destroy()
    return caught.value


def own(energy: object, resists: str) -> Effect:
    return Effect(
        name="own",
        summary="of this test",
        parameters=(Parameter("stiffness", "N/m", "k"),),
        energy=energy,  # type: ignore[arg-type]
        resists=frozenset({resists}),
    )


def with_own(effect: Effect, names: tuple[str, ...]) -> Model:
    chosen = [*(effects()[name] for name in names), effect]
    values = {**scenes.TABLE_1, "own": {"stiffness": 400.0}}
    terms = [Term(e, values[e.name]) for e in chosen]
    return build_model(scenes.sheet(), terms, (), scenes.PROTOTYPE)


def test_an_effect_that_gives_no_number_is_named_and_so_is_where() -> None:
    def energy(point: object, values: object) -> object:
        """Finite only while the first family is stretched by less than 1 %."""
        room = ufl.sqrt(1.01 - norm(point.f[0]))  # type: ignore[attr-defined]
        return values["stiffness"] * 1e-6 * room  # type: ignore[index]

    model = with_own(own(energy, "shearing"), scenes.BONDED)
    error = failure(model, 0.3, steps=8)
    found = error.diagnosis
    assert "the energy of own is not a number" in found.cause
    assert error.result.reason == NOT_FINITE
    assert 0.002 < found.place.stretches[0] < 0.02  # of 1 % at the points of the cells
    assert np.isfinite(model.field.x.array).all()


def test_a_motion_that_nothing_resists_is_named() -> None:
    def energy(point: object, values: object) -> object:
        """Resist stretching of the first family and nothing else."""
        stretch = norm(point.f[0]) - 1  # type: ignore[attr-defined]
        return values["stiffness"] / 2 * stretch**2  # type: ignore[index]

    found = failure(with_own(own(energy, "stretching"), ()), 0.1).diagnosis
    assert "singular" in found.cause
    assert "hold more edges" in found.remedy


def test_the_direction_that_nothing_resists_is_that_of_the_free_one_of_two_chains() -> None:
    links = 20
    chain = 2 * np.eye(links) - np.eye(links, k=1) - np.eye(links, k=-1)
    held, free = chain.copy(), chain.copy()
    held[-1, -1] = free[0, 0] = free[-1, -1] = 1.0
    dense = np.block([[held, np.zeros_like(held)], [np.zeros_like(held), free]])
    matrix = PETSc.Mat().createAIJ(dense.shape, nnz=3, comm=MPI.COMM_SELF)
    for row, column in np.argwhere(dense):
        matrix.setValue(row, column, 1e6 * dense[row, column])
    matrix.assemble()
    found = np.abs(null_vector(matrix))
    matrix.destroy()
    assert found == pytest.approx(np.repeat([0, 1 / np.sqrt(links)], links), abs=1e-8)


@pytest.mark.parametrize("degree", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_a_penalty_too_small_is_named_before_a_wrong_answer_is_given(degree: int) -> None:
    numerics = Numerics(degree, quadrature=4, penalty=0.3)
    error = failure(scenes.model(scenes.sheet(), scenes.BONDED, numerics), 0.01)
    assert isinstance(error, UnsoundSheetError)
    assert "discretisation.penalty = 0.3 is too small" in error.diagnosis.cause
    assert f"{0.75 * degree * (degree - 1):.3g} or more" in error.diagnosis.remedy
    assert "not stable" in str(error) and "Probable cause" in str(error)


def test_a_penalty_below_the_proven_one_is_left_alone_if_the_sheet_is_stable_with_it() -> None:
    model = scenes.model(scenes.sheet(), scenes.BONDED, Numerics(2, quadrature=4, penalty=1.0))
    assert proven_penalty(model) > 1.0
    assert len(scenes.march(model, program_of([ramp(0.0, 0.01, 1.0, 1)]))) == 2


def test_the_proven_penalty_is_that_of_equal_triangles_and_doubles_where_yarns_are_held() -> None:
    model = scenes.model(scenes.sheet(), scenes.BONDED, scenes.PROTOTYPE)
    for degree in (2, 3, 4):
        other = replace(model, balance=replace(model.balance, degree=degree))
        assert proven_penalty(other) == pytest.approx(0.75 * degree * (degree - 1), rel=1e-12)
        held = replace(other, balance=replace(other.balance, held_edges=(object(), None)))
        assert proven_penalty(held) == pytest.approx(1.5 * degree * (degree - 1), rel=1e-12)


def test_locking_is_named_where_the_families_align() -> None:
    model = scenes.model(scenes.sheet(SHORT), scenes.BONDED, scenes.PROTOTYPE)
    error = failure(model, 0.3, steps=40)
    found = error.diagnosis
    assert "locks" in found.cause
    assert error.displacement > 0.15  # far beyond (sqrt(2) - 1) 0.3 m
    assert found.place.margin < 0.02
    assert found.place.margin == pytest.approx(np.cos(found.place.shear), abs=1e-6)
    assert abs(np.degrees(found.place.shear)) > 88


def diagnosis_of(model: Model, reason: str) -> Diagnosis:
    """Return what is said of a state if a solve that began there had failed."""
    equilibrium = scenes.solver(model)
    state = model.field.x.array.copy()
    result = SolveResult(False, reason, 25, 1.0)
    found = diagnose(equilibrium, result, state)
    equilibrium.destroy()
    return found


def test_a_state_that_is_no_minimum_is_named() -> None:
    """Yarns along x under compression: the straight state is a saddle."""
    on = scenes.sheet(1.0, 0.25, 0.125, fibres=(0.0, pi / 2))
    model = scenes.model(on, scenes.BONDED, scenes.PROTOTYPE)
    scenes.set_field(model.field, lambda x: np.vstack([-0.1 * x[0], 0 * x[0]]))
    assert "not stable" in diagnosis_of(model, "DIVERGED_MAX_IT").cause
    scenes.set_field(model.field, lambda x: np.vstack([+0.1 * x[0], 0 * x[0]]))
    assert "step is too large" in diagnosis_of(model, "DIVERGED_MAX_IT").cause


def test_a_factorisation_that_fails_on_a_sound_sheet_is_named() -> None:
    model = scenes.model(scenes.sheet(), scenes.BONDED, scenes.PROTOTYPE)
    # The block form of a Cholesky factor judges no single pivot; an LU factor does.
    options = {"pc_type": "lu", "pc_factor_mat_solver_type": "petsc", "pc_factor_zeropivot": 1e30}
    error = failure(model, 0.01, options=SolverOptions(options=options))
    assert error.result.reason == "DIVERGED_LINEAR_SOLVE"
    assert "factorisation failed" in error.diagnosis.cause


def test_otherwise_the_step_is_too_large_and_the_place_is_where_it_moves_most() -> None:
    model = scenes.model(scenes.sheet(), scenes.BONDED, scenes.PROTOTYPE)
    found = failure(model, 0.1, 1, SolverOptions(max_iterations=1), 1.0).diagnosis
    assert "step is too large" in found.cause and "iterations: 1" in found.cause
    assert "steps" in found.remedy


def test_the_place_tells_shear_stretch_and_slip_of_the_last_equilibrium() -> None:
    names = scenes.COUPLED
    model = scenes.model(scenes.sheet(), names, scenes.PROTOTYPE)
    a, b, u = 0.01, -0.02, np.array([0.003, -0.004])

    def shape(x: np.ndarray) -> np.ndarray:
        """Both placements: homogeneous stretch a of family 1, b of family 2, slip u."""
        d = np.array([[np.cos(t), np.sin(t)] for t in scenes.BIAS])
        gradient = a * np.outer(d[0], d[0]) + b * np.outer(d[1], d[1])
        first = gradient @ x[:2]
        return np.vstack([first, first - u[:, None]])

    model.field.interpolate(shape)
    place = diagnosis_of(model, "DIVERGED_MAX_IT").place
    assert place.stretches == pytest.approx((a, b), abs=1e-12)
    assert place.shear == pytest.approx(0.0, abs=1e-12)
    assert place.slip == pytest.approx(0.005, rel=1e-10)
    text = str(place)
    assert "stretches 1 % and -2 %" in text and "slip 5 mm" in text
    model.field.x.array[:] = 0
