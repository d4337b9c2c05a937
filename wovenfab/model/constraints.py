"""Held placements: which unknowns each edge prescribes, and the forces there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from wovenfab.sheet.sheet import Sheet


@dataclass(frozen=True)
class Held:
    """A prescribed component: displacement = factor · program + offset.

    Attributes:
        factor: Multiple of the program.
        offset: Constant part, m.
    """

    factor: float = 0.0
    offset: float = 0.0

    def at(self, program: float) -> float:
        """Return the displacement (m) for a program value (m)."""
        return self.factor * program + self.offset


#: For each component (x, y): how it is held, or None where it is free.
Grip = tuple[Held | None, Held | None]


@dataclass(frozen=True)
class _Part:
    """One component of one placement on one edge."""

    edge: str
    component: int
    held: Held
    value: fem.Constant
    owned: NDArray[np.int32]


class Constraints:
    """The prescribed placements of a scene.

    An unknown that two edges hold (a corner) belongs to the edge named first.

    Attributes:
        bcs: Boundary conditions for dolfinx.
        edges: Names of the edges that hold anything.
    """

    def __init__(self, space: fem.FunctionSpace, sheet: Sheet, grips: Mapping[str, Grip]) -> None:
        """Find the unknowns that each grip holds.

        Args:
            space: Space of 2 components a placement.
            sheet: The sheet with its named edges.
            grips: How each edge is held, by name.
        """
        size = space.dofmap.index_map_bs
        self._comm = space.mesh.comm
        self._parts: list[_Part] = []
        self.bcs: list[fem.DirichletBC] = []
        self.edges = tuple(grips)
        local = space.dofmap.index_map.size_local * size
        taken = np.zeros(
            (space.dofmap.index_map.size_local + space.dofmap.index_map.num_ghosts) * size, bool
        )
        for name, grip in grips.items():
            for k in range(size):
                held = grip[k % 2]
                if held is None:
                    continue
                dofs = fem.locate_dofs_topological(space.sub(k), 1, sheet.edge_facets(name))
                dofs = dofs[~taken[dofs]]
                taken[dofs] = True
                value = fem.Constant(space.mesh, np.float64(0.0))
                self.bcs.append(fem.dirichletbc(value, dofs, space.sub(k)))
                # dolfinx 0.9 over-counts owned unknowns on blocked spaces: filter here.
                self._parts.append(_Part(name, k % 2, held, value, dofs[dofs < local]))

    def set(self, program: float) -> None:
        """Prescribe the placements for a program value (m)."""
        for part in self._parts:
            part.value.value = part.held.at(program)

    def reactions(self, force: NDArray[np.float64]) -> dict[str, tuple[float, float]]:
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

    def work(self, force: NDArray[np.float64], displacement: NDArray[np.float64]) -> float:
        """Return the work (J) of forces on displacement increments at held unknowns.

        Args:
            force: Internal force at this rank's own unknowns, N.
            displacement: Increment of displacement there, m.
        """
        mine = sum(float(force[p.owned] @ displacement[p.owned]) for p in self._parts)
        return float(self._comm.allreduce(mine))

    def unmet(self, field: Any) -> bool:
        """Return whether any prescribed value is not yet attained; same on all ranks."""
        values = field.x.array
        mine = any(
            p.owned.size
            and not np.array_equal(values[p.owned], np.full(p.owned.size, p.value.value))
            for p in self._parts
        )
        return bool(self._comm.allreduce(int(mine)))
