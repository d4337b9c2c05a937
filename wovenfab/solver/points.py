"""The quadrature points at which stresses are carried, as plain arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from forms.carried import Carried
from wovenfab.model.compiler import compile_expression

Array = NDArray[np.float64]


class _Rule:
    """The points of one friction on this rank's own cells; values by cell, point, component."""

    def __init__(self, carried: Carried, step: fem.Function) -> None:
        space = carried.stress.function_space
        mesh = self._mesh = space.mesh
        own = mesh.topology.index_map(2).size_local
        self._cells = np.arange(own, dtype=np.int32)
        self._dofs = space.dofmap.list[:own]
        self._size = carried.size
        self.carried = carried
        points, weights = basix.make_quadrature(basix.CellType.triangle, carried.degree)
        self._increment = compile_expression(carried.increment(), points)
        self._change = compile_expression(carried.change(step), points)
        creep = carried.creep()
        self._creep = None if creep is None else compile_expression(creep, points)
        given = ufl.as_vector([abs(ufl.JacobianDeterminant(mesh)), carried.strength()])
        area, bound = self._at(compile_expression(given, points)).reshape(-1, 2).T
        self.area = np.repeat(area * np.tile(weights, own), self._size)
        self.bound = np.repeat(bound, self._size)

    def increments(self) -> Array:
        return self._at(self._increment)

    def changes(self) -> Array:
        return self._at(self._change)

    def creep(self) -> Array:
        """Return the creep and its slope, shape (2, n)."""
        if self._creep is None:
            return np.zeros((2, self.bound.size))
        found = self._at(self._creep).reshape(-1, 2, self._size)
        return np.swapaxes(found, 0, 1).reshape(2, -1)

    def put(self, function: fem.Function, values: Array) -> None:
        rows = function.x.array.reshape(-1, self._size)
        rows[self._dofs] = values.reshape(*self._dofs.shape, self._size)

    def _at(self, expression: fem.Expression) -> Array:
        found: Array = expression.eval(self._mesh, self._cells)
        return found.ravel()


class Points:
    """All points of some frictions on this rank that have a bound above zero, one by one.

    Attributes:
        bound: Largest stress zeta at each, shape (n,), as are all values here.
        area: Area that each stands for, m^2.
        creeps: Whether any law creeps below its bound.
    """

    def __init__(self, carried: Sequence[Carried], step: fem.Function) -> None:
        """Find them.

        Args:
            carried: The frictions.
            step: Displacement field along which changes are taken.
        """
        self._rules = [_Rule(c, step) for c in carried]
        everywhere = np.concatenate([r.bound for r in self._rules])
        self._acting = everywhere > 0
        self._ends = np.cumsum([r.bound.size for r in self._rules])[:-1]
        self._comm = step.function_space.mesh.comm
        self.bound = everywhere[self._acting]
        self.area = np.concatenate([r.area for r in self._rules])[self._acting]
        self.creeps = any(not c.term.effect.set_valued for c in carried)

    def increments(self) -> Array:
        """Return the increments b of the model's present field."""
        return self._all(_Rule.increments)

    def changes(self) -> Array:
        """Return how b varies along the step."""
        return self._all(_Rule.changes)

    def creep(self) -> tuple[Array, Array]:
        """Return b below the bound and its slope by the stress, at the stresses put."""
        both = np.hstack([rule.creep() for rule in self._rules])[:, self._acting]
        return both[0], both[1]

    def put_stress(self, values: Array) -> None:
        """Let the forms have these stresses."""
        self._put(values, lambda c: c.stress)

    def put_tangent(self, values: Array) -> None:
        """Let the forms have these tangents d tau/d b."""
        self._put(values, lambda c: c.tangent)

    def largest(self, values: Array) -> Array:
        """Return for each value the largest size of those of its friction; collective."""
        mine = [float(np.abs(part).max(initial=0.0)) for part in self._parts(values)]
        most = np.max(self._comm.allgather(mine), axis=0)
        sizes = [rule.bound.size for rule in self._rules]
        found: Array = np.repeat(most, sizes)[self._acting]
        return found

    def one_by_one(self) -> list[Array]:
        """Return for each friction an array that is one at its points, zero at the others."""
        parts = self._parts(np.ones_like(self.bound))
        return [
            np.concatenate([p * float(i == k) for k, p in enumerate(parts)])[self._acting]
            for i in range(len(parts))
        ]

    def _all(self, of: Callable[[_Rule], Array]) -> Array:
        return np.concatenate([of(rule) for rule in self._rules])[self._acting]

    def _parts(self, values: Array) -> list[Array]:
        everywhere = np.zeros(self._acting.size)
        everywhere[self._acting] = values
        return np.split(everywhere, self._ends)

    def _put(self, values: Array, where: Callable[[Carried], Any]) -> None:
        for rule, part in zip(self._rules, self._parts(values), strict=True):
            rule.put(where(rule.carried), part)
