"""Dead loads: forces per length of an edge that keep their direction as the sheet deforms.

Held placements: which unknowns each edge prescribes, and the forces there. Conditions are made by
:func:`clamp`, :func:`move` and :func:`load`, or from Dirichlet conditions of dolfinx.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
import ufl
from dolfinx import fem, la
from mpi4py import MPI
from numpy.typing import NDArray
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.constantvalue import Zero

from wovenfab.forms.balance import Load
from wovenfab.model.assembly import compile_forms
from wovenfab.model.corners import Claim, corner_shares
from wovenfab.model.spaces import Placements
from wovenfab.sheet.sheet import Sheet

Array = NDArray[np.float64]
#: Imaginary change of the program, m: the derivative is exact to rounding whatever its size.
#: Source: Squire and Trapp, Using complex variables to estimate derivatives of real functions
#: (1998), doi:10.1137/S003614459631241X.
COMPLEX_STEP = 1e-40
#: Rounding error of displacements over the largest one.
ROUNDING = 1e-12
#: A component of a load: a number, a UFL expression, or a function of position and programs (UFL in
#: and out).
Force = Any


@dataclass(frozen=True)
class EdgeLoad:
    """A dead force per reference length on an edge.

    Attributes:
        edge: Name of the edge.
        families: 0, 1 or both, which then share the load.
        force: x and y component, N/m.
    """

    edge: str
    families: tuple[int, ...]
    force: tuple[Force, Force]


@dataclass(frozen=True)
class DeadLoads:
    """The dead loads of a scene as they act now.

    Attributes:
        program, second: The programs (m), on which loads may depend.
        share: Share of the loads that acts; 1 but on the way to the start of a program.
        loads: The loads as symbols.
        form: Compiled form of their force; None without loads.
        change: Compiled form of its derivative by the program; None where they do not follow it.
    """

    program: fem.Constant
    second: fem.Constant
    share: fem.Constant
    loads: tuple[Load, ...]
    form: fem.Form | None
    change: fem.Form | None
    _own: int

    def set(self, program: float, share: float = 1.0) -> None:
        """Let the loads act that belong to a program value (m), or a share of them."""
        self.program.value, self.share.value = program, share

    def rate(self) -> NDArray[np.float64]:
        """Return the change of the force with the program (N/m) at own unknowns; collective."""
        return self._assembled(self.change)

    def force(self) -> NDArray[np.float64]:
        """Return the force (N) of all loads at this rank's own unknowns; collective."""
        return self._assembled(self.form)

    def _assembled(self, form: fem.Form | None) -> NDArray[np.float64]:
        if form is None:
            return np.zeros(self._own)
        vector = fem.assemble_vector(form)
        vector.scatter_reverse(la.InsertMode.add)
        force: NDArray[np.float64] = vector.array[: self._own].copy()
        return force


def dead_loads_on(
    space: fem.FunctionSpace, loads: Sequence[EdgeLoad], on_edge: Callable[[str], Any]
) -> DeadLoads:
    """Return the compiled loads; collective.

    Args:
        space: Space of 2 components a placement.
        loads: Dead loads on edges.
        on_edge: Returns the UFL measure of a named edge.
    """
    mesh = space.mesh
    program, second, share = (fem.Constant(mesh, np.float64(v)) for v in (0.0, 0.0, 1.0))
    position = ufl.SpatialCoordinate(mesh)

    at = ufl.variable(program)

    def component(force: Force) -> Any:
        if isinstance(force, ufl.core.expr.Expr):
            return share * force
        if callable(force):
            return share * force(position, at, second)
        return share * fem.Constant(mesh, np.float64(force))

    def changed(load: EdgeLoad) -> Any:
        follows = (callable(f) and not isinstance(f, ufl.core.expr.Expr) for f in load.force)
        rates = (
            ufl.diff(component(f), at) if moves else 0
            for f, moves in zip(load.force, follows, strict=True)
        )
        return apply_derivatives(ufl.as_vector(list(rates)))

    def symbol(load: EdgeLoad, vector: Any) -> Load:
        return Load(vector, load.families, on_edge(load.edge))

    symbols = tuple(symbol(load, ufl.as_vector(list(map(component, load.force)))) for load in loads)
    changes = [(load, changed(load)) for load in loads]
    changes = [(load, change) for load, change in changes if not isinstance(change, Zero)]
    test = ufl.TestFunction(space)
    works = [
        [load.work(test) for load in symbols],
        [symbol(load, change).work(test) for load, change in changes],
    ]
    compiled = iter(compile_forms([sum(work) for work in works if work], mesh.comm))
    form, change = (next(compiled) if work else None for work in works)
    own = space.dofmap.index_map.size_local * space.dofmap.index_map_bs
    return DeadLoads(program, second, share, symbols, form, change, own)


