"""PETSc's nonlinear solver as it is used here, with the options of a case."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

from wovenfab.solver.controls import Controls
from wovenfab.solver.factor import Factor

_REASONS = {
    value: name
    for name, value in vars(PETSc.SNES.ConvergedReason).items()
    if isinstance(value, int) and value != 0
}


class Options:
    """PETSc options that stay set while an object lives; PETSc reads some at the first solve.

    Those that are set already, by the command line, keep their values.
    """

    def __init__(self, controls: Controls) -> None:
        """Set the options of a solver."""
        # The line search is ours, in the pre-check; PETSc's own stay reachable.
        # MUMPS counts negative pivots only where it leaves the last block to itself (13).
        ours = {"snes_linesearch_type": "basic", "mat_mumps_icntl_13": 1}
        settings = {**ours, **(controls.options or {})}
        options = PETSc.Options()
        self._mine = [name for name in settings if name not in options]
        for name in self._mine:
            options[name] = settings[name]

    def clear(self) -> None:
        """Take them back."""
        for name in self._mine:
            PETSc.Options().delValue(name)


class _Linear:
    """Newton's linear systems, as PETSc's linear solver of type python."""

    def __init__(self, factor: Factor) -> None:
        self._factor = factor

    def solve(self, ksp: Any, b: Any, x: Any) -> None:
        """Solve one."""
        ksp.setConvergedReason(self._factor.solve(b, x))

    def view(self, ksp: Any, viewer: Any) -> None:
        """Describe what solves it, as ``-snes_view`` asks."""
        self._factor.view(viewer)


def create_snes(comm: MPI.Comm, controls: Controls, factor: Factor) -> Any:
    """Return Newton's method, its systems solved by a factor; collective.

    Options must be set before.
    """
    snes = PETSc.SNES().create(comm)
    snes.setType("newtonls")
    snes.setTolerances(max_it=controls.max_iterations)
    ksp = snes.getKSP()
    ksp.setOptionsPrefix("newton_")  # options without a prefix are for the factor's solver
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
