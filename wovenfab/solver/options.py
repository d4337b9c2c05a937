"""What a solver is asked to do, how a solve ended, and the PETSc options of one solver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count
from typing import Any

from petsc4py import PETSc

#: Beginnings of the names of command-line options that are for the solver.
FOR_SOLVERS = ("snes_", "newton_", "ksp_", "pc_", "mat_", "mg_", "sub_", "fieldsplit_")


@dataclass(frozen=True)
class SolverOptions:
    """Tolerances and alternatives of the equilibrium solver.

    Attributes:
        max_iterations: Newton iterations after which a step is given up.
        tolerance: Residual force over the largest internal force met so far.
        options: PETSc options, such as ``{"snes_monitor": None}``.
        keep_from: Solutions that a factorisation must be worth before the factor of an earlier
            tangent is used; infinite for never.
        descend: Shift every indefinite tangent until it is definite.
        seed: Of the random field that decides between the branches at a bifurcation.
    """

    max_iterations: int = 25
    tolerance: float = 1e-9
    options: Mapping[str, Any] | None = None
    keep_from: float = 10.0
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
        tangents: Number of iterations that formed one, which takes most of the time.
    """

    converged: bool
    reason: str
    iterations: int
    residual: float
    negatives: int = 0
    tangents: int = 0


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
        # MUMPS counts negative pivots only where it leaves the last block to itself (13).
        own = {"snes_linesearch_type": "basic", "mat_mumps_icntl_13": 1}
        settings = {**own, **(case or {}), **{name: database[name] for name in names}}
        self._names = [self.prefix + name for name in settings]
        for name, value in zip(self._names, settings.values(), strict=True):
            database[name] = value

    def clear(self) -> None:
        """Remove them from PETSc's database."""
        for name in self._names:
            PETSc.Options().delValue(name)
