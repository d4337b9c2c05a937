"""PETSc's nonlinear solver as it is used here, with the options of a case.

Newton's method on the incremental potential of a problem, by PETSc's SNES.

SNES calls back for residual and Jacobian; before it takes a step, the step is cut
to stay admissible (no crossing of the families) and then, once the prescribed
placements are attained, backtracked until the incremental potential falls enough.
Where that shortens a step by an indefinite tangent, the step is made anew by its positive
part alone: sharply curved yarns turn, and the potential in their Cartesian placements is
far from the paraboloid that the whole tangent is of.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import count
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from wovenfab.model.model import preserved
from wovenfab.solver.convergence import Convergence, largest_cell
from wovenfab.solver.globalisation import CROSSING_SHARE, CrossingLimit, LineSearch
from wovenfab.solver.linear import LinearSolver, TangentReuse, distance_over
from wovenfab.solver.options import SolverOptions
from wovenfab.solver.problem import Problem
from wovenfab.solver.tangent_spectrum import UNSEEN, TangentSpectrum, start_vector

_REASONS = {
    value: name
    for name, value in vars(PETSc.SNES.ConvergedReason).items()
    if isinstance(value, int) and value != 0
}


#: Beginnings of the names of command-line options that are for the solver.
FOR_SOLVERS = ("snes_", "newton_", "ksp_", "pc_", "mat_", "mg_", "sub_", "fieldsplit_")


class PetscOptions:
    """The PETSc options of one solver, under a prefix of its own, while the object lives.

    They are what this solver needs, then those of the case, then those of the command line;
    the later ones win. Two solvers that live at the same time do not see each other's.

    Attributes:
        prefix: Beginning of their names in PETSc's database.
    """

    _numbers = count(1)

    def __init__(self, case: Mapping[str, Any] | None = None) -> None:
        """Set the options of a solver.

        Args:
            case: PETSc options by name, without a prefix.
        """
        self.prefix = f"wovenfab_{next(self._numbers)}_"
        database = PETSc.Options()
        names = [name for name in database.getAll() if name.startswith(FOR_SOLVERS)]
        # The line search is ours, in the pre-check; PETSc's own stay reachable.
        # MUMPS counts negative pivots only where it leaves the last block to itself (13).
        ours = {"snes_linesearch_type": "basic", "mat_mumps_icntl_13": 1}
        settings = {**ours, **(case or {}), **{name: database[name] for name in names}}
        self._names = [self.prefix + name for name in settings]
        for name, value in zip(self._names, settings.values(), strict=True):
            database[name] = value

    def clear(self) -> None:
        """Remove them from PETSc's database."""
        for name in self._names:
            PETSc.Options().delValue(name)


class _Linear:
    """Newton's linear systems, as PETSc's linear solver of type python."""

    def __init__(self, factor: LinearSolver) -> None:
        self._factor = factor

    def solve(self, ksp: Any, b: Any, x: Any) -> None:
        """Solve one."""
        ksp.setConvergedReason(self._factor.solve(b, x))

    def view(self, ksp: Any, viewer: Any) -> None:
        """Describe what solves it, as ``-snes_view`` asks."""
        self._factor.view(viewer)


def create_snes(
    comm: MPI.Comm, controls: SolverOptions, factor: LinearSolver, prefix: str = ""
) -> Any:
    """Return Newton's method, its systems solved by a factor; collective.

    Options must be set before.
    """
    snes = PETSc.SNES().create(comm)
    snes.setOptionsPrefix(prefix)
    snes.setType("newtonls")
    snes.setTolerances(max_it=controls.max_iterations)
    ksp = snes.getKSP()
    ksp.setOptionsPrefix(f"{prefix}newton_")  # those without newton_ are for the factor's solver
    snes.setFromOptions()
    ksp.setType("python")
    ksp.setPythonContext(_Linear(factor))
    ksp.getPC().setType("none")
    return snes


def reason_of(snes: Any) -> str:
    """Return PETSc's name of the reason for which a solve ended."""
    value: int = snes.getConvergedReason()
    name: str = _REASONS.get(value, str(value))
    return name


Reason = PETSc.SNES.ConvergedReason
#: Searches in a row that find no lower potential, the second with the plain tangent, end a solve.
STUCK = 2


