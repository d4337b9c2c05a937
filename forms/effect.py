"""What an effect is: a name, its parameters with units, its needs and its potential.

An effect is one file of this folder that defines ``EFFECT``; ``forms.catalogue``
finds it, and everything else (case keys, spaces, integrals, history columns)
follows from what the effect states here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from .kinematics import Edge, Facet, Point

#: Parameter values by name: a UFL scalar, or one for each family.
Values = Mapping[str, Any]


@dataclass(frozen=True)
class Parameter:
    """A material parameter of an effect.

    Attributes:
        name: Key in the case file.
        unit: SI unit, as pint writes it (``"N/m"``).
        meaning: One line for ``wovenfab schema`` and the docs.
        per_family: Whether the two families may have different values.
        zero_allowed: Whether zero is meaningful (a stiffness) or not (a slope).
        default: Value in the SI unit where a case gives none; None if it must.
        above: Lower bound in the SI unit that is not reached itself, such as 1 for a
            power; None for the bound that ``zero_allowed`` implies.
    """

    name: str
    unit: str
    meaning: str
    per_family: bool = False
    zero_allowed: bool = True
    default: float | None = None
    above: float | None = None


@dataclass(frozen=True)
class Needs:
    """What must be there for the effect to act; what nobody needs is not built.

    Attributes:
        placements: 1, or 2 for an effect that acts on their difference.
        second_gradient: Second derivatives in the cells and jumps on the facets.
        rate: The effect depends on a rate, hence on time and on history.
    """

    placements: int = 1
    second_gradient: bool = False
    rate: bool = False


@dataclass(frozen=True)
class Strain:
    """One quadratic term ``stiffness/2 * measure**2`` of a stored energy.

    A stored energy that is given as a sum of these gets the mixed-integration-point
    tangent (Magisano, Leonetti, Garcea, CMAME 2017), which
    keeps Newton's method quick where the stiffness is huge.
    """

    measure: Any
    stiffness: Any


@dataclass(frozen=True)
class Effect:
    """One effect of the model.

    Exactly one of ``energy``, ``strains`` and ``dissipation`` is given.

    Attributes:
        name: Key in the case file and suffix of the history columns.
        summary: One line on the physics, with the paper's equation.
        parameters: The material parameters.
        needs: What must be built for it.
        energy: Stored energy per area (J/m^2) from a point and the values.
        strains: The quadratic terms that make up the stored energy.
        dissipation: Rayleigh potential per area (W/m^2) from a rate and the values.
        measure: What the rate is the time derivative of, from a point.
        facet_energy: Stored energy per length (J/m) of an interior facet.
        edge_energy: The same on an edge where the yarn directions are held.
        resists: What the effect keeps from moving freely, of ``"stretching"``,
            ``"shearing"``, ``"curving"`` and ``"slipping"``; scenes that leave too much
            free are refused.
    """

    name: str
    summary: str
    parameters: tuple[Parameter, ...]
    needs: Needs = field(default_factory=Needs)
    energy: Callable[[Point, Values], Any] | None = None
    strains: Callable[[Point, Values], tuple[Strain, ...]] | None = None
    dissipation: Callable[[Any, Values], Any] | None = None
    measure: Callable[[Point], Any] | None = None
    facet_energy: Callable[[Facet, Values], Any] | None = None
    edge_energy: Callable[[Edge, Values], Any] | None = None
    resists: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        """Refuse an effect that does not say what it is."""
        given = [p for p in (self.energy, self.strains, self.dissipation) if p is not None]
        if len(given) != 1:
            raise ValueError(
                f"effect {self.name!r} must give exactly one of energy, strains, dissipation"
            )
        if (self.dissipation is None) != (self.measure is None):
            raise ValueError(f"effect {self.name!r}: a dissipation needs a measure and no other")
        if self.needs.rate != self.dissipative:
            raise ValueError(f"effect {self.name!r}: a dissipation needs the rate, and only it")

    @property
    def dissipative(self) -> bool:
        """Whether the effect loses energy (a Rayleigh potential) or stores it."""
        return self.dissipation is not None

    def stored(self, point: Point, values: Values) -> Any:
        """Return the stored energy density (J/m^2) at ``point``; zero if dissipative."""
        if self.energy is not None:
            return self.energy(point, values)
        if self.strains is not None:
            return sum(s.stiffness / 2 * s.measure**2 for s in self.strains(point, values))
        return 0
