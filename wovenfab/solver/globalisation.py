"""Step lengths and the end of Newton's method.

``CrossingLimit``: the shear energy has a pole where the families align, but is finite again
beyond it. A state is admissible if f_1 × f_2 keeps its initial sign at every quadrature point of
cells and facets; along a Newton direction that is a quadratic in the step length, whose first
root is the limit.

``LineSearch``: backtracking on the potential (Armijo). ``Convergence``: when forces balance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import basix
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from wovenfab.forms.kinematics import point_of, point_variation
from wovenfab.model.assembly import compile_expressions
from wovenfab.model.memory import attributes, take_attributes
from wovenfab.model.model import Model, preserved
from wovenfab.solver.problem import Problem

Reason = PETSc.SNES.ConvergedReason
Array = NDArray[np.float64]
#: Value of f_1 × f_2 that counts as aligned. Round-off of positions of 1 m on cells of
#: 0.1 mm is some 1e-11 of it, and Newton would need dozens of steps to come back from there.
ALIGNED = 1e-9
#: Largest length of a step over that at which the families cross.
CROSSING_SHARE = 0.9


def first_crossing(f: Array, df: Array, orientation: float) -> Array:
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
    return np.where(c > ALIGNED, np.where(real, limit, np.inf), 0.0)


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


class CrossingLimit:
    """The sign of f_1 × f_2 at the quadrature points of a model.

    Attributes:
        direction: The direction that was evaluated last, m; scratch space.
        points: Reference points of a cell, shape (n, 2).
    """

    def __init__(self, model: Model) -> None:
        """Compile the evaluation of f_1 and f_2 for the model's field and for directions."""
        self._mesh = mesh = model.sheet.mesh
        fibres = model.balance.fibres
        self._comm, self._own = mesh.comm, model.placements.owned
        self._orientation = float(np.sign(np.linalg.det(model.sheet.fibres)))
        self.direction = fem.Function(model.space)
        self.points = quadrature_points(model.balance.quadrature, model.balance.second_gradient)
        self._cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        state = point_of(model.field, fibres, False).f
        change = point_variation(self.direction, fibres, False)[:2]
        self._state, self._change = compile_expressions([_flat(state), _flat(change)], self.points)

    def derivatives(self, direction: Array) -> tuple[Array, Array]:
        """Return f_1, f_2 and their changes along a direction at all own points, (n, 2, 2).

        Args:
            direction: Change of this rank's own unknowns at least, m.
        """
        own = self._own
        self.direction.x.array[:own] = direction[:own]
        self.direction.x.scatter_forward()
        return self._evaluate(self._state), self._evaluate(self._change)

    def limit(self, direction: Array) -> float:
        """Return the step length s (of ``field + s direction``) at which families first align.

        Collective; infinite if they never do.

        Args:
            direction: Change of this rank's own unknowns at least, m.
        """
        crossings = first_crossing(*self.derivatives(direction), self._orientation)
        mine = float(crossings.min(initial=np.inf))
        return float(self._comm.allreduce(mine, op=MPI.MIN))

    def margin(self) -> float:
        """Return the smallest (f_1 × f_2)/(|f_1||f_2|) in the present state; collective."""
        return float(self._comm.allreduce(float(self.margins().min(initial=np.inf)), op=MPI.MIN))

    def margins(self) -> Array:
        """Return (f_1 × f_2)/(|f_1||f_2|) at all points, shape (own cells, points)."""
        f = self._evaluate(self._state)
        sines = self._orientation * _cross(f[:, 0], f[:, 1])
        sines = sines / np.linalg.norm(f, axis=2).prod(axis=1)
        return sines.reshape(-1, len(self.points))

    def motion(self, direction: Array) -> Array:
        """Return the change of f_1 and f_2 along a direction (norm), shape (own cells, points)."""
        sizes: Array = np.linalg.norm(self.derivatives(direction)[1], axis=(1, 2))
        return sizes.reshape(-1, len(self.points))

    def _evaluate(self, expression: fem.Expression) -> Array:
        values: Array = expression.eval(self._mesh, self._cells)
        return values.reshape(-1, 2, 2)


