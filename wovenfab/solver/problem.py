"""Problem: residual, tangent and potential of a model; options and result of its solution."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray
from petsc4py import PETSc

from wovenfab.model.assembly import assemble_matrix, assemble_scalar, assemble_vector, create_matrix
from wovenfab.model.constraints import Constraints
from wovenfab.model.model import Model

if TYPE_CHECKING:
    from wovenfab.solver.interior_point import InteriorPoint


#: Beginnings of the names of command-line options that are for the solver.
FOR_SOLVERS = ("snes_", "newton_", "ksp_", "pc_", "mat_", "mg_", "sub_", "fieldsplit_")
#: Options that PETSc reads when it ends.
READ_LAST = ("options_left", "malloc_dump", "malloc_view", "malloc_info", "objects_dump")
#: Options with the one value that Newton's method here works with.
ONLY = {"snes_type": "newtonls", "snes_linesearch_type": "basic"}


@dataclass(frozen=True)
class SolverOptions:
    """Tolerances and alternatives of the equilibrium solver.

    Attributes:
        max_iterations: Newton iterations after which a step is given up.
        tolerance: Residual force over the largest internal force met so far.
        options: PETSc options, such as ``{"snes_monitor": None}``.
        keep_factor: Whether the factor of an earlier tangent is used where that pays.
        descend: Shift every indefinite tangent until it is definite.
        seed: Of the random field that decides between the branches at a bifurcation.
    """

    max_iterations: int = 25
    tolerance: float = 1e-9
    options: Mapping[str, Any] | None = None
    keep_factor: bool = True
    descend: bool = False
    seed: int = 0


@dataclass(frozen=True)
class SolveResult:
    """How a solve ended.

    Attributes:
        converged: Whether equilibrium was found.
        reason: PETSc's name of the reason.
        iterations: Newton iterations.
        residual: Norm of the residual force, N.
        negatives: Number of negative eigenvalues of the tangent at the solution; it is a
            minimum of the incremental potential if there is none.
    """

    converged: bool
    reason: str
    iterations: int
    residual: float
    negatives: int = 0


class OptionError(Exception):
    """PETSc cannot use an option that the case or the command line gives."""


class PetscOptions:
    """The PETSc options of one solver, under a prefix of its own, while the object lives.

    They are what this solver needs, then those of the case, then those of the command line;
    the later ones win. Two solvers that live at the same time do not see each other's.

    Attributes:
        prefix: Beginning of their names in PETSc's database.
        given: Names of those of the case and of the command line.
    """

    _numbers = count(1)

    def __init__(self, case: Mapping[str, Any] | None = None) -> None:
        """Set the options of a solver.

        Args:
            case: PETSc options by name, without a prefix.

        Raises:
            OptionError: One chooses a method that does not work.
        """
        self.prefix = f"wovenfab_{next(self._numbers)}_"
        database = PETSc.Options()
        names = [name for name in database.getAll() if name.startswith(FOR_SOLVERS)]
        # MUMPS counts negative pivots only where it leaves the last block to itself (13).
        own = {"snes_linesearch_type": "basic", "mat_mumps_icntl_13": 1}
        chosen = {**(case or {}), **{name: database[name] for name in names}}
        settings, self.given = {**own, **chosen}, tuple(chosen)
        for name, known in ONLY.items():
            if (value := settings.get(name, known)) != known:
                raise OptionError(
                    f"{name} {value} does not work here, but {known} does: the solver limits "
                    "steps and searches along them itself"
                )
        self._names = [self.prefix + name for name in settings]
        for name, value in zip(self._names, settings.values(), strict=True):
            database[name] = value

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Say that an error of PETSc is one of the options that were given, if any were.

        Raises:
            OptionError: With PETSc's last word.
        """
        try:
            yield
        except (PETSc.Error, RuntimeError) as error:
            self.clear()
            if not self.given:
                raise
            cause = error.__cause__ or error
            word = str(cause).splitlines()[-1].partition("] ")[2] or str(cause)
            raise OptionError(f"PETSc does not take {', '.join(self.given)}: {word}") from error

    def unread(self) -> list[str]:
        """Return options of the case, the command line and the environment that none has read."""
        elsewhere = (*FOR_SOLVERS, self.prefix.partition("_")[0])
        others = [name for name in PETSc.Options().getAll() if not name.startswith(elsewhere)]
        mine = [name for name in self.given if not _is_read(self.prefix + name)]
        return [*mine, *(n for n in others if n not in READ_LAST and not _is_read(n))]

    def clear(self) -> None:
        """Remove them from PETSc's database."""
        for name in self._names:
            PETSc.Options().delValue(name)