@dataclass(frozen=True)
class Held:
    """A prescribed component: displacement = factor · program + offset, or a field.

    Attributes:
        factor: Multiple of the program.
        offset: Constant part, m.
        field: Displacement (m) against x, y (m) and both programs (m), instead of both; it is
            analytic in the programs, which may be complex.
        driven: Whether the program moves it where it has a field.
    """

    factor: float = 0.0
    offset: float = 0.0
    field: Callable[[Array, Array, complex, complex], Array] | None = None
    driven: bool = True

    @property
    def moves(self) -> bool:
        """Whether the program moves it."""
        return self.driven if self.field else self.factor != 0

    def __rmul__(self, factor: float) -> Held:
        """Return a multiple of the displacement."""
        if self.field is None:
            return Held(factor * self.factor, factor * self.offset)
        own = self.field
        return Held(field=lambda *at: factor * own(*at), driven=self.driven)

    def __neg__(self) -> Held:
        """Return the opposite displacement."""
        return -1.0 * self

    def at(self, positions: Array, program: complex, second: complex = 0.0) -> Array:
        """Return the displacement (m) at reference positions, shape (n, 2 or 3)."""
        x, y = positions[:, 0], positions[:, 1]
        value = self.factor * program + self.offset
        return np.broadcast_to(self.field(x, y, program, second) if self.field else value, x.shape)

    def rate(self, positions: Array, program: float, second: float = 0.0) -> Array:
        """Return the change of the displacement with the program (1) at reference positions."""
        after = self.at(positions, program + 1j * COMPLEX_STEP, second)
        return np.asarray(np.imag(after) / COMPLEX_STEP)


@dataclass(frozen=True)
class Grip:
    """How an edge is held.

    Attributes:
        edge: Name of the edge.
        components: For x and y how it is held, or None where it is free.
        families: 0, 1 or both.
        rotation: Whether the yarn directions there are held as they were at rest.
    """

    edge: str
    components: tuple[Held | None, Held | None] = (None, None)
    families: tuple[int, ...] = (0, 1)
    rotation: bool = False


#: What may be prescribed on an edge.
Condition = Grip | EdgeLoad
#: The displacement (m) of the program itself.
PROGRAM = Held(1.0)
#: A prescribed displacement: a number (m), a multiple of the program, a function of x, y (m) and
#: both programs (m), or None where the edge is free.
Displacement = float | Held | Callable[[Array, Array, complex, complex], Array] | None


def clamp(edge: str, rotation: bool = False, families: Sequence[int] = (1, 2)) -> Grip:
    """Return the condition that an edge does not move.

    Args:
        edge: Name of the edge.
        rotation: Whether the yarn directions there are held, too.
        families: Families 1, 2 or both.
    """
    return move(edge, (0.0, 0.0), rotation, families)


def move(
    edge: str,
    displacement: tuple[Displacement, Displacement],
    rotation: bool = False,
    families: Sequence[int] = (1, 2),
) -> Grip:
    """Return the condition that an edge is moved.

    Args:
        edge: Name of the edge.
        displacement: Along x and y: a number (m), ``PROGRAM`` or a multiple of it, a function of
            x, y (m) and both programs (m, complex: it must be analytic), or None for free.
        rotation: Whether the yarn directions there are held, too.
        families: Families 1, 2 or both.
    """
    x, y = map(_held, displacement)
    return Grip(edge, (x, y), _numbers(families), rotation)


