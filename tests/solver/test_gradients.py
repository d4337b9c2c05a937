"""Conjugate gradients are as accurate as asked without an application that only tells so."""

from __future__ import annotations

from collections.abc import Iterator
from math import sqrt
from typing import Any

import numpy as np
import pytest
from petsc4py import PETSc

from wovenfab.solver.linear import ConjugateGradients

SIZE, MOST = 200, 40


def chain(stiffness: np.ndarray, support: float) -> Any:
    """Return the matrix of springs (N/m) in a row, each of their ends supported (N/m)."""
    matrix = PETSc.Mat().createAIJ((SIZE, SIZE), nnz=3, comm=PETSc.COMM_SELF)
    for i in range(SIZE):
        matrix.setValue(i, i, stiffness[i] + stiffness[i + 1] + support)
        if i:
            matrix.setValue(i, i - 1, -stiffness[i])
            matrix.setValue(i - 1, i, -stiffness[i])
    matrix.assemble()
    return matrix


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(3)


@pytest.fixture
def earlier() -> Iterator[Any]:
    """Yield the factor of a chain."""
    matrix = chain(np.ones(SIZE + 1), 0.1)
    pc = PETSc.PC().create(matrix.comm)
    pc.setType("cholesky")
    pc.setOperators(matrix)
    pc.setUp()
    yield pc
    pc.destroy()
    matrix.destroy()


def applications_of_petsc(matrix: Any, pc: Any, b: Any, accuracy: float) -> int:
    """Return how often PETSc's gradients apply it, which measure their error each time."""
    x, rest = b.duplicate(), b.duplicate()
    pc.apply(b, x)
    energy = b.dot(x)
    matrix.mult(x, rest)
    rest.aypx(-1.0, b)
    shell = PETSc.KSP().create(matrix.comm)
    shell.setType("cg")
    shell.setNormType(PETSc.KSP.NormType.NATURAL)
    pc.setReusePreconditioner(True)
    shell.setPC(pc)
    shell.setOperators(matrix, pc.getOperators()[1])
    shell.setTolerances(0.0, accuracy * sqrt(energy))
    shell.solve(rest, x)
    number = 2 + shell.getIterationNumber()
    for item in (x, rest, shell):
        item.destroy()
    return number


@pytest.mark.parametrize("accuracy", [1e-2, 3e-5, 1e-8])
def test_they_are_accurate_and_save_an_application(
    accuracy: float, earlier: Any, random: np.random.Generator
) -> None:
    matrix = chain(random.uniform(0.8, 1.3, SIZE + 1), 0.15)
    solver = ConjugateGradients(matrix, earlier)
    b, x = matrix.createVecs()
    errors, saved = [], []
    for _ in range(20):
        b.array_w[:] = random.standard_normal(SIZE)
        done, applied = solver.solve(b, x, accuracy, MOST)
        assert done
        dense = matrix[:, :]
        wrong = x.array_r - np.linalg.solve(dense, b.array_r)
        errors.append(sqrt(wrong @ dense @ wrong / b.dot(x)) / accuracy)
        saved.append(applications_of_petsc(matrix, earlier, b, accuracy) - applied)
    print(f"\nerrors over what is asked: {max(errors):.2f} at most; {np.mean(saved):.2f} saved")
    assert max(errors) < 2.0
    assert min(saved) >= 0
    assert np.mean(saved) > 0.9
    solver.destroy()
    for item in (matrix, b, x):
        item.destroy()


@pytest.mark.parametrize(("support", "most"), [(-0.5, MOST), (30.0, 1), (np.nan, MOST)])
def test_they_tell_where_they_fail(
    support: float, most: int, earlier: Any, random: np.random.Generator
) -> None:
    matrix = chain(np.ones(SIZE + 1), support)
    solver = ConjugateGradients(matrix, earlier)
    b, x = matrix.createVecs()
    b.array_w[:] = random.standard_normal(SIZE)
    done, applied = solver.solve(b, x, 1e-8, most)
    assert not done
    assert applied <= most + 1
    solver.destroy()
    for item in (matrix, b, x):
        item.destroy()
