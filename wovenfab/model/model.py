"""The discrete model of a scene: its space, its fields and its compiled forms."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from dolfinx import fem
from dolfinx.fem import IntegralType
from mpi4py import MPI

from forms.balance import Balance
from forms.effect import Effect
from forms.point_friction import PointFriction
from wovenfab.model.assembly import Sum, assemble_scalar
from wovenfab.model.constraints import DeadLoads
from wovenfab.model.spaces import Placements
from wovenfab.sheet.sheet import Sheet

#: A parameter: a number, or a function of the reference position (UFL in and out).
Value = float | Callable[[Any], Any]
#: The name under which dead loads stand beside the effects in :attr:`Model.weights`.
LOAD = "dead load"


@dataclass(frozen=True)
class Numerics:
    """Choices of discretisation.

    Attributes:
        degree: Degree of the Lagrange elements.
        quadrature: Quadrature degree; None for twice the element degree.
        penalty: sigma of the interior penalty; None for the automatic local value.
        history: Earlier states that the time scheme's rates use (0 without a rate).
        mixed: Use the mixed-integration-point tangent.
        friction: Quadrature degree of set-valued friction; None for one less than the
            element's. Such a rule has no more points than the slip has modes, so that the
            stress of yarns that stick is unique.
    """

    degree: int
    quadrature: int | None = None
    penalty: float | None = None
    history: int = 1
    mixed: bool = True
    friction: int | None = None


@dataclass(frozen=True)
class Model:
    """What a scene's effects, sheet and numerics have been compiled to.

    Attributes:
        sheet: The meshed sheet.
        effects: The effects of the scene.
        numerics: The discretisation.
        placements: The unknowns: one placement, or two that may jump.
        field: Present displacement, m.
        last: Displacement of the last iterate (mixed-integration-point tangent).
        history: Displacement at earlier times, latest first; empty without rates.
        rate_weights: Weights of the present and the earlier states in a rate, 1/s.
        friction: Factor of all friction: 1, or 0 for an initial state.
        geometric_weight: 1 for the tangent, 0 for its positive part (``forms.variation``).
        loading: The dead loads.
        balance: The symbolic balance.
        residual, jacobian, potential: Sums of compiled forms; the residual lacks the force
            of point frictions.
        power: Compiled form of the dissipated power; empty without a rate.
        weights: Constant that scales an effect's share in potential, power and loss.
        point_frictions: Frictions whose stress is a variable at quadrature points.
        friction_force: Compiled forms of the force of their stresses.
        loss: Compiled forms of the energy that set-valued laws dissipate in the step.
    """

    sheet: Sheet
    effects: tuple[Effect, ...]
    numerics: Numerics
    placements: Placements
    field: fem.Function
    last: fem.Function
    history: tuple[fem.Function, ...]
    rate_weights: tuple[fem.Constant, ...]
    friction: fem.Constant
    geometric_weight: fem.Constant
    loading: DeadLoads
    balance: Balance
    residual: Sum
    jacobian: Sum
    potential: Sum
    power: Sum
    friction_force: Sum
    loss: Sum
    weights: Mapping[str, fem.Constant]
    point_frictions: tuple[PointFriction, ...]

    @property
    def comm(self) -> MPI.Comm:
        """Communicator of the mesh."""
        comm: MPI.Comm = self.sheet.mesh.comm
        return comm

    @property
    def space(self) -> fem.FunctionSpace:
        """Lagrange space of 2 components a placement."""
        return self.placements.space

    @property
    def unknowns(self) -> int:
        """Number of unknowns over all ranks."""
        return self.placements.unknowns

    @property
    def facet_integrals(self) -> int:
        """Number of compiled integrals over interior facets, all forms together."""
        forms = (*self.jacobian, *self.residual, *self.potential)
        kinds = [kind for form in forms for kind in form.integral_types]
        return kinds.count(IntegralType.interior_facet)

    def shares(self, forms: Sum, names: Sequence[str]) -> dict[str, float]:
        """Return each named effect's share of weighted scalar forms (J or W)."""
        result = {}
        with preserved(*self.weights.values()):
            for name in names:
                for other, weight in self.weights.items():
                    weight.value = 1.0 if other == name else 0.0
                result[name] = assemble_scalar(forms, self.comm)
        return result

    def stored_energy(self) -> dict[str, float]:
        """Return the stored energy (J) by effect."""
        return self.shares(self.potential, [e.name for e in self.effects if not e.dissipative])

    def dissipated_power(self) -> dict[str, float]:
        """Return the dissipated power (W) of each effect that depends on a rate."""
        return self.shares(self.power, [e.name for e in self.effects if e.needs.rate])

    def dissipated_energy(self) -> dict[str, float]:
        """Return the energy (J) that each set-valued law dissipates in the step."""
        return self.shares(self.loss, [e.name for e in self.effects if e.set_valued])


@contextmanager
def preserved(*items: fem.Function | fem.Constant) -> Iterator[None]:
    """Restore fields (ghosts included) and constants at the end, also after an exception."""
    arrays = [item.value if isinstance(item, fem.Constant) else item.x.array for item in items]
    before = [array.copy() for array in arrays]
    try:
        yield
    finally:
        for array, values in zip(arrays, before, strict=True):
            array[...] = values