def load(edge: str, force: tuple[Force, Force], families: Sequence[int] = (1, 2)) -> EdgeLoad:
    """Return the condition that a dead force acts on an edge.

    Args:
        edge: Name of the edge.
        force: Along x and y per length at rest (N/m): numbers, UFL expressions, or functions of
            position and programs (UFL in and out).
        families: Families 1, 2 or both, which then share it.
    """
    return EdgeLoad(edge, _numbers(families), force)


def _held(displacement: Displacement) -> Held | None:
    if displacement is None or isinstance(displacement, Held):
        return displacement
    return Held(field=displacement) if callable(displacement) else Held(offset=displacement)


def _numbers(families: Sequence[int]) -> tuple[int, ...]:
    """Return families as they are counted from 0."""
    if not families or set(families) - {1, 2}:
        raise ValueError(f"families are 1, 2 or both, not {families}")
    return tuple(family - 1 for family in families)


class _Given:
    """Displacements of a Dirichlet condition of dolfinx, whose values may change in time."""

    moves = False

    def __init__(self, bc: fem.DirichletBC, dofs: NDArray[np.int32], size: int) -> None:
        self._bc, self._dofs, self._values = bc, dofs, np.zeros(size)

    def at(self, positions: Array, program: complex, second: complex = 0.0) -> Array:
        """Return the displacement (m) at the unknowns, which are not at new positions."""
        self._bc.set(self._values)
        return self._values[self._dofs]

    def rate(self, positions: Array, program: float, second: float = 0.0) -> Array:
        """Return the change with the program: none."""
        return np.zeros(len(self._dofs))


@dataclass(frozen=True)
class _Part:
    """One component of one placement on one edge.

    Attributes:
        dofs: Its unknowns on this rank, ghosts included.
        owned: Those that the rank owns.
        positions: Reference positions of ``dofs``, shape (n, 2), m.
    """

    edge: str
    component: int
    held: Held | _Given
    dofs: NDArray[np.int32]
    owned: NDArray[np.int32]
    positions: Array


