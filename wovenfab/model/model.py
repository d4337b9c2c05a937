"""The discrete model of a scene: its space, its fields, its symbols and compiled forms.

A second model of the same scene has the stress of bounded friction at quadrature points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import IntegralType
from mpi4py import MPI

from wovenfab.forms.balance import Balance, Rate
from wovenfab.forms.effect import Effect, OfShearAngle, Term
from wovenfab.forms.friction import components_of
from wovenfab.forms.kinematics import displacements, point_of, shear_angle
from wovenfab.forms.table import ForceTable
from wovenfab.model.assembly import SHEET, Sum, assemble_scalar, compile_sums
from wovenfab.model.constraints import Condition, DeadLoads, EdgeLoad, Grip, dead_loads_on
from wovenfab.model.friction_stress import FrictionStress
from wovenfab.model.memory import Memory, Variables, finest_rule, point_function
from wovenfab.model.spaces import Placements, crossed_facets, placements_on
from wovenfab.model.spline import pieces_of
from wovenfab.sheet.sheet import Sheet

#: A parameter: a number, a UFL expression such as a fem.Constant or fem.Function, a function of
#: the reference position (UFL in and out), or a table.
Value = Any
#: A further potential (J): a functional in UFL of the displacements of both families (m).
Potential = Callable[[tuple[Any, Any]], Any]
#: The name under which dead loads stand beside the effects in :attr:`Model.weights`.
LOAD = "dead load"


@dataclass(frozen=True)
class Numerics:
    """Choices of discretisation.

    Attributes:
        degree: Degree of the Lagrange elements, 1 to 5.
        quadrature: Quadrature degree; None for twice the element degree.
        penalty: sigma of the interior penalty; None for the automatic local value.
        history: Earlier states that rates may use: as many as the time scheme, or more.
        mixed: Use the mixed-integration-point tangent.
        friction: Quadrature degree of set-valued friction; None for the finest rule by which
            the stress of yarns that stick is unique.
    """

    degree: int = 3
    quadrature: int | None = None
    penalty: float | None = None
    history: int = 2
    mixed: bool = True
    friction: int | None = None


@dataclass(frozen=True)
class Model:
    """What a scene's effects, sheet and numerics have been compiled to.

    Attributes:
        sheet: The meshed sheet.
        effects: The effects of the scene.
        potentials: Names of the further potentials.
        grips: How edges are held.
        numerics: The discretisation.
        placements: The unknowns: one placement, or two that may jump.
        field: Present displacement, m.
        last: Displacement of the last iterate (mixed-integration-point tangent).
        history: Displacement at earlier times, latest first; empty without rates.
        rate_weights: Weights of the present and the earlier states in a rate, 1/s.
        stage: Where in a step equilibrium holds, as of the time scheme: 1 at its end.
        ahead: Change of the shear angle over that in the last step, for values that depend on it.
        friction: Factor of all friction: 1, or 0 for an initial state.
        geometric_weight: 1 for the tangent, 0 for its positive part (``wovenfab.forms.balance``).
        loading: The dead loads.
        balance: The symbolic balance.
        residual, jacobian, potential: Sums of compiled forms; the residual lacks the force
            of the friction stresses.
        power: Compiled form of the dissipated power; empty without a rate.
        weights: Constant that scales an effect's share in potential, power and loss.
        friction_stresses: Stresses of frictions that are variables at quadrature points.
        friction_force: Compiled forms of their force.
        loss: Compiled forms of the energy that is lost in a step and depends on no rate: by
            set-valued laws, and by stored energies whose internal variables change.
        memory: The internal variables; None without any.
        forms: The forms in UFL by the names of these attributes (``"residual"``) and of their
            parts. Those of a family live on its own space (``placements.families``), whose
            unknowns have the same numbers; with one placement all live on ``space``.
    """

    sheet: Sheet
    effects: tuple[Effect, ...]
    potentials: tuple[str, ...]
    grips: tuple[Grip, ...]
    numerics: Numerics
    placements: Placements
    field: fem.Function
    last: fem.Function
    history: tuple[fem.Function, ...]
    rate_weights: tuple[fem.Constant, ...]
    stage: fem.Constant
    ahead: fem.Constant
    friction: fem.Constant
    geometric_weight: fem.Constant
    loading: DeadLoads
    balance: Balance
    residual: Sum
    jacobian: Sum
    potential: Sum
    power: Sum
    friction_force: Sum
    loss: Sum
    weights: Mapping[str, fem.Constant]
    friction_stresses: tuple[FrictionStress, ...]
    memory: Memory | None
    forms: Mapping[str, Mapping[str, Any]]

    @property
    def comm(self) -> MPI.Comm:
        """Communicator of the mesh."""
        comm: MPI.Comm = self.sheet.mesh.comm
        return comm

    @property
    def space(self) -> fem.FunctionSpace:
        """Lagrange space of 2 components a placement."""
        return self.placements.space

    @property
    def unknowns(self) -> int:
        """Number of unknowns over all ranks."""
        return self.placements.unknowns

    @property
    def facet_integrals(self) -> int:
        """Number of compiled integrals over interior facets, all forms together."""
        forms = [f for s in (self.jacobian, self.residual, self.potential) for f in s.values()]
        kinds = [kind for form in forms for kind in form.integral_types]
        return kinds.count(IntegralType.interior_facet)

    def shares(self, forms: Sum, names: Sequence[str]) -> dict[str, float]:
        """Return each named effect's share of weighted scalar forms (J or W)."""
        result = {}
        with preserved(*self.weights.values()):
            for name in names:
                for other, weight in self.weights.items():
                    weight.value = 1.0 if other == name else 0.0
                result[name] = assemble_scalar(forms, self.comm)
        return result

    @property
    def storing(self) -> tuple[str, ...]:
        """Names of the effects that store energy, and of the further potentials."""
        return (*(e.name for e in self.effects if not e.dissipative), *self.potentials)

    @property
    def losing(self) -> tuple[str, ...]:
        """Names of the effects that lose energy."""
        return tuple(e.name for e in self.effects if e.loses)

    def stored_energy(self) -> dict[str, float]:
        """Return the stored energy (J) by effect."""
        return self.shares(self.potential, self.storing)

    def dissipated_power(self) -> dict[str, float]:
        """Return the dissipated power (W) of each effect that depends on a rate."""
        return self.shares(self.power, [e.name for e in self.effects if e.needs.rate])

    def dissipated_energy(self) -> dict[str, float]:
        """Return the energy (J) that each effect without a rate loses in the step."""
        lossy = [e.name for e in self.effects if e.loses and not e.needs.rate]
        return self.shares(self.loss, lossy)


