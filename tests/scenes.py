"""Small scenes that many tests share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from math import pi
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import ArrayLike, NDArray
from petsc4py import PETSc

from wovenfab.forms import effects
from wovenfab.forms.balance import Balance, FacetTerm
from wovenfab.forms.effect import Effect, Term
from wovenfab.forms.kinematics import Facet
from wovenfab.model.assembly import assemble_matrix, assemble_scalar, assemble_vector, create_matrix
from wovenfab.model.constraints import EdgeLoad, Grip, Held
from wovenfab.model.model import Model, Numerics, build_model
from wovenfab.sheet.sheet import Sheet, directions, rectangle
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.problem import Problem, SolverOptions
from wovenfab.stepping.program import Program
from wovenfab.stepping.schemes import SCHEMES
from wovenfab.stepping.stability import StabilityLostError, Treatment
from wovenfab.stepping.step import Step, StepFailedError
from wovenfab.stepping.time_stepper import TimeStepper

#: Table 1 of the paper, with the spin friction of its figure 7 (left).
TABLE_1 = {
    "stretch": {"stiffness": (1.27e8, 1.27e8)},
    "shear": {"stiffness": 400.0},
    "bending": {"stiffness": (254.1, 254.1)},
    "coupling": {"stiffness": 6.0e7},
    "slip_friction": {"strength": 199.2e3, "slope": 70.0},
    "spin_friction": {"strength": 30.0, "slope": 40.0},
}
BONDED = ("stretch", "shear", "bending")
COUPLED = (*BONDED, "coupling")
CLAMP = (Held(), Held())
#: Pushed by a positive program, and fibres that run from grip to grip.
PUSH = (Grip("left", CLAMP), Grip("right", (Held(-1.0), Held())))
ALONG = (0.0, pi / 2)
PULL = (Grip("left", CLAMP), Grip("right", (Held(1.0), Held())))
BIAS = (pi / 4, -pi / 4)
#: Discretisation of the prototype; tests that need nothing else share its kernels.
PROTOTYPE = Numerics(2, quadrature=4, penalty=10.0)
#: The same with the memory of the schemes of second order.
PROTOTYPE_TWO_STEPS = replace(PROTOTYPE, history=2)


def sheet(
    length: float = 0.9,
    width: float = 0.3,
    mesh_size: float = 0.15,
    pattern: str = "crossed",
    fibres: tuple[float, float] = BIAS,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Sheet:
    """Return a structured rectangle."""
    mesh, facets, edges = rectangle(comm, length, width, mesh_size, pattern)
    return Sheet(mesh, facets, edges, directions(fibres))


def model(
    on: Sheet,
    names: Sequence[str],
    numerics: Numerics | None = None,
    values: Mapping[str, Mapping[str, Any]] = TABLE_1,
    rotation_edges: Sequence[str] = (),
    loads: Sequence[EdgeLoad] = (),
) -> Model:
    """Return the compiled model of the named effects; edges hold both families' rotation.

    A law of an effect is named after a colon: ``"slip_friction:coulomb"``.
    """
    terms = [Term(one, values[one.name]) for one in map(effect, names)]
    held = [Grip(edge, rotation=True) for edge in rotation_edges]
    return build_model(on, terms, [*held, *loads], numerics or Numerics(2))


def effect(name: str) -> Effect:
    """Return an effect of the catalogue, or the law of one."""
    name, _, law = name.partition(":")
    return next(e for e in effects()[name].all_laws if law in (e.law, ""))


def solver(
    of: Model, grips: Sequence[Grip] = PULL, options: SolverOptions | None = None
) -> EquilibriumSolver:
    """Return the solver of a model."""
    return EquilibriumSolver(Problem(replace(of, grips=tuple(grips))), options or SolverOptions())


def force(
    of: Model, grips: Sequence[Grip], displacement: float, options: SolverOptions | None = None
) -> dict[str, tuple[float, float]]:
    """Return the reactions (N) after one elastic step from rest."""
    equilibrium = solver(of, grips, options)
    constraints = equilibrium.problem.constraints
    constraints.set(displacement)
    result = equilibrium.solve()
    assert result.converged, result
    reactions = constraints.reactions(equilibrium.problem.force)
    equilibrium.destroy()
    return reactions


def march(
    of: Model,
    program: Program,
    scheme: str = "backward-euler",
    grips: Sequence[Grip] = PULL,
    options: SolverOptions | None = None,
    smallest_step: float = 1 / 64,
) -> list[Step]:
    """Return all steps of a run from rest, which must not fail."""
    result = run(of, program, options, smallest_step, scheme, grips)
    if result.failure:
        raise result.failure
    return result.steps


def energy(of: Model) -> float:
    """Return the incremental potential (J) of the present field."""
    return assemble_scalar(of.potential, of.comm)


def internal_force(of: Model) -> NDArray[np.float64]:
    """Return the residual (N) before boundary conditions at the rank's own unknowns."""
    vector = of.field.x.petsc_vec.duplicate()
    assemble_vector(vector, of.residual)
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    return vector.array_r.copy()