class Constraints:
    """The prescribed placements of a scene.

    An unknown that two edges hold (a corner) is prescribed by the edge named first; its reaction
    is divided between both (:mod:`wovenfab.model.corners`).

    Attributes:
        bcs: Boundary conditions for dolfinx: the same for the space of both placements and
            for that of each; each form takes those of its own space.
        own: Unknowns that are prescribed and that this rank owns.
        edges: Names of the edges that hold anything.
        origin: Displacements that prescribed ones are added to: those of the state that the
            program starts from, m.
        second: Value of the second program, m.
    """

    def __init__(
        self,
        placements: Placements,
        sheet: Sheet,
        grips: Sequence[Grip],
        given: Mapping[str, fem.DirichletBC] | None = None,
    ) -> None:
        """Find the unknowns that each grip holds; collective.

        Args:
            placements: The unknowns.
            sheet: The sheet with its named edges.
            grips: How edges are held.
            given: Dirichlet conditions of dolfinx for the space of both placements, or of one, by
                names under which their reactions are recorded. Unknowns that grips hold stay
                theirs.
        """
        self._comm = sheet.mesh.comm
        self.edges = tuple(dict.fromkeys([*(grip.edge for grip in grips), *(given or ())]))
        self._values = fem.Function(placements.space)
        self.origin = np.zeros(self._values.x.array.size)
        self.second = 0.0
        self._parts = _parts(placements, sheet, grips, given or {})
        every = [part.dofs for part in self._parts] or [np.array([], dtype=np.int32)]
        dofs = np.sort(np.concatenate(every))
        self.bcs = [
            fem.dirichletbc(fem.Function(space, self._values.x), [dofs, dofs], space)
            for space in placements.spaces
        ]
        self.own = np.concatenate([part.owned for part in self._parts] or [dofs])
        self._own = placements.owned
        self._shares = corner_shares(placements, sheet, _claims(placements, grips))

    def set(self, program: float, share: float = 1.0) -> None:
        """Prescribe the placements for a program value (m), or a share of them; collective.

        The rank that owns an unknown decides: ranks round its position, and so a formula of
        it, differently, and a field that comes from the owner would never be equal to it.
        """
        for part in self._parts:
            held = share * part.held.at(part.positions, program, self.second)
            self._values.x.array[part.dofs] = self.origin[part.dofs] + held
        self._values.x.scatter_forward()

    def rate(self, program: float) -> Array:
        """Return the change of prescribed displacements with the program, zero elsewhere (1)."""
        change = np.zeros(self._values.x.array.size)
        for part in self._parts:
            change[part.dofs] = part.held.rate(part.positions, program, self.second)
        return change

    def virtual_displacement(self, program: float, load: Array) -> Array:
        """Return the displacements (1) on which the work of reactions is the recorded force.

        They are the derivatives of prescribed displacements by the program. Where it moves no edge,
        they are the prescribed displacements over the largest one or, where these are zero, a
        translation of all held unknowns against the resultant of the dead loads. Collective.

        Args:
            program: Value of the program, m.
            load: Dead loads at this rank's own unknowns, N.
        """
        if any(part.held.moves for part in self._parts) or not self._parts:
            return self.rate(program)
        given = np.zeros(self._values.x.array.size)
        for part in self._parts:
            given[part.dofs] = part.held.at(part.positions, program, self.second)
        squares = np.square(given.reshape(-1, 2)).sum(axis=1)
        largest = self._comm.allreduce(float(np.sqrt(squares.max(initial=0.0))), op=MPI.MAX)
        if largest:
            return np.asarray(given / largest)
        resultant = self._comm.allreduce(load.reshape(-1, 2).sum(axis=0))
        if size := float(np.hypot(*resultant)):
            for part in self._parts:
                given[part.dofs] = -resultant[part.component] / size
        return given

    def conjugate(self, force: Array, virtual: Array) -> tuple[float, float]:
        """Return the work (N) of reactions on virtual displacements, and on these turned.

        With those of :meth:`virtual_displacement` the first one is the force that is conjugate to
        the program: its integral over the program is the work of the edges. For the second one,
        the force across it, they are turned by 90 degrees. Collective.

        Args:
            force: Internal force at this rank's own unknowns, N.
            virtual: Displacements of unknowns with ghosts (1).
        """
        v, held = virtual[: len(force)].reshape(-1, 2), np.zeros(len(force))
        held[self.own] = force[self.own]
        x, y = held.reshape(-1, 2).T
        mine = np.array([x @ v[:, 0] + y @ v[:, 1], y @ v[:, 0] - x @ v[:, 1]])
        along, across = self._comm.allreduce(mine)
        return float(along), float(across)

    def travel(self, program: float, start: float) -> float:
        """Return by how much the held edges move against each other (m); collective.

        It is the largest distance by which two held points move towards or away from each other
        or past each other, counted in the components in which both are held.

        Args:
            program: Value of the program at the end, m.
            start: Value at the start, m.
        """
        moved = np.full(self._values.x.array.size, np.nan)
        for part in self._parts:
            end, begin = (part.held.at(part.positions, p, self.second) for p in (program, start))
            moved[part.dofs] = end - begin
        mine = moved[: self._own].reshape(-1, 2)
        points = np.unique(mine[~np.isnan(mine).all(axis=1)], axis=0)
        points = np.unique(np.concatenate(self._comm.allgather(points)), axis=0)
        spans = [np.ptp(c[~np.isnan(c)]) for c in points.T if not np.isnan(c).all()]
        both = points[~np.isnan(points).any(axis=1)]
        if len(both) > 1:
            hull = shapely.MultiPoint(both).convex_hull
            corners = shapely.get_coordinates(hull)
            spans.append(np.linalg.norm(corners[:, None] - corners, axis=2).max())
        largest = max(spans, default=0.0)
        return float(largest or np.nan_to_num(np.abs(points)).max(initial=0.0))

    @contextmanager
    def prescribed(self, values: Array) -> Iterator[list[fem.DirichletBC]]:
        """Yield boundary conditions that prescribe other values; the present ones return."""
        before = self._values.x.array.copy()
        self._values.x.array[:] = values
        try:
            yield self.bcs
        finally:
            self._values.x.array[:] = before

    def reactions(self, force: Array) -> dict[str, tuple[float, float]]:
        """Return the force (N) that each edge exerts on the sheet, x and y.

        Args:
            force: Internal force at this rank's own unknowns (residual before
                boundary conditions), N.
        """
        total = np.zeros((len(self.edges), 2))
        for part in self._parts:
            total[self.edges.index(part.edge), part.component] += force[part.owned].sum()
        for share in self._shares:
            moved = float(share.weights @ force[share.unknowns])
            total[self.edges.index(share.taken), share.component] -= moved
            total[self.edges.index(share.given), share.component] += moved
        total = self._comm.allreduce(total)
        return {
            name: (float(fx), float(fy)) for name, (fx, fy) in zip(self.edges, total, strict=True)
        }

    def work(self, force: Array, displacement: Array) -> float:
        """Return the work (J) of forces on displacement increments at held unknowns.

        Args:
            force: Internal force at this rank's own unknowns, N.
            displacement: Increment of displacement there, m.
        """
        mine = sum(float(force[p.owned] @ displacement[p.owned]) for p in self._parts)
        return float(self._comm.allreduce(mine))

    def complete(self, field: fem.Function) -> None:
        """Give a field that has the prescribed values up to rounding exactly these; collective.

        So has a state of elements of another degree.
        """
        held = np.concatenate([part.dofs for part in self._parts] or [self.own])
        values = self._values.x.array[held]
        misses = np.abs(field.x.array[held] - values).max(initial=0.0)
        sizes = np.array([misses, np.abs(values).max(initial=0.0)])
        self._comm.Allreduce(MPI.IN_PLACE, sizes, op=MPI.MAX)
        if sizes[0] <= ROUNDING * sizes[1]:
            field.x.array[held] = values

    def unmet(self, field: fem.Function) -> bool:
        """Return whether any prescribed value is not yet attained; same on all ranks."""
        mine = any(
            not np.array_equal(field.x.array[p.dofs], self._values.x.array[p.dofs])
            for p in self._parts
        )
        return bool(self._comm.allreduce(int(mine)))