@contextmanager
def preserved(*items: fem.Function | fem.Constant) -> Iterator[None]:
    """Restore fields (ghosts included) and constants at the end, also after an exception."""
    arrays = [item.value if isinstance(item, fem.Constant) else item.x.array for item in items]
    before = [array.copy() for array in arrays]
    try:
        yield
    finally:
        for array, values in zip(arrays, before, strict=True):
            array[...] = values


def build_model(
    sheet: Sheet,
    terms: Sequence[Term],
    conditions: Sequence[Condition] = (),
    numerics: Numerics | None = None,
    potentials: Mapping[str, Potential] | None = None,
) -> Model:
    """Build and compile the model of a scene; collective.

    Args:
        sheet: The meshed sheet.
        terms: Effects with their parameters, such as ``shear(400.0)``, each effect once.
        conditions: How edges are held, and dead loads on them.
        numerics: Discretisation.
        potentials: Further potentials by names that no effect has.

    Raises:
        ValueError: There is no effect, one twice, or an edge that the sheet has not got.
    """
    names = [*(t.effect.name for t in terms), *(potentials or {})]
    if not terms or len({*names, LOAD}) <= len(names):
        raise ValueError(f"a model has some effects and potentials, each once, not {names}")
    if unknown := [c.edge for c in conditions if c.edge not in sheet.edges]:
        raise ValueError(f"the sheet has no edge {unknown[0]!r}, but {', '.join(sheet.edges)}")
    numerics, effects = numerics or Numerics(), [t.effect for t in terms]
    grips = tuple(c for c in conditions if isinstance(c, Grip))
    rotations = [
        [g.edge for g in grips if g.rotation and family in g.families] for family in (0, 1)
    ]
    loads = [c for c in conditions if isinstance(c, EdgeLoad)]
    mesh = sheet.mesh
    count = max(e.needs.placements for e in effects)
    placements = placements_on(mesh, numerics.degree, count, sheet.jumps)
    space = placements.space
    field, last = fem.Function(space), fem.Function(space)
    remembered = any(e.needs.history for e in effects)
    follow = any(map(_follows_angle, terms))
    kept = max(numerics.history, 2 if follow else 1) if remembered or follow else 0
    history = tuple(fem.Function(space) for _ in range(kept))
    rate_weights = tuple(_constant(mesh, 1.0) for _ in range(kept + 1)) if kept else ()
    fibres = tuple(_constant(mesh, d) for d in sheet.fibres)
    load_weight, stage, ahead, friction, geometric_weight = (_constant(mesh, 1.0) for _ in range(5))
    angle = None
    if follow:
        latest, earlier = (_shear_angle(u, fibres) for u in history[:2])
        angle = ufl.variable(latest + ahead * (latest - earlier))
    terms = tuple(_symbolic(mesh, t, angle if _follows_angle(t) else None) for t in terms)
    quadrature = numerics.quadrature or 2 * numerics.degree
    degree = numerics.friction or finest_rule(numerics.degree)
    variables = {
        t.effect.name: Variables(mesh, t, degree if t.effect.set_valued else quadrature)
        for t in terms
        if t.effect.memory
    }
    terms = tuple(variables[n].term if (n := t.effect.name) in variables else t for t in terms)
    on_edges = partial(_measure, mesh, sheet)
    loading = dead_loads_on(space, loads, lambda edge: on_edges([edge]))
    further = {
        name: (_constant(mesh, 1.0), potential(displacements(field)))
        for name, potential in (potentials or {}).items()
    }
    balance = Balance(
        terms=tuple(t for t in terms if not t.effect.set_valued),
        fibres=fibres,
        field=field,
        rate=Rate(rate_weights, history, friction, stage) if kept else None,
        degree=numerics.degree,
        quadrature=quadrature,
        penalty=None if numerics.penalty is None else _constant(mesh, numerics.penalty),
        facets=(crossed_facets(mesh, sheet.fibres[0]), crossed_facets(mesh, sheet.fibres[1])),
        held_edges=(on_edges(rotations[0]), on_edges(rotations[1])),
        loads=loading.loads,
        load_weight=load_weight,
        geometric_weight=geometric_weight,
        potentials=tuple(further.values()),
    )
    memory = Memory(list(variables.values()), balance, stage) if variables else None
    frictions = tuple(
        friction_stress_of(t, balance, mesh, degree) for t in terms if t.effect.set_valued
    )
    sums = _sums_of(balance, placements, last if numerics.mixed else None, frictions)
    if memory:
        sums["loss"] |= {t.effect.name: memory.loss(t) for t in terms if t.effect.releases}
    return Model(
        sheet=sheet,
        effects=tuple(effects),
        potentials=tuple(further),
        grips=grips,
        numerics=numerics,
        placements=placements,
        field=field,
        last=last,
        history=history,
        rate_weights=rate_weights,
        stage=stage,
        ahead=ahead,
        friction=friction,
        geometric_weight=geometric_weight,
        loading=loading,
        balance=balance,
        weights={
            **{t.effect.name: t.weight for t in terms},
            **{name: weight for name, (weight, _) in further.items()},
            LOAD: load_weight,
        },
        friction_stresses=frictions,
        memory=memory,
        forms=sums,
        **compile_sums(sums, mesh.comm),
    )


