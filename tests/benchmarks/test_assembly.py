"""The sums of forms and their matrix against the one form that they stand for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc

from benchmarks.assembly import plain_tangent
from tests import scenes
from wovenfab.model.assembly import assemble_matrix, create_matrix, jit_options
from wovenfab.model.model import Numerics


@pytest.mark.slow
def test_the_tangent_is_that_of_the_plainly_differentiated_energy(tmp_path: Path) -> None:
    model = scenes.model(scenes.sheet(mesh_size=0.15), scenes.COUPLED, Numerics(2, mixed=False))
    random = np.random.default_rng(7)
    model.field.x.array[:] = 1e-3 * random.standard_normal(model.field.x.array.size)
    written_by_ffcx = jit_options() | {"cache_dir": str(tmp_path)}
    plain = fem_petsc.assemble_matrix(fem.form(plain_tangent(model), jit_options=written_by_ffcx))
    plain.assemble()
    direction, expected = plain.createVecs()
    direction.array_w[:] = random.standard_normal(direction.local_size)
    plain.mult(direction, expected)
    for upper in (False, True):
        matrix = create_matrix(model.jacobian, upper)
        assemble_matrix(matrix, model.jacobian)
        product = expected.duplicate()
        matrix.mult(direction, product)
        scale = np.abs(expected.array_r).max()
        assert product.array_r == pytest.approx(expected.array_r, abs=1e-11 * scale)
        assert matrix.getInfo()["nz_used"] <= plain.getInfo()["nz_used"]
        for item in (matrix, product):
            item.destroy()
    for item in (plain, direction, expected):
        item.destroy()
