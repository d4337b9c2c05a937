"""Held placements: which unknowns each edge prescribes, and the forces there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from wovenfab.sheet.sheet import Sheet

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Held:
    """A prescribed component: displacement = factor · program + offset, or a field.

    Attributes:
        factor: Multiple of the program.
        offset: Constant part, m.
        field: Displacement (m) against x, y (m) and the program (m), instead of both.
    """

    factor: float = 0.0
    offset: float = 0.0
    field: Callable[[Array, Array, float], Array] | None = None

    def at(self, positions: Array, program: float) -> Array:
        """Return the displacement (m) at reference positions, shape (n, 2 or 3)."""
        x, y = positions[:, 0], positions[:, 1]
        value = self.factor * program + self.offset
        return np.broadcast_to(self.field(x, y, program) if self.field else value, x.shape)


@dataclass(frozen=True)
class Grip:
    """How an edge is held.

    Attributes:
        edge: Name of the edge.
        components: For x and y how it is held, or None where it is free.
        families: 0, 1 or both.
    """

    edge: str
    components: tuple[Held | None, Held | None]
    families: tuple[int, ...] = (0, 1)


@dataclass(frozen=True)
class _Part:
    """One component of one placement on one edge.

    Attributes:
        dofs: Its unknowns on this rank, ghosts included.
        owned: Those that the rank owns.
        positions: Reference positions of ``dofs``, shape (n, 3), m.
        values: Prescribed values of all unknowns; the part writes those of ``places``.
        places: Where in ``values`` the values of ``dofs`` stand.
    """

    edge: str
    component: int
    held: Held
    dofs: NDArray[np.int32]
    owned: NDArray[np.int32]
    positions: Array
    values: fem.Function
    places: NDArray[np.int32]


class Constraints:
    """The prescribed placements of a scene.

    An unknown that two edges hold (a corner) belongs to the edge named first.

    Attributes:
        bcs: Boundary conditions for dolfinx.
        edges: Names of the edges that hold anything.
    """

    def __init__(self, space: fem.FunctionSpace, sheet: Sheet, grips: Sequence[Grip]) -> None:
        """Find the unknowns that each grip holds.

        Args:
            space: Space of 2 components a placement.
            sheet: The sheet with its named edges.
            grips: How edges are held.
        """
        self._comm = space.mesh.comm
        self.edges = tuple(dict.fromkeys(grip.edge for grip in grips))
        size = space.dofmap.index_map_bs
        scalar, _ = space.sub(0).collapse()
        self._parts: list[_Part] = []
        self.bcs: list[fem.DirichletBC] = []
        for k in range(size):
            # One placement stands for both families, two for one each.
            mine = [g for g in grips if size == 2 or k // 2 in g.families]
            parts = _component(space, scalar, sheet, k, mine)
            if parts:
                dofs = np.concatenate([part.dofs for part in parts])
                places = np.concatenate([part.places for part in parts])
                order = np.argsort(dofs)
                pair = [dofs[order], places[order]]
                self.bcs.append(fem.dirichletbc(parts[0].values, pair, space.sub(k)))
            self._parts += parts

    def set(self, program: float) -> None:
        """Prescribe the placements for a program value (m)."""
        for part in self._parts:
            part.values.x.array[part.places] = part.held.at(part.positions, program)

    def reactions(self, force: Array) -> dict[str, tuple[float, float]]:
        """Return the force (N) that each edge exerts on the sheet, x and y.

        Args:
            force: Internal force at this rank's own unknowns (residual before
                boundary conditions), N.
        """
        total = np.zeros((len(self.edges), 2))
        for part in self._parts:
            total[self.edges.index(part.edge), part.component] += force[part.owned].sum()
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

    def unmet(self, field: fem.Function) -> bool:
        """Return whether any prescribed value is not yet attained; same on all ranks."""
        mine = any(
            not np.array_equal(field.x.array[p.dofs], p.values.x.array[p.places])
            for p in self._parts
        )
        return bool(self._comm.allreduce(int(mine)))


def _component(
    space: fem.FunctionSpace, scalar: fem.FunctionSpace, sheet: Sheet, k: int, grips: Sequence[Grip]
) -> list[_Part]:
    """Return the parts of component ``k`` of the space, each unknown in one of them."""
    size = space.dofmap.index_map_bs
    own = space.dofmap.index_map.size_local * size
    everywhere = space.tabulate_dof_coordinates()
    values = fem.Function(scalar)
    taken = np.zeros(len(everywhere) * size, dtype=bool)
    parts = []
    for grip in grips:
        held = grip.components[k % 2]
        if held is None:
            continue
        facets = sheet.edge_facets(grip.edge)
        dofs, places = fem.locate_dofs_topological((space.sub(k), scalar), 1, facets)
        free = ~taken[dofs]
        dofs, places = dofs[free], places[free]
        taken[dofs] = True
        # dolfinx 0.9 over-counts owned unknowns on blocked spaces: filter here.
        owned, positions = dofs[dofs < own], everywhere[dofs // size]
        parts.append(_Part(grip.edge, k % 2, held, dofs, owned, positions, values, places))
    return parts
