"""Manufactured solutions: the orders that theory promises, for P2, P3 and P4.

The body force is the strong form's, b = -dp + ddm along each fibre with p and m the
derivatives of the density by f and g; it knows nothing of the facet terms, so a wrong
sign or scale in them would show as a lost order.
"""

from __future__ import annotations

from collections.abc import Callable
from math import pi

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx.mesh import exterior_facet_indices
from petsc4py import PETSc

from tests import scenes
from wovenfab.forms.kinematics import (
    along,
    as_variables,
    curvature_vector,
    displacements,
    point_of,
    stretch,
    twice_along,
)
from wovenfab.model.assembly import compile_form
from wovenfab.model.model import Model, Numerics

VALUES = {
    "stretch": {"stiffness": (3.0, 2.0)},
    "shear": {"stiffness": 1.5},
    "bending": {"stiffness": (0.02, 0.03)},
    "coupling": {"stiffness": 4.0},
}
Measure = Callable[[Model], np.ndarray]


def exact(x: object, components: int) -> object:
    """Return a smooth, finite displacement with rotations, stretches and curvature."""
    a = 0.08 * ufl.sin(pi * x[0]) * ufl.cos(pi * x[1])
    b = 0.06 * ufl.cos(pi * x[0]) * ufl.sin(0.5 * pi * x[1])
    c = 0.05 * ufl.sin(0.5 * pi * (x[0] + x[1]))
    return ufl.as_vector((a, b) if components == 2 else (a, b, c, -a))


def load(model: Model, u: object, test: object) -> object:
    """Return the work of body force and edge moment m (D·n) that keep ``u``, held, in balance."""
    fibres = model.balance.fibres
    point = as_variables(point_of(u, fibres, True))
    energy = sum(t.effect.stored(point, t.values) for t in model.balance.terms)
    p = [ufl.diff(energy, f) for f in point.f]
    m = [ufl.diff(energy, g) for g in point.g]
    rule = {"quadrature_degree": model.balance.quadrature + 4}
    normal = ufl.FacetNormal(model.sheet.mesh)
    form = 0
    for a, v in enumerate(displacements(test)):
        d = fibres[a]
        force = -along(d, p[a]) + twice_along(d, m[a])
        if point.slip is not None:
            force = force + (1 if a == 0 else -1) * ufl.diff(energy, point.slip)
        form += ufl.dot(force, v) * ufl.dx(metadata=rule)
        form += ufl.dot(d, normal) * ufl.dot(m[a], along(d, v)) * ufl.ds(metadata=rule)
    return form


def solve(model: Model) -> None:
    """Solve for the manufactured load with the exact values held on the boundary."""
    mesh, space = model.sheet.mesh, model.space
    u = exact(ufl.SpatialCoordinate(mesh), space.value_shape[0])
    held = fem.Function(space)
    points = space.element.interpolation_points
    held.interpolate(fem.Expression(u, points() if callable(points) else points))
    mesh.topology.create_connectivity(1, 2)
    edge = exterior_facet_indices(mesh.topology)
    families = range(model.placements.count)
    blocks = np.sort(np.concatenate([model.placements.on_facets(edge, a) for a in families]))
    bcs = [fem.dirichletbc(fem.Function(s, held.x), blocks) for s in model.placements.spaces]
    force = fem_petsc.assemble_vector(compile_form(load(model, u, ufl.TestFunction(space))))
    model.field.x.array[:] = held.x.array
    solver = PETSc.KSP().create(mesh.comm)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    residual, change = force.duplicate(), force.duplicate()
    for _ in range(20):
        model.last.x.array[:] = model.field.x.array
        residual.array_w[:] = scenes.internal_force(model) - force.array_r
        fem_petsc.set_bc(residual, bcs, model.field.x.petsc_vec, -1.0)
        size = residual.norm()
        solver.setOperators(scenes.tangent(model, bcs))
        solver.solve(residual, change)
        model.field.x.petsc_vec.axpy(-1.0, change)
        if size < 1e-9:
            break
    assert size < 1e-9


def norms(model: Model) -> np.ndarray:
    """Return the errors in the L2, H1 and broken H2 norm."""
    e = model.field - exact(ufl.SpatialCoordinate(model.sheet.mesh), 2)
    return np.sqrt(np.cumsum(squares(model, [e, ufl.grad(e), ufl.grad(ufl.grad(e))])))


def strain_errors(model: Model) -> np.ndarray:
    """Return the L2 errors of the placements, the stretches and the curvatures."""
    u, fibres = exact(ufl.SpatialCoordinate(model.sheet.mesh), 4), model.balance.fibres
    solved, true = (point_of(w, fibres, True) for w in (model.field, u))
    curvatures, true_ones = (
        ufl.as_vector([c for fg in zip(p.f, p.g, strict=True) for c in curvature_vector(*fg)])
        for p in (solved, true)
    )
    stretches = [stretch(a) - stretch(b) for a, b in zip(solved.f, true.f, strict=True)]
    parts = [model.field - u, ufl.as_vector(stretches), curvatures - true_ones]
    return np.sqrt(squares(model, parts))


def squares(model: Model, errors: list) -> list[float]:
    """Return the integrals of the squares of errors."""
    rule = ufl.dx(metadata={"quadrature_degree": 2 * model.balance.degree + 4})
    forms = [compile_form(ufl.inner(error, error) * rule) for error in errors]
    return [fem.assemble_scalar(form) for form in forms]


@pytest.mark.parametrize(
    ("names", "measure", "degree", "theory"),
    [
        # A fourth-order problem: p + 1 in L2 (2 for P2, where duality gives no more), p, p - 1
        (scenes.BONDED, norms, 2, (2, 2, 1)),
        pytest.param(scenes.BONDED, norms, 3, (4, 3, 2), marks=pytest.mark.slow),
        pytest.param(scenes.BONDED, norms, 4, (5, 4, 3), marks=pytest.mark.slow),
        # No energy across a placement's own fibres, hence no duality: p - 1 for all together
        (scenes.COUPLED, strain_errors, 2, (1, 1, 1)),
        pytest.param(scenes.COUPLED, strain_errors, 3, (2, 2, 2), marks=pytest.mark.slow),
        pytest.param(scenes.COUPLED, strain_errors, 4, (3, 3, 3), marks=pytest.mark.slow),
    ],
)
def test_errors_fall_with_the_orders_of_the_theory(
    names: tuple[str, ...], measure: Measure, degree: int, theory: tuple[int, ...]
) -> None:
    """In L2, H1 and broken H2 of one placement; in L2, stretch and curvature of two."""
    errors = []
    for cells in (8, 16):
        sheet = scenes.sheet(1.0, 1.0, 1 / cells, "right", fibres=(0.5, 0.5 + pi / 2))
        model = scenes.model(sheet, names, Numerics(degree), VALUES)
        solve(model)
        errors.append(measure(model))
    orders = scenes.orders(errors)[-1]
    print(f"\nP{degree}: observed {np.round(orders, 2)}, theory {theory}")
    assert (orders > np.array(theory) - 0.25).all()
