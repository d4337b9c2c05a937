"""From a case to the sheet, model and simulation that it describes.

Numbers stay numbers, formulas become functions of the position.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from math import isfinite
from typing import Any

import ufl
from mpi4py import MPI

from wovenfab.case import (
    Case,
    CaseError,
    Component,
    EdgeCondition,
    Expression,
    Rectangle,
    SheetFile,
    conditions_of,
)
from wovenfab.case.checks import unfit_values
from wovenfab.case.effects import SceneEffect
from wovenfab.case.errors import dotted
from wovenfab.case.formula import SHEAR_ANGLE, VARIABLES, coefficients, with_change
from wovenfab.case.limits import require_memory, require_possible
from wovenfab.case.program import program_of_case
from wovenfab.case.resume import identity_of, state_of
from wovenfab.case.specimen import (
    Setup,
    bias_extension_of,
    mesh_shape,
    other_tests,
    setup_of,
    standard_test,
)
from wovenfab.forms.effect import OfShearAngle, Target, Term
from wovenfab.forms.table import TABLE
from wovenfab.model.constraints import Condition, EdgeLoad, Grip, Held
from wovenfab.model.model import Model, Numerics, build_model
from wovenfab.model.probes import extent, misplaced
from wovenfab.parallel import agree, compute_on_root
from wovenfab.record.output import Output
from wovenfab.sheet.aligned import BONDED, STICKING, Grading, aligned_sheet, grading_of
from wovenfab.sheet.geometry_file import (
    Geometry,
    GeometryFile,
    from_file,
    outline_from_file,
    read_geometry,
)
from wovenfab.sheet.gmsh_io import graded_rectangle
from wovenfab.sheet.msh import stated_points
from wovenfab.sheet.probes import Probe
from wovenfab.sheet.sheet import (
    GeometryError,
    Sheet,
    directions,
    quadrature_points,
    rectangle,
    rectangle_outline,
)
from wovenfab.simulation.simulation import Simulation
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.problem import OptionError, Problem, SolverOptions
from wovenfab.stepping.schemes import SCHEMES, Scheme
from wovenfab.stepping.sensitivity import TargetError
from wovenfab.stepping.stability import Treatment
from wovenfab.stepping.step import StepSizeControl

#: What the functions of a formula mean in UFL.
UFL_FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "sqrt": ufl.sqrt,
    "exp": ufl.exp,
    "log": ufl.ln,
    "sin": ufl.sin,
    "cos": ufl.cos,
    "tan": ufl.tan,
    "tanh": ufl.tanh,
    "abs": abs,
    "min": ufl.min_value,
    "max": ufl.max_value,
    "if": ufl.conditional,
    "<": ufl.lt,
    "<=": ufl.le,
    ">": ufl.gt,
    ">=": ufl.ge,
    "and": ufl.And,
    "or": ufl.Or,
}


def _for_model(value: Any) -> Any:
    """Return a number, or a UFL expression as a function of position and programs; so for pairs."""
    if isinstance(value, tuple):
        return tuple(map(_for_model, value))
    if not isinstance(value, Expression):
        return value
    if SHEAR_ANGLE in value.variables:
        return OfShearAngle(partial(_at_angle, value))
    return partial(_in_ufl, value)


def _values_for_model(e: SceneEffect) -> dict[str, Any]:
    """Return the values of an effect, its table among them."""
    table = {} if e.table is None else {TABLE: e.table}
    return {name: _for_model(value) for name, value in e.values.items()} | table


def held_of(component: Component) -> Held | None:
    """Return how a component is held, None where it is free."""
    if not component.held:
        return None
    if component.expression is not None:
        return Held(field=component.at, driven=component.moves)
    return Held(component.factor, component.offset)


def _in_ufl(
    formula: Expression, position: Any, program: Any = None, second: Any = None, angle: Any = None
) -> Any:
    given = position[0], position[1], program, second, angle
    known = dict(zip(VARIABLES, given, strict=True))
    return ufl.as_ufl(formula.evaluate(known, UFL_FUNCTIONS))


def _at_angle(formula: Expression, position: Any, angle: Any) -> Any:
    return _in_ufl(formula, position, angle=angle)


def in_case(target: Target, case: Case) -> Target:
    """Return a target that knows how a value changes with a coefficient of its formula.

    Raises:
        TargetError: If there is no such coefficient.
    """
    value = case.effects.get(target.effect, {}).get(target.parameter, 0.0)
    formula = value[target.families[0]] if isinstance(value, tuple) else value
    if not target.coefficient:
        return target
    if not isinstance(formula, Expression) or target.coefficient > len(coefficients(formula)):
        raise TargetError(f"{target} is no parameter of this scene: no formula has it")
    return replace(target, along=partial(_by_coefficient, formula, target.coefficient))


def _by_coefficient(formula: Expression, number: int, position: Any, angle: Any) -> Any:
    change = ufl.variable(ufl.as_ufl(0.0))
    changed = with_change(formula, number)
    return ufl.diff(_in_ufl(changed, position, program=change, angle=angle), change)


def sheet_of(case: Case, comm: MPI.Comm) -> Sheet:
    """Return the meshed sheet of a case; collective.

    Raises:
        CaseError: If the geometry cannot be meshed or lacks an edge that the case names, or
            :func:`require_possible` says so.
    """
    require_possible(case, comm)
    with geometry_problems(case):
        sheet = _aligned(case, comm) if follows_fibres(case) else _as_given(case, comm)
    require_edges(case, sheet.edges)
    if case.figures and (others := list(other_tests(case.figures, _setup_of(case, sheet)))):
        raise CaseError([case.problem(dotted(path), *rest) for path, *rest in others])
    faults = [(f"output.probes.{n}", what) for n, what in misplaced(sheet, probes_of(case))]
    if faults:
        x, y = (f"{a:g} to {b:g} m" for a, b in extent(sheet))
        where = f"Positions are those at rest; the sheet has x from {x} and y from {y}."
        raise CaseError([case.problem(key, what, where) for key, what in faults])
    return sheet


def coarse_geometry(case: Case, comm: MPI.Comm) -> Geometry | None:
    """Return what the file of a sheet gives, with few cells; None for a rectangle; collective.

    Raises:
        CaseError: As from :func:`sheet_of`.
    """
    if isinstance(case.sheet, Rectangle):
        return None
    file, size = geometry_of(case.sheet), case.discretisation.mesh_size
    with geometry_problems(case):
        geometry = compute_on_root(comm, lambda: read_geometry(file, size, True, coarse=True))
    require_edges(case, {c.name for c in geometry.curves if c.outside and c.name is not None})
    return geometry


def estimated_unknowns(case: Case, geometry: Geometry | None, comm: MPI.Comm) -> int:
    """Return about how many unknowns there would be, without a mesh of that size; collective.

    Of a mesh in a file only the head is read; one that does not say its size there counts as none.

    Args:
        case: The case.
        geometry: Of :func:`coarse_geometry`; not needed for a rectangle and for a mesh in a file.
        comm: The ranks.

    Raises:
        CaseError: As from :func:`sheet_of`.
    """
    require_possible(case, comm)
    size = case.discretisation.mesh_size
    if isinstance(case.sheet, Rectangle):
        assert size is not None  # a case that has been read has one
        points = 2 * case.sheet.length * case.sheet.width / size**2
    elif case.sheet.file.suffix.lower() == ".msh":
        path = case.sheet.file
        points = compute_on_root(comm, lambda: stated_points(path))
    else:
        assert geometry is not None
        points = 2 * geometry.outline.polygon.area / (size or geometry.longest_side) ** 2
    return round(2 * points * case.discretisation.degree**2 * case.needs.placements)


@contextmanager
def geometry_problems(case: Case) -> Iterator[None]:
    """Turn what is wrong with a geometry into a problem of the case that names it."""
    try:
        yield
    except GeometryError as error:
        raise CaseError([case.problem(f"sheet.{error.key}", str(error))]) from error


def require_edges(case: Case, known: Collection[str]) -> None:
    """Refuse a case that names an edge that the sheet has not got.

    Raises:
        CaseError: With the edges that there are.
    """
    if missing := [name for name in case.boundary if name not in known]:
        remedy = f"It has {', '.join(sorted(known))}."
        key, message = f"boundary.{missing[0]}", f"the sheet has no edge {missing[0]!r}"
        raise CaseError([case.problem(key, message, remedy)])


def follows_fibres(case: Case) -> bool:
    """Return whether the mesh of a case is made along its fibres."""
    mesh = case.discretisation.mesh
    if isinstance(case.sheet, Rectangle):
        return mesh == "fibres"
    return mesh in ("fibres", None) and case.sheet.file.suffix.lower() != ".msh"


def geometry_of(sheet: SheetFile) -> GeometryFile:
    """Return the file of a sheet with what the case says of it."""
    named = sheet.edges or {}
    return GeometryFile(sheet.file, sheet.length_unit, sheet.file_parameters, named)


def _as_given(case: Case, comm: MPI.Comm) -> Sheet:
    """Return the sheet with a structured mesh or one by gmsh."""
    d = case.discretisation
    if isinstance(case.sheet, Rectangle):
        length, width = case.sheet.length, case.sheet.width
        assert d.mesh_size is not None  # a case that has been read has one
        if d.mesh == "unstructured":
            parts = graded_rectangle(comm, length, width, d.mesh_size, d.corner_size)
        else:
            parts = rectangle(comm, length, width, d.mesh_size, d.mesh or "crossed")
    else:
        parts = from_file(comm, geometry_of(case.sheet), d.mesh_size)
    return Sheet(*parts, directions(case.sheet.fibres))


def _aligned(case: Case, comm: MPI.Comm) -> Sheet:
    """Return the sheet with a mesh along the fibres."""
    d = case.discretisation
    if isinstance(case.sheet, Rectangle):
        outline = rectangle_outline(case.sheet.length, case.sheet.width)
        size = d.mesh_size
    else:
        outline, size = outline_from_file(comm, geometry_of(case.sheet), d.mesh_size)
    assert size is not None
    return aligned_sheet(
        comm,
        outline,
        directions(case.sheet.fibres),
        (_holds(case, 1), _holds(case, 2)),
        size,
        _grading(case, size),
        jumps=d.jumps is not False,
    )


def _grading(case: Case, size: float) -> Grading | None:
    """Return how the mesh of a case shrinks from a size towards what makes strain steep."""
    d, is_bonded = case.discretisation, case.needs.placements == 1
    if d.corner_size:
        return grading_of(size, d.corner_size)
    if not (is_bonded if d.graded is None else d.graded):
        return None
    return BONDED if is_bonded else STICKING


def _holds(case: Case, family: int) -> dict[str, str]:
    """Return the edges that hold a family in any way; each its own way."""
    return {
        name: name
        for name, _, edge in conditions_of(case.boundary)
        if family in edge.families and (edge.rotation or any(c.held for c in edge.components))
    }


def model_of(case: Case, sheet: Sheet) -> Model:
    """Return the compiled model of a case on a sheet; collective.

    Raises:
        CaseError: If a user's own effect cannot be compiled, on every rank.
    """
    d = case.discretisation
    terms = [Term(e.effect, _values_for_model(e)) for e in case.scene]
    numerics = Numerics(
        degree=d.degree,
        quadrature=None if d.quadrature_degree == "auto" else d.quadrature_degree,
        penalty=None if d.penalty == "auto" else d.penalty,
        history=scheme_of(case).memory,
        mixed=case.solver.tangent == "mixed",
    )
    with _custom_effect_errors(case):
        return build_model(sheet, terms, list(_conditions(case)), numerics)


def _conditions(case: Case) -> Iterator[Condition]:
    for name, _, edge in conditions_of(case.boundary):
        families = _families_of(edge)
        x, y = map(held_of, edge.components)
        yield Grip(name, (x, y), families, edge.rotation)
        if edge.force is not None:
            fx, fy = map(_for_model, edge.force)
            yield EdgeLoad(name, families, (fx, fy))


def require_values(case: Case, model: Model) -> None:
    """Check formulas where integrals use them, and energies at rest; collective.

    Raises:
        CaseError: On every rank, with the place or the effect.
    """
    found: CaseError | None = None
    given = [v for e in case.scene for v in e.values.values()]
    values = [v for one in given for v in (one if isinstance(one, tuple) else (one,))]
    if any(isinstance(v, Expression) for v in values):
        x, y = quadrature_points(model.sheet.mesh, model.balance.quadrature).T
        if x.size and (problems := list(unfit_values(case.scene, x, y))):
            found = CaseError([case.problem(dotted(path), *rest) for path, *rest in problems])
    agree(model.comm, found)
    if names := [name for name, e in model.stored_energy().items() if not isfinite(e)]:
        message = f"the energy of the sheet at rest is not a number: {', '.join(names)}"
        remedy = "It must be finite without deformation, with finite derivatives."
        raise CaseError([case.problem("effects", message, remedy)])


def _families_of(edge: EdgeCondition) -> tuple[int, ...]:
    """Return the families that a condition is for, counted from 0."""
    return tuple(family - 1 for family in edge.families)


def options_of(case: Case) -> SolverOptions:
    """Return how a case has equilibrium sought."""
    s = case.solver
    return SolverOptions(
        s.max_iterations,
        s.tolerance,
        s.petsc,
        keep_factor=s.factor == "kept",
        descend=s.stability == "follow",
        seed=s.seed,
    )


def probes_of(case: Case) -> dict[str, Probe]:
    """Return the probes of a case by name."""
    return {name: probe.probe for name, probe in case.output.probes.items()}


def _setup_of(case: Case, sheet: Sheet) -> Setup:
    """Return what makes a case one test or another; collective."""
    shape = mesh_shape(sheet, tuple(case.boundary))
    return setup_of(shape, case.sheet.fibres, case.boundary, case.program, case.output)


def output_of(case: Case, sheet: Sheet) -> Output:
    """Return what a case writes; collective."""
    o = case.output
    return Output(
        fields=o.fields,
        every=o.every,
        probes=probes_of(case),
        checkpoint=o.checkpoint,
        texts={"case.yaml": case.to_yaml()},
        identity=identity_of(case),
        specimen=bias_extension_of(case),
        tests=tuple(standard_test(name, _setup_of(case, sheet)) for name in case.figures),
    )


def simulation_of(
    case: Case,
    sheet: Sheet,
    stability: Treatment | None = None,
    options: SolverOptions | None = None,
    solver: type[EquilibriumSolver] = EquilibriumSolver,
    step_size: Callable[[float], StepSizeControl] = StepSizeControl,
    model: Model | None = None,
    resumes: bool = False,
) -> Simulation:
    """Return the simulation of a case on its sheet; collective.

    Args:
        case: The validated case.
        sheet: Its meshed sheet.
        stability: What is done where stability is lost, if not what the case says.
        options: Of the solver, if not those of the case.
        solver: Another solver, for comparison.
        step_size: Another step size control, for comparison.
        model: The compiled model of a case that differs in program and steps only; its state
            is lost, for stepping begins at that of reference.
        resumes: It will go on from a checkpoint, not from the state that the case starts from.

    Raises:
        CaseError: If an effect cannot be compiled or has no value, PETSc cannot use an option,
            or there is no state to start from.
    """
    if model is None:
        model = model_of(case, sheet)
        require_memory(case, model.unknowns, model.comm)
        require_values(case, model)
    starts = case.from_state is not None and not resumes
    start = state_of(case, model) if starts else None  # before there are solvers to destroy
    try:
        simulation = Simulation(
            Problem(model),
            program_of_case(case),
            case.time.scheme,
            stability=stability or case.solver.stability,
            options=options or options_of(case),
            smallest_step=case.time.smallest_step,
            tolerance=case.time.tolerance,
            extrapolate=case.solver.predictor == "quadratic",
            output=output_of(case, sheet),
            solver=solver,
            step_size=step_size,
        )
    except OptionError as error:
        remedy = "They stand in solver.petsc, after -- on the command line or in PETSC_OPTIONS."
        raise CaseError([case.problem("solver.petsc", str(error), remedy)]) from error
    if start is not None:
        simulation.start_at(start)
    return simulation


def differentiate(
    simulation: Simulation, case: Case, targets: Sequence[Target], dissipation: bool = True
) -> None:
    """Give each step of the simulation of a case its derivatives by parameters; collective.

    Raises:
        CaseError: If the program prescribes a force.
        TargetError: If the scene has no such parameter.
    """
    if simulation.program.changes:
        message = "derivatives by parameters are not available where a force is prescribed"
        raise CaseError([case.problem("program", message, "Prescribe displacements.")])
    simulation.differentiate([in_case(target, case) for target in targets], dissipation)


def scheme_of(case: Case) -> Scheme:
    """Return the time scheme of a case."""
    return SCHEMES[case.time.scheme]


def _custom_effect_errors(case: Case) -> AbstractContextManager[None]:
    """Return a context that reports failures as those of the user's own effects."""
    if not any(effect.file for effect in case.scene):
        return nullcontext()
    from wovenfab.case.custom_effects import custom_effect_errors

    return custom_effect_errors(case.scene)