def quadrature_points(degree: int, facets: bool) -> Array:
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


#: The constant of sufficient decrease.
DECREASE = 1e-4
#: A shorter step counts as a failure: near the crossing the next one would be still shorter.
SHORTEST = 1e-4
#: Share of its gain by which a full step may raise the potential over the lowest so far.
LOOSE = 0.1


class LineSearch:
    """Line searches on the potential, for the steps of one solve after the other.

    Attributes:
        potential: That of the present iterate (J), where it is known.
        decrement: Energy that the last step gains by its slope if it was a full one, J.
        failures: Searches in a row that found no lower potential.
    """

    def __init__(self, problem: Problem) -> None:
        """Search on the potential of a problem."""
        self._problem = problem
        self.potential: float | None = None
        self.decrement, self.failures = np.inf, 0
        self._lowest = np.inf  # potential of an iterate of this solve, J

    def begin(self) -> None:
        """Begin a solve."""
        self.forget()
        self.failures = 0

    def forget(self) -> None:
        """Forget the potentials: the next iterate is not the end of a search."""
        self.potential, self.decrement, self._lowest = None, np.inf, np.inf

    def note(self, length: float) -> None:
        """Count a step of a length that was found, by this search or another one."""
        self.failures = self.failures + 1 if length < SHORTEST else 0

    def measure(self) -> float:
        """Evaluate and return the potential (J) of the model's present field; collective."""
        self.potential = self._problem.energy()
        return self.potential

    def along(
        self,
        direction: Array,
        slope: float,
        length: float,
        roundoff: Callable[[float], float],
        loose: bool = False,
    ) -> float:
        """Return a length of a step with sufficient decrease; collective.

        Soft motions of stiff yarns go along curved valleys of the potential. A full step leaves
        them and rises a little; the next step returns to them much farther down (the watchdog
        technique: Chamberlain, Powell, Lemarechal and Pedersen, 1982).

        Args:
            direction: The step, of this rank's own unknowns, m.
            slope: Decrease of the potential per unit length at the iterate, J.
            length: First length to try.
            roundoff: Returns the rounding error of a potential (J), J.
            loose: Whether a full step may rise a little from the lowest potential so far.
        """
        field, own = self._problem.model.field, len(direction)
        start = field.x.array[:own].copy()
        before = self.measure() if self.potential is None else self.potential
        self._lowest = min(self._lowest, before)
        loose = loose and length == 1.0 and before == self._lowest
        rise = LOOSE * slope if loose else -np.inf

        def potential(at: float) -> float:
            field.x.array[:own] = start + at * direction
            field.x.scatter_forward()
            return self._problem.energy()

        with preserved(field):
            length, self.potential = backtrack(
                potential, before, slope, length, roundoff(before), rise
            )
        self.note(0.0 if self.potential is None else length)
        risen = self.potential is not None and self.potential > before + roundoff(before)
        self.decrement = abs(slope) if length == 1.0 and not risen else np.inf
        return length


def backtrack(
    potential: Callable[[float], float],
    start: float,
    slope: float,
    length: float,
    roundoff: float,
    rise: float = -np.inf,
) -> tuple[float, float | None]:
    """Return a step length with sufficient decrease, and the potential there.

    Args:
        potential: Returns the potential (J) at a length; collective.
        start: That at length zero, J.
        slope: Its decrease per unit length there, J.
        length: First length to try.
        roundoff: Increase by rounding alone, J.
        rise: Increase that the first length may bring, J.

    Returns:
        The length, halved as often as needed, and the potential; None where none falls.
    """
    while True:
        energy = potential(length)
        most = start + max(rise, -DECREASE * length * slope) + roundoff
        if np.isfinite(energy) and energy <= most:
            return length, energy
        length, rise = length / 2, -np.inf
        if length < SHORTEST:
            return length, None


EPSILON = float(np.finfo(np.float64).eps)
#: A change of the potential below this share of it is round-off, not an increase.
ROUND_OFF = 1e-12


