"""Why an equilibrium was not found: the worst point, the probable cause and a remedy."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from wovenfab.compat import corners_of
from wovenfab.model.assembly import compile_expression
from wovenfab.model.fields import FieldProbe
from wovenfab.model.model import Model
from wovenfab.sheet.narrow import flattest_cell
from wovenfab.solver.equilibrium import EquilibriumSolver
from wovenfab.solver.linear import COUNT_NULL, NEGATIVE, NULL, create_direct
from wovenfab.solver.problem import SolveResult

Array = NDArray[np.float64]
#: Sine of the angle between the families below which a sheet counts as locked (6°).
LOCKED = 0.1
#: Shift over the largest diagonal entry, for a null vector: above pivots that count as null.
NULL_SHIFT = 1e-12


def proven_penalty(model: Model) -> float:
    """Return the smallest ``discretisation.penalty`` proven stable on a mesh; collective.

    A user's sigma/h has the mean of |T|/|F| for h; on every facet it must reach the
    value 3 p(p-1)/8 h_F (1/|T+| + 1/|T-|), and 3 p(p-1)/2 h_F/|T| on an edge that holds
    yarn directions, of the trace inequality (Bringmann, Carstensen, Streitberger 2023).
    """
    mesh, degree = model.sheet.mesh, model.balance.degree
    mesh.topology.create_connectivity(1, 2)
    cells_of = mesh.topology.connectivity(1, 2)
    areas = _areas(mesh)
    factor = 3 * degree * (degree - 1) / 8
    edges = factor * 4 if any(model.balance.held_edges) else 0.0
    ratios = [
        (areas[a] + areas[b]) ** 2 / (2 * areas[a] * areas[b])
        for a, b in (
            cells_of.links(f)
            for f in range(mesh.topology.index_map(1).size_local)
            if len(cells_of.links(f)) == 2
        )
    ]
    mine = max(factor * max(ratios, default=0.0), edges)
    return float(mesh.comm.allreduce(mine, op=MPI.MAX))


def _areas(mesh: Any) -> NDArray[np.float64]:
    """Return the areas (m^2) of this rank's cells, ghosts included."""
    a, b, c = (mesh.geometry.x[corners_of(mesh)[:, i], :2] for i in range(3))
    (x, y), (u, v) = (b - a).T, (c - a).T
    return np.asarray(np.abs(x * v - y * u) / 2)


@dataclass(frozen=True)
class Location:
    """A quadrature point, of a cell or on its edges, in the last equilibrium.

    Attributes:
        x, y: Position at rest, m.
        shear: Shear angle, rad.
        stretches: Stretch of each family.
        slip: Distance of the families, m; None with one placement.
        margin: (f_1 × f_2)/(|f_1||f_2|), the sine of the angle between the families.
    """

    x: float
    y: float
    shear: float
    stretches: tuple[float, float]
    slip: float | None
    margin: float

    def __str__(self) -> str:
        """Say where it is and how the sheet is deformed there."""
        slip = "" if self.slip is None else f", slip {1e3 * self.slip:.3g} mm"
        first, second = (f"{100 * s:.3g} %" for s in self.stretches)
        return (
            f"x = {1e3 * self.x:.4g} mm, y = {1e3 * self.y:.4g} mm (at rest), where the last "
            f"equilibrium has shear angle {degrees(self.shear):.3g}°, stretches {first} and "
            f"{second}{slip}"
        )


@dataclass(frozen=True)
class Diagnosis:
    """What is known of a failure.

    Attributes:
        cause: Probable cause, in plain words.
        remedy: What to change.
        place: The worst point.
    """

    cause: str
    remedy: str
    place: Location

    def __str__(self) -> str:
        """Say all of it."""
        return f"Probable cause: {self.cause}. Worst point: {self.place}. Remedy: {self.remedy}"