def _sums_of(
    balance: Balance, placements: Placements, last: Any, frictions: Sequence[FrictionStress]
) -> dict[str, dict[str, Any]]:
    """Return the forms by the names of a model's attributes, and of their parts.

    Parts are what is inside the sheet, what is on lines that the yarns of a family cross, and
    each friction stress. The lines of both families have the same kernels where they are made
    alike.
    """
    trial, test = ufl.TrialFunction(placements.space), ufl.TestFunction(placements.space)
    power = balance.power()
    sums = {
        "jacobian": {SHEET: balance.jacobian(trial, test, last)},
        "residual": {SHEET: balance.residual(test)},
        "potential": {SHEET: balance.potential()},
        "power": {} if power is None else {SHEET: power},
    }
    for family, space in enumerate(placements.families):
        trial, test = ufl.TrialFunction(space), ufl.TestFunction(space)
        if lines := balance.lines(family, fem.Function(space, balance.field.x)):
            part = f"family {family + 1}"
            sums["jacobian"][part] = sum(line.jacobian(trial, test) for line in lines)
            sums["residual"][part] = sum(line.residual(test) for line in lines)
            sums["potential"][part] = sum(line.potential() for line in lines)
    more = friction_forms(frictions, placements.space)
    return {name: {**sums.get(name, {}), **more.get(name, {})} for name in {**sums, **more}}


