"""Residual, tangent and potential of a model, as functions of PETSc's vectors."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray
from petsc4py import PETSc

from wovenfab.model.assembly import assemble_matrix, assemble_scalar, assemble_vector, create_matrix
from wovenfab.model.constraints import Constraints
from wovenfab.model.model import Model
from wovenfab.solver.point_friction import PointStress

#: PETSc's event for the assembly of a tangent, as in its table for ``-log_view``.
TANGENT = "Tangent"


class Problem:
    """What balances: its vectors and its matrix are made once.

    Attributes:
        model: Its forms; those that carry stress may take the place of the plain ones.
        carried: The stress of friction that is carried at quadrature points, or None.
        matrix: The tangent (N/m), with prescribed rows of one.
        residual: Vector for forces, N.
        force: Internal force at this rank's unknowns at the last residual, before boundary
            conditions, N.
        force_norm: Its norm over all unknowns, N.
        attained: Whether the field has the prescribed placements.
    """

    def __init__(self, model: Model, constraints: Constraints, upper: bool) -> None:
        """Create matrix and vectors.

        Args:
            model: The compiled model.
            constraints: Its prescribed placements.
            upper: Whether the matrix is stored by its upper half.
        """
        self.model = model
        self.carried: PointStress | None = None
        self._constraints = constraints
        self.residual = model.field.x.petsc_vec.duplicate()  # ghosted
        self._diagonal = self.residual.duplicate()
        self.matrix = create_matrix(model.jacobian, upper=upper)
        self.force: NDArray[np.float64] = np.zeros(self.residual.getLocalSize())
        self.force_norm = 0.0
        self.attained = False

    def load(self, x: Any) -> None:
        """Copy a PETSc vector into the model's field, ghosts included."""
        field = self.model.field
        field.x.array[: x.getLocalSize()] = x.array_r
        field.x.scatter_forward()

    def begin(self) -> None:
        """Look whether the field has the prescribed placements already."""
        self.attained = not self._constraints.unmet(self.model.field)

    def evaluate_residual(self, b: Any) -> None:
        """Put the forces in b, with the prescribed values lifted so that one step attains them."""
        if not self.attained:
            self.begin()
        if self.carried:
            self.carried.prepare_force(self.attained)
        self._assemble_force(b)
        self.force = np.array(b.array_r)
        self.force_norm = b.norm()
        bcs, at = self._constraints.bcs, self.model.field.x.petsc_vec
        if not self.attained:
            with b.localForm() as local:
                local.array_w[b.getLocalSize() :] = 0.0
            for form in self.model.jacobian:
                fem_petsc.apply_lifting(b, [form], [bcs], [at], -1.0)
            b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        fem_petsc.set_bc(b, bcs, at, -1.0)

    def evaluate_force(self) -> NDArray[np.float64]:
        """Return the internal force (N) of the model's present field at own unknowns."""
        self._assemble_force(self.residual)
        return np.array(self.residual.array_r)

    def evaluate_tangent(self) -> float:
        """Assemble the tangent of the present field; return its size, N/m."""
        with PETSc.Log.Event(TANGENT):
            if self.carried:
                self.carried.prepare_tangent()
            size = self.size_of_tangent()
        return self.carried.diagonal if self.carried else size

    def size_of_tangent(self) -> float:
        """Assemble the tangent for stresses as they are; return its diagonal's size, N/m."""
        assemble_matrix(self.matrix, self.model.jacobian, self._constraints.bcs)
        self.matrix.getDiagonal(self._diagonal)
        return float(self._diagonal.norm())

    def energy(self) -> float:
        """Return the incremental potential (J) of the model's present field; collective."""
        return assemble_scalar(self.model.potential, self.model.comm)

    def force_of(self, forms: Any) -> NDArray[np.float64]:
        """Return the force (N) of other linear forms at own unknowns."""
        assemble_vector(self.residual, forms)
        self.residual.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return np.array(self.residual.array_r)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for item in (self.matrix, self.residual, self._diagonal):
            item.destroy()

    def _assemble_force(self, b: Any) -> None:
        assemble_vector(b, self.model.residual)
        if self.carried:
            self.carried.add_force(b)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