class NewtonSolver:
    """Solves a system with its present forms; objects are made once.

    Attributes:
        snes: PETSc's solver.
        solution: Its unknowns, m.
        inertia: Judges the tangent.
        tangents: Number of iterations of the last solve that formed one.
        norm: Norm of the forces that do not balance at the last iterate, N.
        saddle_at_start: Whether the tangent was indefinite where the last solve began.
    """

    def __init__(
        self,
        problem: Problem,
        matrix: Any,
        controls: SolverOptions,
        factor: LinearSolver,
        barrier: CrossingLimit,
        prefix: str = "",
    ) -> None:
        """Create vectors and SNES.

        Args:
            problem: Residual, tangent and potential.
            matrix: For its tangent.
            controls: Tolerances and alternatives.
            factor: Solves the linear systems.
            barrier: Where the families would cross.
            prefix: Beginning of the names of its PETSc options.
        """
        self.problem, self.controls, self.factor, self.barrier = problem, controls, factor, barrier
        self.solution = problem.residual.duplicate()
        self._matrix = matrix
        self.norm, self.tangents, self.saddle_at_start = 0.0, 0, False
        # The last solution, where the solve began, and where the tangent was formed.
        self._before, self._began, self._assembled = np.zeros((3, self.solution.getLocalSize()))
        self._chord, self._left = TangentReuse(), np.inf  # share of the forces left by a step
        self._convergence = Convergence(controls.tolerance, largest_cell(problem.model.sheet.mesh))
        self._search = LineSearch(problem, barrier)
        self._most = controls.max_iterations
        self.snes = create_snes(problem.model.comm, controls, factor, prefix)
        self.snes.setFunction(self.evaluate_residual, problem.residual)
        self.snes.setJacobian(self.evaluate_jacobian, matrix)
        self.snes.setObjective(self.evaluate_objective)
        self.snes.setLineSearchPreCheck(self.limit_step)
        self.snes.setConvergenceTest(self.test)
        start = start_vector(problem.model.placements, problem.constraints.bcs, controls.seed)
        self.inertia = TangentSpectrum(factor, matrix, self.assemble_tangent, start)

    def solve(self, most: int) -> int:
        """Solve from the model's present field; return PETSc's reason.

        The model's ``last`` field must hold the last solution.

        Args:
            most: Number of iterations.
        """
        problem = self.problem
        self.solution.array_w[:] = problem.model.field.x.array[: self.solution.getLocalSize()]
        self.norm, self.tangents, self._most = np.nan, 0, most
        self._began[:] = self.solution.array_r
        self._before[:] = problem.model.last.x.array[: self._before.size]
        problem.begin()
        self._search.begin()
        self._chord.begin()
        self.inertia.restart()
        # Descents meet tangents that are not, and carried stress changes them too much.
        self.factor.definite = not (self.controls.descend or problem.point_stress)
        if self.factor.status < 0:
            self.factor.forget()
        if problem.point_stress:
            problem.point_stress.begin(lambda: problem.size_of_tangent(self._matrix))
        self.snes.solve(None, self.solution)
        problem.load(self.solution)
        return int(self.snes.getConvergedReason())

    def judge(self) -> int:
        """Return the number of negative eigenvalues at a solution, by which others are judged."""
        moved = self.snes.getIterationNumber() > 0
        negatives = self.inertia.judge(self._way_from(self._assembled) if moved else np.inf)
        self._convergence.accept(self.problem.force_norm, self._search.potential or 0.0)
        return negatives

    def assemble_tangent(self) -> None:
        """Put the tangent of the model's present field in the matrix, the plain one."""
        model = self.problem.model
        model.last.x.array[:] = model.field.x.array
        self.solution.array_w[:] = model.field.x.array[: self.solution.getLocalSize()]
        self.form_tangent(self.solution)

    def evaluate_residual(self, snes: Any, x: Any, b: Any) -> None:
        """Put the residual in ``b``."""
        self.problem.load(x)
        self.problem.evaluate_residual(b)

    def evaluate_jacobian(self, snes: Any, x: Any, matrix: Any, preconditioner: Any) -> None:
        """Put the tangent in the matrix, unless that of the last step serves once more."""
        self._chord.taken = self._serves()
        if not self._chord.taken:
            self.tangents += 1
            self.inertia.restart()
            self.form_tangent(x)

    def form_tangent(self, x: Any) -> None:
        """Put the tangent in the matrix."""
        self.problem.load(x)
        self._assembled[:] = x.array_r
        size = self.problem.evaluate_tangent(self._matrix)
        self._convergence.measure(size, x.norm(PETSc.NormType.INFINITY))

    def evaluate_objective(self, snes: Any, x: Any) -> float:
        """Return the potential, J."""
        self.problem.load(x)
        return self.problem.energy()

    def limit_step(self, x: Any, y: Any) -> bool:
        """Shorten the step so that x - y is admissible and lowers the potential."""
        self.problem.load(x)
        if not self.snes.getIterationNumber():
            self.saddle_at_start = self.inertia.saddle
            self.inertia.begin()
        if self.problem.attained and self.controls.descend:
            self.inertia.descend(self.snes.getFunction()[0], y)
        self.problem.model.last.x.array[:] = self.problem.model.field.x.array
        inside = (
            self.problem.point_stress.correct(self.factor, y) if self.problem.point_stress else 1.0
        )
        length = min(inside, self._limit(y))
        if self.problem.point_stress:
            self.problem.point_stress.go(length)
        elif self.problem.attained and self.controls.line_search:
            length = self._go_down(x, y, length)
        else:
            self._search.forget()
        if length < 1.0:
            y.scale(length)
        return length < 1.0

    def test(self, snes: Any, iteration: int, norms: tuple[float, float, float]) -> int:
        """End where forces balance or nothing is gained any more."""
        residual = norms[2]
        self._left = residual / self.norm if iteration and self.norm else np.inf
        self.norm = residual
        if not np.isfinite([residual, self.problem.force_norm]).all():
            return int(Reason.DIVERGED_FNORM_NAN)
        if self.problem.attained and self._is_lawful():
            reason = self._convergence.reason(
                residual,
                self.problem.force_norm,
                self._search.decrement,
                self._search.potential or 0.0,
                self._left if self._chord.taken else None,
            )
            if reason is not None:
                return reason
        if self._search.failures >= STUCK:
            return int(Reason.DIVERGED_LINE_SEARCH)
        if iteration >= self._most:
            return int(Reason.DIVERGED_MAX_IT)
        return int(Reason.CONVERGED_ITERATING)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        self.inertia.destroy()
        self.snes.destroy()
        self.solution.destroy()

    def _limit(self, y: Any) -> float:
        """Return the largest admissible length of a step; the limit keeps its direction."""
        limit = CROSSING_SHARE * self.barrier.limit(-y.array_r)
        return limit if self.controls.step_limit else 1.0

    def _go_down(self, x: Any, y: Any, longest: float) -> float:
        """Return a step length that lowers the potential, of another step if need be."""
        search, noise, force = self._search, self._convergence.noise, self.snes.getFunction()[0]
        before = search.potential, search.failures
        length = search.along(force.dot(y), longest, noise, loose=not self.inertia.saddle)
        if length == longest or not self.inertia.saddle:
            return length
        whole = self.problem.model.whole
        with preserved(whole):
            whole.value = 0.0
            self.form_tangent(x)
        if not self.inertia.replace(force, y):
            return length
        search.potential, search.failures = before
        length = search.along(force.dot(y), min(self._limit(y), 1.0), noise)
        search.decrement = np.inf  # convergence is quadratic with the whole tangent alone
        return length

    def _is_lawful(self) -> bool:
        """Return whether the carried stresses meet their laws."""
        carried, tolerance = self.problem.point_stress, self.controls.tolerance
        return carried is None or carried.settled(tolerance, self._scale_of_energy)

    def _scale_of_energy(self) -> float:
        """Return the largest energy (J) of an equilibrium so far, and of this state."""
        return self._convergence.scale_of(self._search.measure())

    def _serves(self) -> bool:
        """Return whether the tangent serves for another step; collective."""
        late = 2 * self.snes.getIterationNumber() > self._most
        usual = self.factor.keeps and self.factor.definite and not self.inertia.altered
        if late or not usual or not self._chord.promises(self._left):
            return False
        return not self.factor.negatives and self._way_from(self._began) <= UNSEEN

    def _way_from(self, place: NDArray[np.float64]) -> float:
        """Return how far a place is from here, over the way from the last solution; collective."""
        now = self.solution.array_r
        return distance_over(self.problem.model.comm, now, place, self._before)
