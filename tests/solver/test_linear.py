"""The factor of an earlier tangent solves with later ones, and only where it may."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from petsc4py import PETSc

from tests import scenes
from wovenfab.solver.linear import SPACE, TOO_SMALL, LinearSolver, create_direct
from wovenfab.solver.problem import SolverOptions
from wovenfab.stepping.program import cycle, program_of, ramp
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.state import State
from wovenfab.stepping.step import Step

SIZE = 60
RENEW = LinearSolver._renew


def laplacian(shift: float = 0.0, held: float = 1.0) -> Any:
    """Return a tridiagonal matrix with the first unknown prescribed, of the upper half alone."""
    matrix = PETSc.Mat().createSBAIJ(SIZE, 1, nnz=2, comm=PETSc.COMM_SELF)
    for i in range(SIZE):
        matrix.setValue(i, i, held if i == 0 else 2.0 + shift)
        if 0 < i < SIZE - 1:
            matrix.setValue(i, i + 1, -1.0)
    matrix.assemble()
    return matrix


def test_a_factorisation_whose_workspace_is_too_small_is_made_with_more() -> None:
    # On several ranks MUMPS's estimate may be too low; here a part of it is taken away.
    size = 60
    matrix = PETSc.Mat().createSBAIJ(size**2, 1, nnz=3, comm=PETSc.COMM_SELF)
    for i in range(size**2):
        matrix.setValue(i, i, 4.0)
        if (i + 1) % size:
            matrix.setValue(i, i + 1, -1.0)
        if i + size < size**2:
            matrix.setValue(i, i + size, -1.0)
    matrix.assemble()
    linear = LinearSolver(create_direct(matrix.comm), matrix)
    linear.workspace_percent = -90
    solution, b = matrix.createVecs()
    solution.set(1.0)
    matrix.mult(solution, b)
    assert linear.solve(b, solution) > 0
    own = 20  # by which MUMPS exceeds its estimate anyway, %
    assert 2 * own <= linear.workspace_percent <= 4 * own
    assert linear.factor.getMumpsIcntl(SPACE) == linear.workspace_percent
    np.testing.assert_allclose(solution.array, 1.0, rtol=1e-12)
    for thing in (linear, matrix, solution, b):
        thing.destroy()


def test_a_factorisation_that_no_workspace_is_enough_for_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(LinearSolver, "status", TOO_SMALL[0])
    matrix = laplacian()
    linear = LinearSolver(create_direct(matrix.comm), matrix)
    solution, b = matrix.createVecs()
    linear.solve(b, solution)
    assert 1000 <= linear.workspace_percent < 2000  # some ten times the memory
    for thing in (linear, matrix, solution, b):
        thing.destroy()


class Counting(LinearSolver):
    """Counts its factorisations."""

    made = 0

    def _renew(self) -> None:
        self.made += 1
        super()._renew()


@pytest.fixture
def factor() -> Iterator[Counting]:
    """Yield a factor of the matrix, used once, for which a factorisation is never cheap."""
    matrix = laplacian(0.5)
    factor = Counting(create_direct(matrix.comm), matrix, keep=True)
    b, x = matrix.createVecs()
    b.set(1.0)
    assert factor.solve(b, x) > 0
    factor._cost = factor._spent = 100.0
    b.destroy()
    x.destroy()
    yield factor
    factor.destroy()
    matrix.destroy()


def dense(shift: float) -> Any:
    """Return the matrix of ``laplacian``, whole."""
    full = np.diag(np.full(SIZE, 2.0 + shift)) - np.eye(SIZE, k=1) - np.eye(SIZE, k=-1)
    full[0], full[:, 0], full[0, 0] = 0.0, 0.0, 1.0
    return full


def solve(factor: LinearSolver, shift: float) -> tuple[Any, Any]:
    """Give the factor's matrix another diagonal; return the solution and the exact one."""
    matrix = factor._matrix
    fresh = laplacian(shift)
    fresh.copy(matrix, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
    fresh.destroy()
    b, x = matrix.createVecs()
    b.array_w[:] = np.random.default_rng(1).standard_normal(SIZE)
    assert factor.solve(b, x) > 0
    found, exact = np.array(x.array_r), np.linalg.solve(dense(shift), b.array_r)
    b.destroy()
    x.destroy()
    return found, exact


def test_an_earlier_factor_solves_as_well_as_its_own(factor: Counting) -> None:
    found, exact = solve(factor, 0.6)
    assert factor.made == 1
    assert not factor.is_present
    assert found == pytest.approx(exact, rel=1e-6)
    assert found[0] == exact[0]  # prescribed: not even a rounding error


def test_a_matrix_that_is_not_definite_gets_its_own_factor(factor: Counting) -> None:
    found, exact = solve(factor, -0.5)
    assert factor.made == 2
    assert factor.negatives > 0
    assert found == pytest.approx(exact, rel=1e-9)
    solve(factor, 0.5)  # nor is that factor one for gradients
    assert factor.made == 3


@pytest.mark.parametrize("shift", [-0.5, -1.9, -1.999, -2.05, -3.9])
def test_negative_eigenvalues_are_counted_though_definite_matrices_came_first(shift: float) -> None:
    matrix = laplacian(0.5)
    factor = Counting(create_direct(matrix.comm), matrix)
    solve(factor, 0.5)
    assert factor.negatives == 0
    for diagonal in (shift, 0.5, shift):  # some have pivots of nothing on their diagonal
        found, exact = solve(factor, diagonal)
        assert factor.negatives == np.count_nonzero(np.linalg.eigvalsh(dense(diagonal)) < 0)
        assert found == pytest.approx(exact, rel=1e-9)
    factor.destroy()
    matrix.destroy()


def test_a_factor_too_old_is_made_anew_and_not_tried_at_once_again(factor: Counting) -> None:
    factor._cost = 3.0
    for shift, made in ((1e4, 2), (0.0, 3)):
        found, exact = solve(factor, shift)
        assert factor.made == made
        assert found == pytest.approx(exact, rel=1e-9)
    factor._cost = factor._spent = 100.0
    solve(factor, 0.01)
    assert factor.made == 3


def test_it_is_made_anew_when_the_next_system_would_cost_more_than_the_average(
    factor: Counting,
) -> None:
    factor._solved, factor._last = 4, 26
    factor._spent = 4 * 26.0
    solve(factor, 0.51)
    assert factor.made == 1
    factor._solved, factor._last = 4, 26
    factor._spent = 4 * 26.0 - 1
    solve(factor, 0.52)
    assert factor.made == 2


def test_a_factor_is_not_kept_where_that_is_not_asked_for() -> None:
    matrix = laplacian(0.5)
    factor = Counting(create_direct(matrix.comm), matrix, keep=False)
    for made, shift in enumerate((0.5, 0.6, 0.7), start=1):
        solve(factor, shift)
        assert factor.made == made
    factor.destroy()
    matrix.destroy()


def marched() -> tuple[list[Step], list[Step], int]:
    """Return a cycle of slip friction, the same with its own factors, and factorisations saved."""
    names = (*scenes.COUPLED, "slip_friction")
    model = scenes.model(scenes.sheet(), names, scenes.PROTOTYPE_TWO_STEPS)
    program = program_of(cycle(0.0, 0.04, 0.25, 40))
    made = []
    marches = []
    for keep in (True, False):
        count = [0]

        def counting(self: LinearSolver, count: list[int] = count) -> None:
            count[0] += 1
            RENEW(self)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(LinearSolver, "_renew", counting)
            patch.setattr("wovenfab.solver.linear.OPERATIONS_PER_USE", 4.0)  # as of a large sheet
            marches.append(
                scenes.march(model, program, "bdf2", options=SolverOptions(keep_factor=keep))
            )
        made.append(count[0])
    return *marches, made[1] - made[0]


def test_a_march_with_kept_factors_is_the_same_and_saves_most_factorisations() -> None:
    kept, own, saved = marched()
    assert saved > 0.6 * sum(s.iterations for s in own)
    peak = max(abs(s.reactions["right"][0]) for s in own)
    for found, expected in zip(kept, own, strict=True):
        assert found.reactions["right"] == pytest.approx(
            expected.reactions["right"], abs=1e-8 * peak
        )
        assert found.negatives == expected.negatives == 0
    loss = "slip_friction"
    assert kept[-1].dissipated[loss] == pytest.approx(own[-1].dissipated[loss], rel=1e-8)


def test_inexact_solutions_with_kept_factors_cost_hardly_an_iteration() -> None:
    kept, own, saved = marched()
    more = np.array([k.iterations - s.iterations for k, s in zip(kept, own, strict=True)])
    print(f"\n{more.sum()} iterations more than {sum(s.iterations for s in own)}")
    assert saved > 0.6 * sum(s.iterations for s in own)
    assert set(more) <= {0, 1}
    assert more.sum() < 0.05 * sum(s.iterations for s in own)


def test_a_loss_of_stability_is_found_where_it_is_with_kept_factors() -> None:
    """Steps begin at the last state; an extrapolated one would need no iteration at all."""
    model = scenes.model(scenes.sheet(fibres=scenes.ALONG), scenes.BONDED, scenes.PROTOTYPE)
    program = program_of([ramp(0.0, 1e-4, 1.0, 64)])
    where, refined = [], []
    refine = LinearSolver._refine

    def counting(self: LinearSolver, b: Any, x: Any, accuracy: float) -> bool:
        refined.append(accuracy)
        return refine(self, b, x, accuracy)

    for keep in (False, True):
        assert not refined
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(LinearSolver, "_refine", counting)
            patch.setattr("wovenfab.solver.linear.OPERATIONS_PER_USE", 4.0)
            patch.setattr(State, "_extrapolate", lambda *_: False)
            with pytest.raises(StabilityLostError) as error:
                scenes.march(
                    model, program, grips=scenes.PUSH, options=SolverOptions(keep_factor=keep),
                    smallest_step=1 / 1024,
                )  # fmt: skip
        loss = error.value.loss
        where.append(loss.time)
        assert loss.negatives == 1
    assert len(refined) > 5  # else the way there would be the same without
    assert where[0] == pytest.approx(where[1], rel=1e-3)