def _claims(placements: Placements, grips: Sequence[Grip]) -> list[Claim]:
    """Return what each grip holds, in the order in which unknowns are given to them."""
    return [
        Claim(grip.edge, family, component)
        for grip in grips
        for family in (grip.families if placements.count == 2 else (0,))
        for component in (0, 1)
        if grip.components[component] is not None
    ]


def _parts(
    placements: Placements,
    sheet: Sheet,
    grips: Sequence[Grip],
    given: Mapping[str, fem.DirichletBC],
) -> list[_Part]:
    """Return what each condition holds, each unknown in one part only; collective."""
    taken = np.zeros(2 * len(placements.positions), dtype=bool)
    parts = []
    for grip in grips:
        facets = sheet.edge_facets(grip.edge)
        # One placement stands for both families, two for one each.
        families = grip.families if placements.count == 2 else (0,)
        for family in families:
            blocks = placements.on_facets(facets, family)
            for component, held in enumerate(grip.components):
                if held is None:
                    continue
                dofs = 2 * blocks + component
                free = ~taken[dofs]
                dofs, positions = dofs[free], placements.positions[blocks[free]]
                taken[dofs] = True
                owned = dofs[dofs < placements.owned]
                parts.append(_Part(grip.edge, component, held, dofs, owned, positions))
    for name, bc in given.items():
        prescribed = np.asarray(bc.dof_indices()[0], dtype=np.int32)
        for component in (0, 1):
            dofs = prescribed[(prescribed % 2 == component) & ~taken[prescribed]]
            taken[dofs] = True
            positions, owned = placements.positions[dofs // 2], dofs[dofs < placements.owned]
            values = _Given(bc, dofs, taken.size)
            parts.append(_Part(name, component, values, dofs, owned, positions))
    return parts
