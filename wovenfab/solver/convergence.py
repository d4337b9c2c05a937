"""When forces balance, by the forces and energies met so far and by rounding errors."""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

Reason = PETSc.SNES.ConvergedReason
EPSILON = float(np.finfo(np.float64).eps)
#: A change of the potential below this share of it is round-off, not an increase.
ROUND_OFF = 1e-12
#: How much more of the stiffly held forces than of soft ones, which hardly count in a norm, a step
#: with an older tangent may take away.
BEHIND = 10.0


class Convergence:
    """Judges residuals and steps of Newton's method.

    Strains are differences of displacements, which are known to a rounding error of their own
    size, and of the cell's where they are small; the tangent turns it into one of the forces.
    """

    def __init__(self, tolerance: float, cell_size: float) -> None:
        """Begin without any equilibrium.

        Args:
            tolerance: Residual force over the largest force met so far.
            cell_size: That of the largest cell, m.
        """
        self._tolerance = tolerance
        self._cell_size = cell_size
        # Largest force (N) and energy (J) of an equilibrium so far, by which others are judged.
        self._force = self._energy = 0.0
        # Size of the tangent (N/m), and rounding error of positions (m).
        self._stiffness = self._blur = 0.0

    def measure(self, stiffness: float, farthest: float) -> None:
        """Note the size of a tangent (N/m) and the largest displacement (m) it was formed at."""
        self._stiffness = stiffness
        self._blur = EPSILON * max(farthest, self._cell_size)

    def accept(self, force: float, energy: float) -> None:
        """Note an equilibrium's norm of the internal force (N) and its potential (J)."""
        self._force = max(self._force, force)
        self._energy = self.scale_of(energy)

    def scale_of(self, energy: float) -> float:
        """Return the largest energy (J) of an equilibrium so far, and of this state."""
        return max(self._energy, abs(energy))

    def noise(self, energy: float) -> float:
        """Return by how much a potential (J) may seem to rise by rounding alone, J.

        An energy k x²/2 is uncertain by k x dx, and no less by the rounding of its sum.
        """
        blurred = self._blur * np.sqrt(2 * abs(energy) * self._stiffness)
        return float(max(ROUND_OFF * self.scale_of(energy), blurred))

    def reason(
        self,
        residual: float,
        force: float,
        decrement: float,
        energy: float,
        left: float | None = None,
    ) -> int | None:
        """Return PETSc's reason to end, or None where forces do not balance yet.

        Newton's decrement is twice the energy that a step gains; convergence is quadratic, so
        a step of relative energy ``tolerance`` leaves its square. With an older tangent it is
        linear: the next step would gain as much less as forces have become smaller, squared.

        Args:
            residual: Norm of the forces that do not balance, N.
            force: Norm of the internal force, N.
            decrement: That of the last step if it was a full one, otherwise infinite, J.
            energy: Potential, J.
            left: Share of the residual that the last step left, if its tangent was an older one.
        """
        largest = max(self._force, force)
        if residual <= max(self._tolerance * largest, self._blur * self._stiffness):
            return int(Reason.CONVERGED_FNORM_RELATIVE)
        least = self._tolerance * self.scale_of(energy)
        if left is not None:
            decrement, least = decrement * (BEHIND * left) ** 2, least * self._tolerance
        if decrement <= least and residual <= np.sqrt(self._tolerance) * largest:
            return int(Reason.CONVERGED_SNORM_RELATIVE)
        return None


def largest_cell(mesh: Any) -> float:
    """Return the size of the largest cell of a mesh, m; collective."""
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    return float(mesh.comm.allreduce(mesh.h(2, cells).max(initial=0.0), op=MPI.MAX))