#: What the judgement of later residuals depends on.
MEMORY = "_force", "_energy", "_stiffness", "_position_roundoff"


class Convergence:
    """Judges residuals and steps of Newton's method.

    Strains are differences of displacements. Their rounding error is that of the displacement,
    or of the cell size where that is larger; times the tangent it is that of the forces.
    """

    def __init__(self, tolerance: float, cell_size: float, unknowns: int = 1) -> None:
        """Begin without any equilibrium.

        Args:
            tolerance: Residual force over the largest force met so far.
            cell_size: That of the largest cell, m.
            unknowns: Number of unknowns.
        """
        self._tolerance = tolerance
        self._cell_size, self._unknowns = cell_size, unknowns
        # Largest force (N) and energy (J) of an equilibrium so far.
        self._force = self._energy = 0.0
        # Size of the tangent (N/m), and rounding error of positions (m).
        self._stiffness = self._position_roundoff = 0.0

    def snapshot(self) -> dict[str, Any]:
        """Return the largest force and energy, and what rounding errors follow from."""
        return attributes(self, *MEMORY)

    def resume(self, snapshot: Mapping[str, Any]) -> None:
        """Go on with those of a snapshot."""
        take_attributes(self, snapshot, *MEMORY)

    def measure(self, stiffness: float, farthest: float) -> None:
        """Note the size of a tangent (N/m) and the largest displacement (m) it was formed at."""
        self._stiffness = stiffness
        self._position_roundoff = EPSILON * max(farthest, self._cell_size)

    def accept(self, force: float, energy: float) -> None:
        """Note an equilibrium's norm of the internal force (N) and its potential (J)."""
        self._force = max(self._force, force)
        self._energy = self.scale_of(energy)

    def scale_of(self, energy: float) -> float:
        """Return the largest energy (J) of an equilibrium so far, and of this state."""
        return max(self._energy, abs(energy))

    def energy_roundoff(self, energy: float) -> float:
        """Return the rounding error of a potential (J), J.

        An energy k x²/2 is uncertain by k x dx, and no less by the rounding of its sum.
        """
        by_positions = self._position_roundoff * np.sqrt(2 * abs(energy) * self._stiffness)
        return float(max(ROUND_OFF * self.scale_of(energy), by_positions))

    def reason(
        self,
        residual: float,
        force: float,
        decrement: float | None,
        energy: float,
    ) -> int | None:
        """Return PETSc's reason to end, or None where forces do not balance yet.

        Newton's decrement is twice the energy that a step gains; convergence is quadratic, so
        a step of relative energy ``tolerance`` leaves its square.

        Rounding at a few stiff nodes, as those of a sliver, may exceed all other forces, whose
        balance the residual then does not show. It has next to no energy, so that the decrement
        judges alone.

        Args:
            residual: Norm of the forces that do not balance, N.
            force: Norm of the internal force, N.
            decrement: That of the last step if it was a full one, otherwise infinite, J; None
                where it is not measured.
            energy: Potential, J.
        """
        largest = max(self._force, force)
        small = np.sqrt(self._tolerance) * largest
        rounding = self._position_roundoff * self._stiffness
        enough = rounding if decrement is None else min(rounding, small)
        if residual <= max(self._tolerance * largest, enough):
            return int(Reason.CONVERGED_FNORM_RELATIVE)
        if decrement is None:
            return None
        least = self._tolerance * self.scale_of(energy)
        # Positions that are rounded have an energy, which is all that there is at rest: at most
        # the sum of the tangent's diagonal, which its norm bounds, times their error squared.
        least = max(least, np.sqrt(self._unknowns) * rounding * self._position_roundoff)
        if decrement <= least and residual <= max(small, rounding):
            return int(Reason.CONVERGED_SNORM_RELATIVE)
        return None


def largest_cell(mesh: Any) -> float:
    """Return the size of the largest cell of a mesh, m; collective."""
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    return float(mesh.comm.allreduce(mesh.h(2, cells).max(initial=0.0), op=MPI.MAX))
