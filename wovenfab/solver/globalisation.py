"""Keeping the two families from crossing.

The shear energy has a pole where the families align, but is finite again beyond
it. A state is admissible if f_1 × f_2 keeps its initial sign at every quadrature
point of cells and facets; along a Newton direction that is a quadratic in the
step length, whose first root is the limit.

The search for a lower potential along Newton's steps, by backtracking (Armijo).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray

from forms.kinematics import point_of, point_variation
from wovenfab.model.compiler import compile_expression
from wovenfab.model.model import Model, preserved
from wovenfab.solver.problem import Problem

#: Value of f_1 × f_2 that counts as on the barrier. Round-off of positions of 1 m on cells of
#: 0.1 mm is some 1e-11 of it, and Newton would need dozens of steps to come back from there.
ON_BARRIER = 1e-9
#: Share of the way to the crossing that a step may take.
CROSSING_SHARE = 0.9


def first_crossing(
    f: NDArray[np.float64], df: NDArray[np.float64], orientation: float
) -> NDArray[np.float64]:
    """Return the step length at which the two families first align at each point.

    Args:
        f: Fibre derivatives (f_1, f_2), shape (n, 2, 2).
        df: Their change for a full step, shape (n, 2, 2).
        orientation: +1 or -1, sign of f_1 × f_2 in the reference state.

    Returns:
        Smallest positive root of (f_1 + s df_1) × (f_2 + s df_2) = 0, shape (n,);
        infinite where there is none.
    """
    c = orientation * _cross(f[:, 0], f[:, 1])
    b = orientation * (_cross(df[:, 0], f[:, 1]) + _cross(f[:, 0], df[:, 1]))
    a = orientation * _cross(df[:, 0], df[:, 1])
    # Roots of a s² + b s + c with c > 0, in the form 2c/(-b ± r) that neither divides
    # by a vanishing a nor cancels: the smaller positive root has the larger denominator.
    root = np.sqrt(np.maximum(b * b - 4 * a * c, 0.0))
    real = b * b - 4 * a * c >= 0
    below = np.where(b <= 0, -b + root, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        falling = np.where(below > 0, 2 * c / below, np.inf)
        # b > 0: a positive root only if a < 0, then it is (b + r)/(-2a).
        rising = np.where((b > 0) & (a < 0), (b + root) / (-2 * a), np.inf)
    limit = np.where(b <= 0, falling, rising)
    return np.where(c > ON_BARRIER, np.where(real, limit, np.inf), 0.0)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


@dataclass(frozen=True)
class _Probe:
    """Fibre derivatives of a field at all quadrature points."""

    expression: fem.Expression
    cells: NDArray[np.int32]
    mesh: Any

    def values(self) -> NDArray[np.float64]:
        found: NDArray[np.float64] = self.expression.eval(self.mesh, self.cells)
        return found.reshape(-1, 2, 2)


class CrossingLimit:
    """Watches the sign of f_1 × f_2 at the quadrature points of a model.

    Attributes:
        direction: Change of the model's field that was judged last, m.
        points: Reference points of a cell, shape (n, 2).
    """

    def __init__(self, model: Model) -> None:
        """Compile the evaluation of f_1 and f_2 for the model's field and for steps."""
        mesh = model.sheet.mesh
        fibres = model.balance.fibres
        self._comm, self._own = mesh.comm, model.placements.owned
        self._orientation = float(np.sign(np.linalg.det(model.sheet.fibres)))
        self.direction = fem.Function(model.space)
        self.points = quadrature_points(model.balance.quadrature, model.balance.second_gradient)
        cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        self._state = _Probe(
            compile_expression(_flat(point_of(model.field, fibres, False).f), self.points),
            cells,
            mesh,
        )
        self._change = _Probe(
            compile_expression(
                _flat(point_variation(self.direction, fibres, False)[:2]), self.points
            ),
            cells,
            mesh,
        )

    def derivatives(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return f_1, f_2 and their changes by ``direction`` at all own points, shape (n, 2, 2)."""
        return self._state.values(), self._change.values()

    def limit(self, direction: NDArray[np.float64]) -> float:
        """Return the step length s (of ``field + s direction``) at which families first align.

        Collective; infinite if they never do.

        Args:
            direction: Change of this rank's own unknowns at least, m.
        """
        own = self._own
        self.direction.x.array[:own] = direction[:own]
        self.direction.x.scatter_forward()
        crossings = first_crossing(*self.derivatives(), self._orientation)
        mine = float(crossings.min(initial=np.inf))
        return float(self._comm.allreduce(mine, op=MPI.MIN))

    def margin(self) -> float:
        """Return the smallest (f_1 × f_2)/(|f_1||f_2|) in the present state; collective."""
        return float(self._comm.allreduce(float(self.margins().min(initial=np.inf)), op=MPI.MIN))

    def margins(self) -> NDArray[np.float64]:
        """Return (f_1 × f_2)/(|f_1||f_2|) at all points, shape (own cells, points)."""
        f = self._state.values()
        sines = self._orientation * _cross(f[:, 0], f[:, 1])
        sines = sines / np.linalg.norm(f, axis=2).prod(axis=1)
        return sines.reshape(-1, len(self.points))

    def motion(self) -> NDArray[np.float64]:
        """Return how much ``direction`` changes f_1 and f_2 (norm), shape (own cells, points)."""
        sizes: NDArray[np.float64] = np.linalg.norm(self._change.values(), axis=(1, 2))
        return sizes.reshape(-1, len(self.points))


def quadrature_points(degree: int, facets: bool) -> NDArray[np.float64]:
    """Return the reference points, shape (n, 2), of the cell rule and of all three facets."""
    inside = basix.make_quadrature(basix.CellType.triangle, degree)[0]
    if not facets:
        return np.asarray(inside)
    line = basix.make_quadrature(basix.CellType.interval, degree)[0]
    corners = basix.geometry(basix.CellType.triangle)
    sides = [(1, 2), (0, 2), (0, 1)]
    on_facets = [corners[i] + line * (corners[j] - corners[i]) for i, j in sides]
    return np.vstack([inside, *on_facets])


def _flat(pair: Any) -> Any:
    return ufl.as_vector([component for f in pair for component in (f[0], f[1])])


#: Largest number of halvings, and the constant of sufficient decrease.
HALVINGS = 14
DECREASE = 1e-4
#: A shorter step finds nothing either: the next one would be as short, at the barrier shorter.
SHORTEST = 1e-4
#: Share of its gain by which a whole step may raise the potential over the lowest so far.
LOOSE = 0.1


class LineSearch:
    """Searches along the steps of one solve after the other.

    Attributes:
        potential: That of the present iterate (J), where it is known.
        decrement: Energy that the last step gains by its slope if it was a full one, J.
        failures: Searches in a row that found no lower potential.
    """

    def __init__(self, system: Problem, barrier: CrossingLimit) -> None:
        """Search the potential of a system along the step of a barrier."""
        self._system, self._barrier = system, barrier
        self.potential: float | None = None
        self.decrement, self.failures = np.inf, 0
        self._lowest = np.inf  # potential of an iterate of this solve, J

    def begin(self) -> None:
        """Begin a solve."""
        self.forget()
        self.failures = 0

    def forget(self) -> None:
        """Know nothing of an iterate that no search has led to."""
        self.potential, self.decrement, self._lowest = None, np.inf, np.inf

    def measure(self) -> float:
        """Return the potential (J) of the model's present field, and know it; collective."""
        self.potential = self._system.energy()
        return self.potential

    def along(
        self, slope: float, length: float, noise: Callable[[float], float], loose: bool = False
    ) -> float:
        """Return a length of the barrier's step with sufficient decrease; collective.

        Soft motions of stiff yarns go along curved valleys of the potential. A whole step leaves
        them, and rises a little; the next one, which knows the stress that the first one meant,
        returns to them much farther down (the watchdog technique: Chamberlain, Powell, Lemarechal
        and Pedersen, 1982).

        Args:
            slope: Decrease of the potential per unit length at the iterate, J.
            length: First length to try.
            noise: Returns by how much a potential (J) may seem to rise by rounding alone, J.
            loose: Whether a whole step may rise a little from the lowest potential so far.
        """
        model, step = self._system.model, self._barrier.direction
        field, start = model.field.x.array, model.field.x.array.copy()
        before = self.measure() if self.potential is None else self.potential
        self._lowest = min(self._lowest, before)
        loose = loose and length == 1.0 and before == self._lowest
        rise = LOOSE * slope if loose else -np.inf

        def potential(at: float) -> float:
            field[:] = start + at * step.x.array
            return self._system.energy()

        with preserved(model.field):
            length, self.potential = backtrack(
                potential, before, slope, length, noise(before), rise
            )
        lost = self.potential is None or length < SHORTEST
        self.failures = self.failures + 1 if lost else 0
        risen = self.potential is not None and self.potential > before + noise(before)
        self.decrement = abs(slope) if length == 1.0 and not risen else np.inf
        return length


def backtrack(
    potential: Callable[[float], float],
    start: float,
    slope: float,
    length: float,
    noise: float,
    rise: float = -np.inf,
) -> tuple[float, float | None]:
    """Return a step length with sufficient decrease, and the potential there.

    Args:
        potential: Returns the potential (J) at a length; collective.
        start: That at length zero, J.
        slope: Its decrease per unit length there, J.
        length: First length to try.
        noise: Increase that rounding alone may feign, J.
        rise: Increase that the first length may bring, J.

    Returns:
        The length, halved as often as needed, and the potential; None where none falls.
    """
    for _ in range(HALVINGS):
        found = potential(length)
        if np.isfinite(found) and found <= start + max(rise, -DECREASE * length * slope) + noise:
            return length, found
        length, rise = length / 2, -np.inf
    return length, None
