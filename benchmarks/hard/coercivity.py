"""Whether the penalty holds the bending energy together in the deformed sheet."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from scipy.linalg import eigh

from wovenfab.forms.balance import facet_penalty
from wovenfab.forms.kinematics import along, curvature_vector, displacements, tangent, twice_along
from wovenfab.model.assembly import compile_form
from wovenfab.model.model import Model

Array = NDArray[np.float64]
#: Share of the largest eigenvalue of the norm below which a direction costs no bending.
FREE = 1e-10


class Coercivity:
    """The facet-cell form of bending against its norm, in the model's present state.

    Both are quadratic in the change of the curvature vector (in the cells) and of the jump
    of the unit tangent (on the facets), linearised about the deformed state. The norm is
    the form without the terms of consistency, which are what a penalty must outweigh.
    """

    def __init__(self, model: Model) -> None:
        """Compile form and norm with the same stiffness for all fibres."""
        self._form, self._norm = (compile_form(_quadratic(model, full)) for full in (True, False))

    def least(self) -> float:
        """Return the smallest generalised eigenvalue; positive if coercive. Serial."""
        form, norm = (_dense(f) for f in (self._form, self._norm))
        sizes, directions = eigh(norm)
        bending = sizes > FREE * sizes.max()
        basis = directions[:, bending] / np.sqrt(sizes[bending])
        return float(eigh(basis.T @ form @ basis, eigvals_only=True)[0])


def _quadratic(model: Model, consistent: bool) -> Any:
    balance, field = model.balance, model.field
    mesh = model.sheet.mesh
    trial, test = ufl.TrialFunction(model.space), ufl.TestFunction(model.space)
    rule = {"quadrature_degree": balance.quadrature}
    dx, facets = ufl.dx(metadata=rule), ufl.dS(metadata=rule)
    penalty = facet_penalty(mesh, balance.degree, balance.penalty)
    total = 0
    for family, direction in enumerate(balance.fibres):
        u = displacements(field)[family]
        f, g = along(direction, u) + direction, twice_along(direction, u)
        (k, dk), (e, de) = (
            [ufl.derivative(m, field, v) for v in (trial, test)]
            for m in (curvature_vector(f, g), tangent(f))
        )
        across = ufl.dot(direction, ufl.FacetNormal(mesh)("+"))
        jumps = [v("+") - v("-") for v in (e, de)]
        total += ufl.inner(k, dk) * dx
        total += penalty * across**2 * ufl.inner(*jumps) * facets
        if consistent:
            total -= across * ufl.inner(ufl.avg(k), jumps[1]) * facets
            total -= across * ufl.inner(ufl.avg(dk), jumps[0]) * facets
    return total


def _dense(form: fem.Form) -> Array:
    matrix = fem.assemble_matrix(form)
    matrix.scatter_reverse()
    return np.asarray(matrix.to_dense())
