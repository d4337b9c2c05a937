"""The model of a scene: its symbols, and the forms compiled from them.

A second model of the same scene has the stress of bounded friction at quadrature points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem

from forms.balance import Balance, Rate
from forms.effect import Effect, Term
from forms.point_friction import PointFriction, components_of
from wovenfab.model.assembly import crossed_facets
from wovenfab.model.compiler import compile_sums
from wovenfab.model.constraints import EdgeLoad, dead_loads_on
from wovenfab.model.model import LOAD, Model, Numerics, Value
from wovenfab.model.spaces import Placements, placements_on
from wovenfab.sheet.sheet import Sheet


def build_model(
    sheet: Sheet,
    effects: Sequence[Effect],
    values: Mapping[str, Mapping[str, Value | tuple[Value, Value]]],
    numerics: Numerics,
    rotation_edges: tuple[Sequence[str], Sequence[str]] = ((), ()),
    loads: Sequence[EdgeLoad] = (),
) -> Model:
    """Build and compile the model of a scene.

    Args:
        sheet: The meshed sheet.
        effects: Effects of the scene.
        values: Parameter values in SI units by effect and parameter name.
        numerics: Discretisation.
        rotation_edges: For each family, the edges that hold its yarn directions.
        loads: Dead loads on edges.
    """
    mesh = sheet.mesh
    count = max(e.needs.placements for e in effects)
    placements = placements_on(mesh, numerics.degree, count, sheet.jumps)
    space = placements.space
    field, last = fem.Function(space), fem.Function(space)
    remembered = any(e.needs.history for e in effects)
    kept = numerics.history if remembered else 0
    history = tuple(fem.Function(space) for _ in range(kept))
    rate_weights = tuple(_constant(mesh, 1.0) for _ in range(kept + 1)) if kept else ()
    terms = tuple(Term(e, _symbols(mesh, values[e.name]), _constant(mesh, 1.0)) for e in effects)
    on_edges = partial(_measure, mesh, sheet)
    load_weight, friction, geometric_weight = (_constant(mesh, 1.0) for _ in range(3))
    loading = dead_loads_on(space, loads, lambda edge: on_edges([edge]))
    balance = Balance(
        terms=tuple(t for t in terms if not t.effect.set_valued),
        fibres=tuple(_constant(mesh, d) for d in sheet.fibres),
        field=field,
        rate=Rate(rate_weights, history, friction) if kept else None,
        degree=numerics.degree,
        quadrature=numerics.quadrature or 2 * numerics.degree,
        penalty=None if numerics.penalty is None else _constant(mesh, numerics.penalty),
        facets=(crossed_facets(mesh, sheet.fibres[0]), crossed_facets(mesh, sheet.fibres[1])),
        held_edges=(on_edges(rotation_edges[0]), on_edges(rotation_edges[1])),
        loads=loading.loads,
        load_weight=load_weight,
        geometric_weight=geometric_weight,
    )
    degree = numerics.friction or max(numerics.degree - 1, 1)
    frictions = tuple(
        point_friction_of(t, balance, mesh, degree) for t in terms if t.effect.set_valued
    )
    sums = _sums_of(balance, placements, last if numerics.mixed else None, frictions)
    return Model(
        sheet=sheet,
        effects=tuple(effects),
        numerics=numerics,
        placements=placements,
        field=field,
        last=last,
        history=history,
        rate_weights=rate_weights,
        friction=friction,
        geometric_weight=geometric_weight,
        loading=loading,
        balance=balance,
        weights={**{t.effect.name: t.weight for t in terms}, LOAD: load_weight},
        point_frictions=frictions,
        **compile_sums(sums, mesh.comm),
    )


def _sums_of(
    balance: Balance, placements: Placements, last: Any, frictions: Sequence[PointFriction]
) -> dict[str, list[Any]]:
    """Return the forms by the names of a model's attributes: inside the sheet, on its lines.

    The lines of both families have the same kernels where they are made alike.
    """
    trial, test = ufl.TrialFunction(placements.space), ufl.TestFunction(placements.space)
    power = balance.power()
    sums = {
        "jacobian": [balance.jacobian(trial, test, last)],
        "residual": [balance.residual(test)],
        "potential": [balance.potential()],
        "power": [] if power is None else [power],
    }
    for family, space in enumerate(placements.families):
        trial, test = ufl.TrialFunction(space), ufl.TestFunction(space)
        if lines := balance.lines(family, fem.Function(space, balance.field.x)):
            sums["jacobian"].append(sum(line.jacobian(trial, test) for line in lines))
            sums["residual"].append(sum(line.residual(test) for line in lines))
            sums["potential"].append(sum(line.potential() for line in lines))
    more = point_friction_forms(frictions, placements.space)
    return {name: [*sums.get(name, ()), *more.get(name, ())] for name in {**sums, **more}}


def _constant(mesh: Any, value: Any) -> fem.Constant:
    return fem.Constant(mesh, np.asarray(value, dtype=np.float64))


def _measure(mesh: Any, sheet: Sheet, edges: Sequence[str]) -> Any | None:
    """Return the measure of the named edges, or None without any."""
    if not edges:
        return None
    tags = tuple(sheet.edges[name] for name in edges)
    return ufl.Measure("ds", domain=mesh, subdomain_data=sheet.facets, subdomain_id=tags)


def _symbol(mesh: Any, value: Value) -> Any:
    """Return a number as a constant of the forms, or a field as its expression."""
    return value(ufl.SpatialCoordinate(mesh)) if callable(value) else _constant(mesh, value)


def _symbols(mesh: Any, values: Mapping[str, Value | tuple[Value, Value]]) -> dict[str, Any]:
    return {
        name: tuple(_symbol(mesh, v) for v in value)
        if isinstance(value, tuple)
        else _symbol(mesh, value)
        for name, value in values.items()
    }


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
    frictions: Sequence[PointFriction], space: fem.FunctionSpace
) -> dict[str, list[Any]]:
    """Return what point frictions add to a model: forms in UFL by the model's attributes."""
    trial, test = ufl.TrialFunction(space), ufl.TestFunction(space)
    return {
        "jacobian": [f.jacobian(trial, test) for f in frictions],
        "friction_force": [f.residual(test) for f in frictions],
        "loss": [f.loss() for f in frictions if f.term.effect.set_valued],
    }


def with_point_friction(model: Model) -> Model:
    """Return a model of the same fields with the stress of every bounded friction at points.

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
    compiled = compile_sums(
        {**added, **{f"inside {k}": [f] for k, f in inside.items()}}, model.comm
    )
    # The first form of each sum is of what is inside the sheet; those on lines stay.
    return replace(
        model,
        point_frictions=(*model.point_frictions, *more),
        jacobian=(*compiled["inside jacobian"], *model.jacobian[1:], *compiled["jacobian"]),
        residual=(*compiled["inside residual"], *model.residual[1:]),
        friction_force=(*model.friction_force, *compiled["friction_force"]),
    )