def diagnose(solver: EquilibriumSolver, result: SolveResult, before: Array) -> Diagnosis:
    """Return what is known of a failed solve; collective.

    Args:
        solver: The solver as the failure left it. The field of its problem is the failed
            iterate; it is left with the last equilibrium.
        result: How it ended.
        before: The last equilibrium (all unknowns of this rank, ghosts included), m.
    """
    model, crossing = solver.problem.model, solver.crossing
    comm = model.comm
    if broken := _not_numbers(solver):
        names, scores = broken
        model.field.x.array[:] = before
        cause = f"the energy of {names} is not a number there"
        remedy = "take smaller steps, or mend the formula or the effect"
        return Diagnosis(cause, remedy, _place(solver, scores))
    motion = np.nan_to_num(crossing.motion(solver.newton.step))
    model.field.x.array[:] = before
    margins = crossing.margins()
    tangent = solver.tangent()
    negatives, nulls = pivots_of(tangent)
    if nulls:
        loose = _by_cell(model, np.abs(null_vector(tangent)))
        cause = "the stiffness is singular: something moves there and no effect resists it"
        remedy = "hold more edges, or add an effect that resists, such as shear"
        return Diagnosis(cause, remedy, _place(solver, _spread(loose, motion)))
    least = float(comm.allreduce(float(margins.min(initial=np.inf)), op=MPI.MIN))
    cause, remedy = _named(solver, result, negatives, least)
    if (cell := flattest_cell(model.sheet.mesh)).is_too_flat:
        cause += f", or rounding errors: {cell}"
        remedy += ", or remove the narrow place from the geometry ('wovenfab check' names it)"
    return Diagnosis(cause, remedy, _place(solver, -margins if least < LOCKED else motion))


def unsound_penalty(solver: EquilibriumSolver) -> Diagnosis | None:
    """Return what is wrong with a user's penalty if it makes the sheet unstable at rest.

    All energies are convex at rest, so that only the facet terms can make the tangent
    indefinite there: the bending energy is then not bounded from below, and equilibria,
    if they are found at all, mean nothing.

    Args:
        solver: After a solve that began at the reference state, which the field of its problem
            is again.
    """
    model = solver.problem.model
    given = model.balance.penalty
    if given is None or not solver.saddle_at_start:
        return None
    if not model.balance.second_gradient or float(given.value) >= proven_penalty(model):
        return None
    cause, remedy = _too_small(model, float(given.value))
    return Diagnosis(cause, remedy, _place(solver, solver.crossing.motion(solver.newton.step)))


def _named(
    solver: EquilibriumSolver, result: SolveResult, negatives: int, least: float
) -> tuple[str, str]:
    """Return cause and remedy of a failure that leaves numbers and a regular tangent."""
    model = solver.problem.model
    if result.reason == "DIVERGED_LINEAR_SOLVE":
        status = solver.linear.status
        return (
            f"the factorisation failed{f' (status {status} of MUMPS)' if status else ''} though "
            "the stiffness is regular, as for want of memory",
            "free memory, use more ranks or a coarser mesh, or take options out of solver.petsc",
        )
    needed = proven_penalty(model)
    given = model.balance.penalty
    if given is not None and negatives and float(given.value) < needed:
        return _too_small(model, float(given.value))
    if least < LOCKED:
        return (
            "the sheet locks: the yarns of the two families all but align there",
            "end the program earlier, or refine the mesh if the sheet should not be locked yet",
        )
    if negatives:
        return (
            f"the last equilibrium is not stable ({negatives} ways to fall off it), as of a "
            "sheet that buckles",
            "push less, or hold or stiffen what gives way",
        )
    return (
        f"the step is too large: Newton's method has not settled (iterations: {result.iterations})",
        "plan more steps, or raise solver.max_iterations or lower time.smallest_step",
    )


def _too_small(model: Model, given: float) -> tuple[str, str]:
    needed = proven_penalty(model)
    return (
        f"discretisation.penalty = {given:g} is too small: jumps of "
        "the yarn directions release more bending energy than they cost",
        f"use penalty: auto, or {needed:.3g} or more on this mesh",
    )


