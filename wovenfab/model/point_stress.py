"""Models whose friction stress is carried at quadrature points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import basix.ufl
import ufl
from dolfinx import fem

from forms.balance import Balance
from forms.effect import Term
from forms.point_friction import PointFriction, components_of
from wovenfab.model.compiler import compile_sums

if TYPE_CHECKING:
    from wovenfab.model.model import Model


def point_friction_of(term: Term, balance: Balance, mesh: Any, degree: int) -> PointFriction:
    """Return a bounded friction with its stress at the points of a quadrature rule."""
    element = basix.ufl.quadrature_element(
        mesh.basix_cell(),
        value_shape=(components_of(term, balance),),
        scheme="default",
        degree=degree,
    )
    space = fem.functionspace(mesh, element)
    return PointFriction(term, balance, fem.Function(space), fem.Function(space), degree)


def point_friction_forms(
    carried: Sequence[PointFriction], space: fem.FunctionSpace
) -> dict[str, list[Any]]:
    """Return what carried stresses add to a model, forms in UFL by its attributes' names.

    Args:
        carried: The frictions.
        space: Space of the placements.
    """
    trial, test = ufl.TrialFunction(space), ufl.TestFunction(space)
    return {
        "jacobian": [one.jacobian(trial, test) for one in carried],
        "push": [one.residual(test) for one in carried],
        "loss": [one.loss() for one in carried if one.term.effect.set_valued],
    }


def with_point_friction(model: Model) -> Model:
    """Return a model of the same fields that carries the stress of every bounded friction.

    Its discrete problem is the same: the smooth laws stand at the points where the forms
    of ``model`` have them.
    """
    terms = model.balance.terms
    balance = replace(model.balance, terms=tuple(t for t in terms if t.effect.bound is None))
    more = [
        point_friction_of(t, balance, model.sheet.mesh, balance.quadrature)
        for t in terms
        if t.effect.bound is not None
    ]
    trial, test = ufl.TrialFunction(model.space), ufl.TestFunction(model.space)
    last = model.last if model.numerics.mixed else None
    inside = {"jacobian": balance.jacobian(trial, test, last), "residual": balance.residual(test)}
    added = point_friction_forms(more, model.space)
    found = compile_sums({**added, **{f"inside {k}": [f] for k, f in inside.items()}}, model.comm)
    # The first form of each sum is of what is inside the sheet; those on lines stay.
    return replace(
        model,
        carried=(*model.carried, *more),
        jacobian=(*found["inside jacobian"], *model.jacobian[1:], *found["jacobian"]),
        residual=(*found["inside residual"], *model.residual[1:]),
        push=(*model.push, *found["push"]),
    )
