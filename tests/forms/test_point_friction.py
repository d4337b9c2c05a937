"""Friction with its stress as a coefficient: the tangent against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc

from tests import scenes
from wovenfab.model.assembly import assemble_vector
from wovenfab.model.model import Model, Numerics


def random_field(model: Model, seed: int, size: float) -> np.ndarray:
    random = np.random.default_rng(seed)
    return size * random.standard_normal(model.field.x.array.size)


@pytest.mark.parametrize("kind", ["slip_friction", "spin_friction"])
def test_the_tangent_is_the_derivative_of_the_force_of_a_law_of_the_increment(kind: str) -> None:
    """For tau = tau_0 + c b at each point, with any tau_0 and c."""
    values = {**scenes.TABLE_1, kind: {"strength": 1e3}}
    model = scenes.model(
        scenes.sheet(0.2, 0.1, 0.1), (*scenes.COUPLED, f"{kind}:coulomb"), Numerics(2), values
    )
    (one,) = model.friction_stresses
    model.history[0].x.array[:] = random_field(model, 1, 1e-3)
    start, way = random_field(model, 2, 1e-3), random_field(model, 3, 1.0)
    random = np.random.default_rng(4)
    first = random.standard_normal(one.stress.x.array.size)
    slope = random.uniform(1, 2, first.size)
    points = one.stress.function_space.element.interpolation_points
    increment = fem.Expression(one.increment(), points() if callable(points) else points)
    found = fem.Function(one.stress.function_space)

    def force(at: np.ndarray) -> np.ndarray:
        model.field.x.array[:] = at
        found.interpolate(increment)
        one.stress.x.array[:] = first + slope * found.x.array
        vector = model.field.x.petsc_vec.duplicate()
        assemble_vector(vector, model.friction_force)
        return vector.array_r.copy()

    force(start)
    one.tangent.x.array[:] = slope
    matrix = fem_petsc.assemble_matrix(model.jacobian[one.term.effect.name])
    matrix.assemble()
    x = model.field.x.petsc_vec.duplicate()
    x.array_w[:] = way[: x.getLocalSize()]
    y = x.duplicate()
    matrix.mult(x, y)
    errors = []
    for step in (1e-5, 5e-6):
        rise = (force(start + step * way) - force(start - step * way)) / (2 * step)
        errors.append(np.linalg.norm(rise - y.array_r) / np.linalg.norm(y.array_r))
    assert errors[1] < 1e-5
    assert errors[1] < errors[0] / 3 or errors[1] < 1e-9  # second order
    assert (matrix - matrix.copy().transpose()).norm() <= 1e-12 * matrix.norm()