def _not_numbers(solver: EquilibriumSolver) -> tuple[str, Array] | None:
    """Return which effects give no number in the present state, and a score of where."""
    model = solver.problem.model
    points, comm = solver.crossing.points, model.comm
    cells = np.arange(model.sheet.mesh.topology.index_map(2).size_local, dtype=np.int32)
    forces = _by_cell(model, (~np.isfinite(solver.problem.force)).astype(float))
    scores = np.repeat(forces[:, None], len(points), axis=1)
    if not comm.allreduce(bool(scores.any()), op=MPI.LOR):
        return None
    names = []
    for name, density in model.balance.densities().items():
        values = compile_expression(density, points).eval(model.sheet.mesh, cells)
        wrong = ~np.isfinite(values.reshape(scores.shape))
        if comm.allreduce(bool(wrong.any()), op=MPI.LOR):
            names.append(name)
        scores = scores + wrong
    return " and ".join(names) or "an effect", scores


def _by_cell(model: Model, values: Array) -> Array:
    """Return for each own cell the largest of the values at its unknowns."""
    places = model.placements
    own = np.zeros(len(model.field.x.array))
    own[: len(values)] = values
    count = model.sheet.mesh.topology.index_map(2).size_local
    by_block = own.reshape(-1, 2).max(axis=1)
    return np.asarray(by_block[places.blocks[:count].reshape(count, -1)].max(axis=1))


def pivots_of(matrix: Any) -> tuple[int, int]:
    """Return the numbers of negative and of null pivots of a symmetric matrix; collective."""
    direct = _factorised(matrix)
    factor = direct.getPC().getFactorMatrix()
    negatives, nulls = (int(factor.getMumpsInfog(i)) for i in (NEGATIVE, NULL))
    direct.destroy()
    return negatives, nulls


def null_vector(matrix: Any) -> Array:
    """Return a direction that a singular matrix does not resist; collective.

    One inverse iteration finds it: by so small a shift all others have no part in it.

    Args:
        matrix: Symmetric; it is left with a tiny shift.

    Returns:
        At this rank's own unknowns, of length one over all.
    """
    diagonal = matrix.getDiagonal()
    matrix.shift(NULL_SHIFT * (diagonal.norm(PETSc.NormType.INFINITY) or 1.0))
    direct, (vector, image) = _factorised(matrix), matrix.createVecs()
    vector.set(1.0)
    direct.solve(vector, image)
    image.scale(1 / (image.norm() or 1.0))
    values = np.array(image.array_r)
    for item in (direct, vector, image, diagonal):
        item.destroy()
    return values


def _factorised(matrix: Any) -> Any:
    """Return a direct solver that counts null pivots; a user's options are not for this one."""
    direct = create_direct(matrix.comm, "pivots_", options=False)
    direct.setOperators(matrix)
    direct.getPC().setFactorSetUpSolverType()
    direct.getPC().getFactorMatrix().setMumpsIcntl(COUNT_NULL, 1)
    direct.setUp()
    return direct


def _spread(by_cell: Array, like: Array) -> Array:
    return np.broadcast_to(by_cell[:, None], like.shape)


def _place(solver: EquilibriumSolver, scores: Array) -> Location:
    """Return the point with the highest score of all ranks; collective."""
    model = solver.problem.model
    probe = FieldProbe(
        model, ("shear_angle", "stretch", "relative_displacement"), solver.crossing.points
    )
    values, positions = probe.values(), probe.positions()
    margins = solver.crossing.margins()
    best, location = scores.max(initial=-np.inf), None
    if scores.size:
        at = np.unravel_index(int(scores.argmax()), scores.shape)
        slip = float(values["beta"][at][0]) if "beta" in values else None
        stretches = (float(values["stretch_1"][at][0]), float(values["stretch_2"][at][0]))
        x, y = positions[at]
        shear = float(values["shear_angle"][at][0])
        location = Location(float(x), float(y), shear, stretches, slip, float(margins[at]))
    places = model.comm.allgather((float(best), location))
    place: Location | None = max(places, key=lambda p: p[0])[1]
    assert place is not None
    return place
