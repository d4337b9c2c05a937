"""Dead loads: forces per length of an edge that keep their direction as the sheet deforms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, la
from numpy.typing import NDArray

from forms.balance import Load
from wovenfab.model.compiler import compile_forms

#: A component of a load: a number, or a function of position and program (UFL in and out).
Force = float | Callable[[Any, Any], Any]


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
class Loading:
    """The dead loads of a scene as they act now.

    Attributes:
        program: The program (m), on which loads may depend.
        share: Share of the loads that acts; 1 but on the way to the start of a program.
        loads: The loads as symbols.
        form: Compiled form of their force; None without loads.
    """

    program: fem.Constant
    share: fem.Constant
    loads: tuple[Load, ...]
    form: fem.Form | None
    _own: int

    def set(self, program: float, share: float = 1.0) -> None:
        """Let the loads act that belong to a program value (m), or a share of them."""
        self.program.value, self.share.value = program, share

    def force(self) -> NDArray[np.float64]:
        """Return the force (N) of all loads at this rank's own unknowns; collective."""
        if self.form is None:
            return np.zeros(self._own)
        vector = fem.assemble_vector(self.form)
        vector.scatter_reverse(la.InsertMode.add)
        force: NDArray[np.float64] = vector.array[: self._own].copy()
        return force


def loading_of(
    space: fem.FunctionSpace, loads: Sequence[EdgeLoad], on_edge: Callable[[str], Any]
) -> Loading:
    """Return the compiled loads; collective.

    Args:
        space: Space of 2 components a placement.
        loads: Dead loads on edges.
        on_edge: Returns the UFL measure of a named edge.
    """
    mesh = space.mesh
    program, share = (fem.Constant(mesh, np.float64(value)) for value in (0.0, 1.0))
    position = ufl.SpatialCoordinate(mesh)

    def component(force: Force) -> Any:
        at = force(position, program) if callable(force) else fem.Constant(mesh, np.float64(force))
        return share * at

    symbols = tuple(
        Load(ufl.as_vector([component(f) for f in load.force]), load.families, on_edge(load.edge))
        for load in loads
    )
    test = ufl.TestFunction(space)
    forms = compile_forms([sum(load.work(test) for load in symbols)], mesh.comm) if loads else []
    own = space.dofmap.index_map.size_local * space.dofmap.index_map_bs
    return Loading(program, share, symbols, forms[0] if forms else None, own)