def _is_read(name: str) -> bool:
    """Return whether PETSc has read an option of its database; petsc4py cannot be asked for it."""
    found = ctypes.c_int(0)
    ctypes.CDLL(PETSc.__file__).PetscOptionsUsed(None, name.encode(), ctypes.byref(found))
    return bool(found.value)


#: PETSc's event for the assembly of a tangent, as in its table for ``-log_view``.
TANGENT = "Tangent"


class Problem:
    """The equilibrium of a model under its constraints; vectors are created once.

    Attributes:
        model: The forms that are solved. Friction with stress at quadrature points may take
            the place of the smooth law; fields and constants stay the same objects.
        constraints: Prescribed placements.
        friction: The stresses of friction at quadrature points, or None.
        residual: Vector for forces, N.
        force: Internal force at this rank's unknowns at the last residual, before boundary
            conditions, N.
        force_norm: Its norm over all unknowns, N.
        attained: Whether the field has the prescribed placements.
    """

    def __init__(self, model: Model, bcs: Mapping[str, fem.DirichletBC] | None = None) -> None:
        """Find the prescribed unknowns, and create the vectors; collective.

        Args:
            model: The compiled model.
            bcs: Dirichlet conditions of dolfinx beside those of the model, for its space or that
                of one placement (``model.placements.families``), by names under which their
                reactions are recorded. Their values may be changed between steps.
        """
        self.model = model
        self.constraints = Constraints(model.placements, model.sheet, model.grips, bcs)
        self.friction: InteriorPoint | None = None
        self.residual = model.field.x.petsc_vec.duplicate()  # ghosted
        self._work = self.residual.duplicate()
        self.force: NDArray[np.float64] = np.zeros(self.residual.getLocalSize())
        self.force_norm = 0.0
        self.attained = False

    def load(self, x: Any) -> None:
        """Copy a PETSc vector into the model's field, ghosts included."""
        field = self.model.field
        field.x.array[: x.getLocalSize()] = x.array_r
        field.x.scatter_forward()

    def begin(self) -> None:
        """Check whether the field has the prescribed placements already; collective."""
        self.attained = not self.constraints.unmet(self.model.field)

    def advance(self, x: Any, y: Any, length: float) -> None:
        """Take a step to x - y: note whether it attains the placements, and move the stresses.

        Collective.

        Args:
            x: The iterate, m.
            y: The step, m; it is shortened already.
            length: Its length over that of the whole step.
        """
        if self.attained and not self.friction:
            return
        field = self.model.field
        field.x.array[: x.getLocalSize()] = x.array_r - y.array_r
        field.x.scatter_forward()
        if not self.attained:
            self.begin()
        if self.friction:
            self.friction.advance(length, self.attained)

    def evaluate_residual(self, b: Any) -> None:
        """Put the forces in b, with the prescribed values lifted so that one step attains them."""
        self._assemble_force(b)
        self.force = np.array(b.array_r)
        self.force_norm = b.norm()
        bcs, at = self.constraints.bcs, self.model.field.x.petsc_vec
        if not self.attained:
            with b.localForm() as local:
                local.array_w[b.getLocalSize() :] = 0.0
            for form in self.model.jacobian.values():
                fem_petsc.apply_lifting(b, [form], [bcs], [at], -1.0)
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        fem_petsc.set_bc(b, bcs, at, -1.0)

    def evaluate_force(self) -> NDArray[np.float64]:
        """Return the internal force (N) of the model's present field at own unknowns."""
        self._assemble_force(self.residual)
        return np.array(self.residual.array_r)

    def create_tangent(self, upper: bool) -> Any:
        """Return a matrix for the tangent (N/m), with prescribed rows of one; collective.

        Args:
            upper: Whether it is stored by its upper half.
        """
        return create_matrix(self.model.jacobian, upper=upper)

    def evaluate_tangent(self, matrix: Any) -> float:
        """Assemble the tangent of the present field; return its size, N/m."""
        with PETSc.Log.Event(TANGENT):
            if self.friction:
                self.friction.put_tangent()
            size = self.size_of_tangent(matrix)
        return self.friction.diagonal if self.friction else size

    def size_of_tangent(self, matrix: Any) -> float:
        """Assemble the tangent for stresses as they are; return its diagonal's size, N/m."""
        assemble_matrix(matrix, self.model.jacobian, self.constraints.bcs)
        matrix.getDiagonal(self._work)
        return float(self._work.norm())

    def residual_norms(self) -> list[float]:
        """Return the norm (N) of the last residual for each placement; collective."""
        values, placements = self.residual.array_r.reshape(-1, 2), self.model.placements
        squares = []
        for family in range(placements.count):
            blocks = np.unique(placements.blocks[:, :, family])
            squares.append(float((values[blocks[blocks < len(values)]] ** 2).sum()))
        return [float(s) for s in np.sqrt(np.sum(self.model.comm.allgather(squares), axis=0))]

    def reactions(self) -> dict[str, tuple[float, float]]:
        """Return the force (N; x, y) of each held edge at the last residual; collective."""
        return self.constraints.reactions(self.force)

    def prescribe(self, program: float, share: float = 1.0) -> None:
        """Prescribe placements and dead loads for a program value (m), or a share of them."""
        self.constraints.set(program, share)
        self.model.loading.set(program, share)

    def prescribe_second(self, program: float) -> None:
        """Take a value (m) of the second program for all that is prescribed from now on."""
        self.constraints.second = self.model.loading.second.value = program

    def energy(self) -> float:
        """Return the incremental potential (J) of the model's present field; collective."""
        return assemble_scalar(self.model.potential, self.model.comm)

    def stiffness_along(self, displacement: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the tangent times a displacement of held unknowns (N) at own unknowns; collective.

        Only cells at held edges have a part in it.

        Args:
            displacement: Unknowns with ghosts, zero where they are not held.
        """
        b = self.residual
        with b.localForm() as local:
            local.set(0.0)
        with self.constraints.prescribed(displacement) as bcs:
            for form in self.model.jacobian.values():
                fem_petsc.apply_lifting(b, [form], [bcs], alpha=-1.0)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return np.array(b.array_r)

    def force_of(self, forms: Any) -> NDArray[np.float64]:
        """Return the force (N) of other linear forms at own unknowns."""
        assemble_vector(self.residual, forms)
        self.residual.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return np.array(self.residual.array_r)

    def add_friction_force(self, b: Any, stress: NDArray[np.float64] | None = None) -> None:
        """Add the force (N) of friction stresses to a vector; ghosts are not yet summed.

        Args:
            b: PETSc's vector.
            stress: Values at the points; the present ones unless given.
        """
        if not self.friction or not self.friction.acts:
            return
        with nullcontext() if stress is None else self.friction.in_forms(stress):
            for form in self.model.friction_force.values():
                fem_petsc.assemble_vector(b, form)

    def friction_force(self, stress: NDArray[np.float64]) -> Any:
        """Return the force (N) of friction stresses, zero at held unknowns; a work vector."""
        with self._work.localForm() as local:
            local.set(0.0)
        self.add_friction_force(self._work, stress)
        self._work.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        fem_petsc.set_bc(self._work, self.constraints.bcs, alpha=0.0)
        return self._work

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for item in (self.residual, self._work):
            item.destroy()

    def _assemble_force(self, b: Any) -> None:
        assemble_vector(b, self.model.residual)
        self.add_friction_force(b)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