def tangent(of: Model, bcs: Sequence[fem.DirichletBC] = ()) -> PETSc.Mat:
    """Return the tangent of the present field as a new matrix."""
    matrix = create_matrix(of.jacobian)
    assemble_matrix(matrix, of.jacobian, bcs)
    return matrix


def set_field(function: fem.Function, displacement: object) -> None:
    """Interpolate the same displacement (x -> (2, n)) into every placement."""
    size = function.function_space.value_shape[0] // 2
    function.interpolate(lambda x: np.vstack([displacement(x)] * size))  # type: ignore[operator]


def swap_sides(monkeypatch: pytest.MonkeyPatch) -> None:
    """Swap the sides of all facets in models that are built from now on."""
    lines = Balance.lines

    def reorder(f_plus: object, f_minus: object, g_plus: object, g_minus: object) -> list:
        return [f_minus, f_plus, g_minus, g_plus]

    def swap(line: FacetTerm) -> FacetTerm:
        other = replace(line.place, along=-line.place.along)
        other = other.with_measures(reorder(*line.place.measures))
        return replace(line, place=other, vary=lambda v: reorder(*line.vary(v)))

    def swapped(self: Balance, *of: object) -> list[FacetTerm]:
        return [swap(line) if isinstance(line.place, Facet) else line for line in lines(self, *of)]

    monkeypatch.setattr(Balance, "lines", swapped)


def spoil_residuals(monkeypatch: pytest.MonkeyPatch, calls: range, where: object) -> None:
    """Let the numbered assemblies of the residual give NaN at some unknowns."""
    number = count()

    def assemble(b: PETSc.Vec, *more: object) -> object:
        result = assemble_vector(b, *more)
        if next(number) in calls:
            b.array_w[where] = np.nan
        return result

    monkeypatch.setattr("wovenfab.solver.problem.assemble_vector", assemble)


@dataclass(frozen=True)
class Run:
    """Steps from rest.

    Attributes:
        steps: All accepted steps.
        fields: The unknowns after each.
        failure: What ended them before their time.
    """

    steps: list[Step]
    fields: list[NDArray[np.float64]]
    failure: StepFailedError | StabilityLostError | None


def run(
    of: Model,
    program: Program,
    options: SolverOptions | None = None,
    smallest_step: float = 1 / 64,
    scheme: str = "backward-euler",
    grips: Sequence[Grip] = PULL,
    **stepping: Any,
) -> Run:
    """Run a program from rest to its end or failure; the model's field is left there."""
    of.field.x.array[:] = 0
    equilibrium = solver(of, grips, options)
    stepper = TimeStepper(equilibrium, program, SCHEMES[scheme], smallest_step, **stepping)
    steps, fields, failure = [], [], None
    try:
        for step in stepper.steps():
            steps.append(step)
            fields.append(of.field.x.array.copy())
    except (StepFailedError, StabilityLostError) as error:
        failure = error
    equilibrium.destroy()
    return Run(steps, fields, failure)


def push(
    of: Model,
    program: Program,
    treatment: Treatment,
    smallest_step: float = 1 / 1024,
    scheme: str = "backward-euler",
    grips: Sequence[Grip] = PUSH,
    seed: int = 0,
) -> Run:
    """Run a program that may lose stability."""
    options = SolverOptions(descend=treatment == "follow", seed=seed)
    return run(of, program, options, smallest_step, scheme, grips, treatment=treatment)


def pull(of: Model, displacement: float) -> float:
    """Return the force (N) at the right grip after one elastic step from rest."""
    return force(of, PULL, displacement)["right"][0]


def forces(steps: Sequence[Step]) -> NDArray[np.float64]:
    """Return the force (N) on the right grip of each step."""
    return np.array([s.reactions["right"][0] for s in steps])


def stored(step: Step) -> float:
    """Return the stored energy (J) of a step."""
    return sum(step.stored.values())


def lost(step: Step) -> float:
    """Return the energy (J) dissipated until a step."""
    return sum(step.dissipated.values())


def imbalance(step: Step) -> float:
    """Return work less stored and dissipated energy (J)."""
    return step.work - stored(step) - lost(step)


def orders(errors: ArrayLike) -> NDArray[np.float64]:
    """Return the orders of convergence of errors, each of half the size before."""
    sizes = np.abs(errors)
    return np.log2(sizes[:-1] / sizes[1:])
