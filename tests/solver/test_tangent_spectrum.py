"""What the factor tells of the tangent, against all its eigenvalues from a dense solver."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from petsc4py import PETSc

from tests import scenes
from wovenfab.model.model import Model
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.problem import SolveResult, SolverOptions
from wovenfab.solver.tangent_spectrum import TangentSpectrum, start_vector
from wovenfab.stepping.stability import leave_saddle, softest_mode

#: Pushed along the yarns, the coarse sheet buckles first at 0.026 mm.
CRITICAL = 2.6e-5


def pushed(
    displacement: float, options: SolverOptions | None = None
) -> tuple[Model, EquilibriumSolver, SolveResult]:
    """Return the bonded sheet after one step from rest."""
    on = scenes.sheet(fibres=scenes.ALONG)
    model = scenes.model(on, scenes.BONDED, scenes.PROTOTYPE)
    equilibrium = scenes.solver(model, scenes.PUSH, options)
    constraints = equilibrium.problem.constraints
    constraints.set(displacement)
    return model, equilibrium, equilibrium.solve()


def tangent(equilibrium: EquilibriumSolver) -> NDArray[np.float64]:
    """Return both halves of the tangent of the present state."""
    equilibrium.tangent()
    matrix = scenes.tangent(equilibrium.problem.model, equilibrium.problem.constraints.bcs)
    values: NDArray[np.float64] = matrix.convert("dense").getDenseArray().copy()
    matrix.destroy()
    assert np.abs(values - values.T).max() < 1e-12 * np.abs(values).max()
    return values


def held(equilibrium: EquilibriumSolver) -> NDArray[np.int32]:
    """Return the prescribed unknowns."""
    return np.concatenate([bc.dof_indices()[0] for bc in equilibrium.problem.constraints.bcs])


@pytest.mark.parametrize("times", [0.0, 0.5, 0.95, 1.1, 4.0, 40.0, 400.0])
def test_the_factor_counts_the_negative_eigenvalues(times: float) -> None:
    _, equilibrium, result = pushed(times * CRITICAL)
    eigenvalues = np.linalg.eigvalsh(tangent(equilibrium))
    assert result.converged
    assert result.negatives == (eigenvalues < 0).sum()
    assert (result.negatives > 0) == (times > 1)
    equilibrium.destroy()


@pytest.mark.parametrize(("times", "kind"), [(0.5, "1"), (1.1, "2")])
def test_pivots_are_searched_for_only_where_one_was_negative(
    times: float, kind: str, tmp_path: Path
) -> None:
    """MUMPS calls matrices 1 if they are known to be positive, 2 if just symmetric."""
    _, equilibrium, _ = pushed(times * CRITICAL)
    viewer = PETSc.Viewer().createASCII(str(tmp_path / "solver.txt"), comm=PETSc.COMM_SELF)
    viewer.pushFormat(PETSc.Viewer.Format.ASCII_INFO_DETAIL)
    equilibrium.linear.view(viewer)
    viewer.destroy()
    seen = (tmp_path / "solver.txt").read_text()
    assert re.findall(r"SYM \(matrix type\): *(\d)", seen) == [kind]
    equilibrium.destroy()


def test_prescribed_rows_count_as_positive() -> None:
    _, equilibrium, result = pushed(40 * CRITICAL)
    values, rows = tangent(equilibrium), held(equilibrium)
    free = np.setdiff1d(np.arange(len(values)), rows)
    assert (values[np.ix_(rows, rows)] == np.eye(len(rows))).all()
    assert not values[np.ix_(rows, free)].any()
    inside = np.linalg.eigvalsh(values[np.ix_(free, free)])
    assert result.negatives == (inside < 0).sum() > 1
    equilibrium.destroy()


def straight(model: Model, displacement: float) -> None:
    """Set the field of the sheet that is pushed and has not buckled."""
    scenes.set_field(model.field, lambda x: [-displacement * x[0] / 0.9, 0 * x[1]])


def critical() -> float:
    """Return the critical displacement of the coarse sheet (m), bisected."""
    low, high = 0.9 * CRITICAL, 1.1 * CRITICAL
    model, equilibrium, _ = pushed(0.0)
    while high - low > 1e-6 * CRITICAL:
        middle = (low + high) / 2
        straight(model, middle)
        equilibrium.spectrum._refactor()
        low, high = (low, middle) if equilibrium.spectrum._linear.negatives else (middle, high)
    equilibrium.destroy()
    return low


@pytest.mark.parametrize(
    ("start", "end"), [(0.5, 1.5), (0.999, 1.001)], ids=["formed far before", "nearly soft"]
)
def test_a_saddle_is_found_though_newtons_last_tangent_was_definite(
    start: float, end: float
) -> None:
    """The straight sheet is so nearly linear that one Newton step, from anywhere, is enough."""
    unit = critical()
    model, equilibrium, first = pushed(0.5 * unit)
    model.last.x.array[:] = model.field.x.array
    straight(model, start * unit)
    equilibrium.problem.constraints.set(end * unit)
    result = equilibrium.solve()
    assert (first.negatives, result.converged, result.iterations) == (0, True, 1)
    assert result.negatives == 1
    equilibrium.destroy()


@pytest.mark.parametrize("options", [{"pc_type": "lu"}, {"ksp_type": "gmres"}], ids=["LU", "GMRES"])
@pytest.mark.parametrize("times", [0.5, 40.0])
def test_other_linear_solvers_are_judged_by_a_factor_of_their_own(
    options: dict[str, str], times: float
) -> None:
    _, plain, expected = pushed(times * CRITICAL)
    _, other, result = pushed(times * CRITICAL, SolverOptions(options=options))
    assert other.spectrum._own is not None
    assert (result.converged, result.negatives) == (True, expected.negatives)
    plain.destroy()
    other.destroy()


@pytest.mark.parametrize("times", [0.5, 1.1, 40.0])
def test_the_mode_is_the_eigenvector_of_the_lowest_eigenvalue(times: float) -> None:
    _, equilibrium, _ = pushed(times * CRITICAL)
    values, rows = tangent(equilibrium), held(equilibrium)
    free = np.setdiff1d(np.arange(len(values)), rows)
    lowest, vectors = np.linalg.eigh(values[np.ix_(free, free)])
    mode = softest_mode(equilibrium)
    assert np.abs(mode).max() == pytest.approx(1.0)
    assert not mode[rows].any()
    part = mode[free] / np.linalg.norm(mode)
    assert part @ values[np.ix_(free, free)] @ part == pytest.approx(lowest[0], rel=1e-4)
    assert abs(part @ vectors[:, 0]) == pytest.approx(1.0, abs=1e-3)
    equilibrium.destroy()


@pytest.mark.parametrize("times", [0.5, 0.9])
def test_one_inverse_iteration_has_the_smallest_eigenvalue_to_a_thousandth(times: float) -> None:
    _, equilibrium, _ = pushed(times * CRITICAL)
    values, rows = tangent(equilibrium), held(equilibrium)
    free = np.setdiff1d(np.arange(len(values)), rows)
    lowest = np.linalg.eigvalsh(values[np.ix_(free, free)])[0]
    assert equilibrium.spectrum._value == pytest.approx(lowest, rel=1e-3)
    equilibrium.destroy()


def set_diagonal(matrix: PETSc.Mat, values: NDArray[np.float64]) -> None:
    """Let a matrix have these values on its diagonal, and zeros elsewhere."""
    matrix.zeroEntries()
    diagonal = matrix.getDiagonal()
    diagonal.array_w[:] = values
    matrix.setDiagonal(diagonal)
    matrix.assemble()
    diagonal.destroy()


def test_a_null_pivot_is_not_negative() -> None:
    _, equilibrium, _ = pushed(0.0)
    matrix, spectrum = equilibrium.tangent(), equilibrium.spectrum
    values = np.ones(matrix.size[0])
    values[[3, 7]], values[5] = 0.0, -1.0
    set_diagonal(matrix, values)
    spectrum._linear.renew()
    assert spectrum._linear.negatives == 1
    equilibrium.destroy()


def test_a_tangent_is_made_definite_though_the_first_shift_is_by_far_too_small() -> None:
    """The vector that is softest at first hides a negative eigenvalue of 1e12 times its own."""
    _, equilibrium, _ = pushed(0.0)
    matrix, spectrum = equilibrium.tangent(), equilibrium.spectrum
    values = np.ones(matrix.size[0])
    values[np.flatnonzero(spectrum._start.array_r)[[10, 20]]] = 1e-9, -1e3
    set_diagonal(matrix, values)
    spectrum._linear.renew()
    assert spectrum._linear.negatives == 1
    spectrum._make_definite()
    assert spectrum._linear.negatives == 0
    assert 1e3 < spectrum._shift < 4e3
    equilibrium.destroy()


def test_iterations_start_with_a_part_of_every_long_wave_and_little_else() -> None:
    """A long wave that lacked would be found late; the first iteration has to remove short ones."""
    model = scenes.model(scenes.sheet(mesh_size=0.03), scenes.BONDED, scenes.PROTOTYPE)
    x, y = np.pi * model.placements.positions.T / [[0.9], [0.3]]
    waves = [np.cos(k * x) * np.cos(m * y) for k in range(8) for m in range(3)]
    basis = np.linalg.qr(np.transpose(waves))[0]
    parts = []
    for seed in range(20):
        start = start_vector(model.placements, [], seed)
        parts.append((basis.T @ start.array_r.reshape(-1, 2)) ** 2)  # of a vector of length 1
        start.destroy()
    assert np.median(parts, axis=0).min() > 2e-4
    assert np.median(np.sum(parts, axis=(1, 2))) > 0.5


def test_the_step_that_is_made_to_descend_does_so_where_newtons_rises() -> None:
    model, equilibrium, result = pushed(1.5 * CRITICAL)
    assert result.negatives == 1
    mode = softest_mode(equilibrium)
    model.field.x.array[:] += 1e-6 * mode
    equilibrium.tangent()
    x, force, step = (equilibrium.newton.solution.duplicate() for _ in range(3))
    x.array_w[:] = model.field.x.array
    equilibrium.newton.evaluate_residual(None, x, force)
    equilibrium.spectrum._linear.renew()
    equilibrium.spectrum._linear.solve(force, step)
    assert force.dot(step) < 0  # x - step has a higher potential
    equilibrium.spectrum.shift(force, step)
    assert force.dot(step) > 0
    for vector in (x, force, step):
        vector.destroy()
    equilibrium.destroy()


def test_a_saddle_is_left_for_a_minimum_of_lower_potential_on_either_side() -> None:
    sides = []
    for sign in (1.0, -1.0):
        model, equilibrium, result = pushed(1.5 * CRITICAL, SolverOptions(descend=True))
        before, at = equilibrium.problem.energy(), model.field.x.array.copy()
        mode = softest_mode(equilibrium)
        result = leave_saddle(equilibrium, sign * mode)
        assert result.converged and result.negatives == 0
        assert equilibrium.problem.energy() < before
        sides.append((model.field.x.array - at) @ mode)
        equilibrium.destroy()
    assert sides[0] == pytest.approx(-sides[1], rel=1e-3)
    assert sides[0] > 0


def test_a_saddle_next_to_a_minimum_is_left_in_few_iterations() -> None:
    _, equilibrium, _ = pushed(1.001 * critical(), SolverOptions(descend=True))
    result = leave_saddle(equilibrium, softest_mode(equilibrium))
    assert result.converged and result.negatives == 0
    assert result.iterations <= 5  # it begins near the minimum, not a tenth of the sheet away
    equilibrium.destroy()


def test_tension_needs_no_more_factors_than_newton_in_the_whole_program(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All judgements are made on factors that Newton's method needed anyway."""
    made = []
    whole = TangentSpectrum._refactor
    monkeypatch.setattr(TangentSpectrum, "_refactor", lambda self: (made.append(1), whole(self))[1])
    model = scenes.model(scenes.sheet(), scenes.BONDED, scenes.PROTOTYPE)
    equilibrium = scenes.solver(model)
    constraints = equilibrium.problem.constraints
    for displacement in np.linspace(0.0, 0.1, 11)[1:]:
        model.last.x.array[:] = model.field.x.array
        constraints.set(displacement)
        assert equilibrium.solve().negatives == 0
    assert not made
    equilibrium.destroy()