def _constant(mesh: Any, value: Any) -> fem.Constant:
    return fem.Constant(mesh, np.asarray(value, dtype=np.float64))


def _measure(mesh: Any, sheet: Sheet, edges: Sequence[str]) -> Any | None:
    """Return the measure of the named edges, or None without any."""
    if not edges:
        return None
    tags = tuple(sheet.edges[name] for name in edges)
    return ufl.Measure("ds", domain=mesh, subdomain_data=sheet.facets, subdomain_id=tags)


def _follows_angle(term: Term) -> bool:
    return any(isinstance(value, OfShearAngle) for value in term.values.values())


def _shear_angle(field: fem.Function, fibres: Any) -> Any:
    """Return the shear angle (rad) of a displacement field."""
    return shear_angle(point_of(field, fibres, second_gradient=False).f, fibres)


def _symbol(mesh: Any, value: Value, angle: Any) -> Any:
    """Return a number or a table as a constant of the forms, or a field as its expression."""
    if isinstance(value, ForceTable):
        return _constant(mesh, pieces_of(value))
    if isinstance(value, ufl.core.expr.Expr):
        return value
    if isinstance(value, OfShearAngle):
        return ufl.as_ufl(value.function(ufl.SpatialCoordinate(mesh), angle))
    return value(ufl.SpatialCoordinate(mesh)) if callable(value) else _constant(mesh, value)


def _symbolic(mesh: Any, term: Term, angle: Any | None) -> Term:
    """Return a term with symbols as its values, and with a weight."""
    values = {
        name: tuple(_symbol(mesh, v, angle) for v in value)
        if isinstance(value, tuple)
        else _symbol(mesh, value, angle)
        for name, value in term.values.items()
    }
    return Term(term.effect, values, _constant(mesh, 1.0), angle)


def friction_stress_of(term: Term, balance: Balance, mesh: Any, degree: int) -> FrictionStress:
    """Return a bounded friction with its stress at the points of a quadrature rule."""
    size = components_of(term, balance)
    stress, tangent = (point_function(mesh, size, degree) for _ in range(2))
    return FrictionStress(term, balance, stress, tangent, degree)


def friction_forms(
    frictions: Sequence[FrictionStress], space: fem.FunctionSpace
) -> dict[str, dict[str, Any]]:
    """Return what friction stresses add to a model: forms in UFL by the model's attributes."""
    trial, test = ufl.TrialFunction(space), ufl.TestFunction(space)
    named = {f.term.effect.name: f for f in frictions}
    return {
        "jacobian": {name: f.jacobian(trial, test) for name, f in named.items()},
        "friction_force": {name: f.residual(test) for name, f in named.items()},
        "loss": {name: f.loss() for name, f in named.items() if f.term.effect.set_valued},
    }


def with_friction_stress(model: Model) -> Model:
    """Return a model of the same fields with the stress of every bounded friction at points.

    Its discrete problem is the same: the smooth laws stand at the points where the forms
    of ``model`` have them.
    """
    terms = model.balance.terms
    balance = replace(model.balance, terms=tuple(t for t in terms if t.effect.bound is None))
    more = [
        friction_stress_of(t, balance, model.sheet.mesh, balance.quadrature)
        for t in terms
        if t.effect.bound is not None
    ]
    trial, test = ufl.TrialFunction(model.space), ufl.TestFunction(model.space)
    last = model.last if model.numerics.mixed else None
    added = friction_forms(more, model.space)
    changed = {
        "jacobian": {SHEET: balance.jacobian(trial, test, last), **added["jacobian"]},
        "residual": {SHEET: balance.residual(test)},
        "friction_force": added["friction_force"],
    }
    compiled = compile_sums(changed, model.comm)
    sums: dict[str, Any] = {name: {**getattr(model, name), **compiled[name]} for name in changed}
    return replace(model, friction_stresses=(*model.friction_stresses, *more), **sums)