def test_a_mode_that_becomes_the_softest_is_seen_though_it_lies_across_the_last_one() -> None:
    """The vector that is iterated has no part of it: another mode was softest for many steps."""
    _, equilibrium, _ = pushed(0.0)
    spectrum, matrix = equilibrium.spectrum, equilibrium.tangent()
    spectrum._assemble = lambda: None  # the matrix stays
    free = np.flatnonzero(spectrum._start.array_r)
    seen = []
    for soft, other, steps in ((1.0, 3.0, 40), (1.0, 0.3, 10)):
        values = np.full(matrix.size[0], 1e3)
        values[free[[10, 20]]] = soft, other
        for _ in range(steps):
            set_diagonal(matrix, values)
            spectrum._linear.renew()
            assert spectrum.judge(0.0) == 0
        seen.append(spectrum._value)
    assert seen == pytest.approx([1.0, 0.3], rel=0.02)
    equilibrium.destroy()


def test_a_mode_that_becomes_the_softest_is_seen_with_an_older_factor() -> None:
    _, equilibrium, _ = pushed(0.0)
    spectrum, matrix = equilibrium.spectrum, equilibrium.tangent()
    spectrum._assemble = lambda: None  # the matrix stays
    free = np.flatnonzero(spectrum._start.array_r)
    for waves, soft, other, steps in ((1.3, 1.0, 3.0, 40), (2.3, 1.0, 0.3, 10)):
        values = 1e3 * (1 + 0.9 * np.sin(waves * np.arange(matrix.size[0])))
        values[free[[10, 20]]] = soft, other
        for step in range(steps):
            set_diagonal(matrix, values)
            if other > soft and not step:
                spectrum._linear.renew()
            assert spectrum.judge(0.0) == 0
        assert spectrum._value == pytest.approx(min(soft, other), rel=0.02)
    equilibrium.destroy()
