"""What a family stores on lines: on interior facets, and on edges that hold its directions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from forms.effect import Strain, Term, Values
from forms.kinematics import Edge, Facet
from forms.variation import first_variation, strain_variation


@dataclass(frozen=True)
class FacetTerm:
    """The integral of some effects over facets or edges, for one family.

    Attributes:
        place: Measures of the present state there.
        terms: The effects with what their energies per length (J/m) consist of.
        vary: Variations of the place's measures by a test or trial field.
        measure: UFL measure.
        geometric_weight: UFL scalar that multiplies the tangent but for its positive part.
    """

    place: Facet | Edge
    terms: Sequence[tuple[Term, Callable[[Any, Values], tuple[Strain, ...]]]]
    vary: Callable[[Any], list[Any]]
    measure: Any
    geometric_weight: Any = 1

    def potential(self) -> Any:
        """Return the energy (J), each term times its weight."""
        parts = ((t.weight, strains(self.place, t.values)) for t, strains in self.terms)
        return sum(weight * s.energy for weight, part in parts for s in part) * self.measure

    def residual(self, test: Any) -> Any:
        """Return the first variation of the energy (N) for a test field."""
        return first_variation(self._energy, self.place, self.vary(test)) * self.measure

    def jacobian(self, trial: Any, test: Any) -> Any:
        """Return the second variation of the energy for a trial and a test field."""
        s, t = self.vary(trial), self.vary(test)
        return (
            strain_variation(self._strains, self.place, s, t, self.geometric_weight) * self.measure
        )

    def _strains(self, place: Any) -> tuple[Strain, ...]:
        return tuple(s for term, strains in self.terms for s in strains(place, term.values))

    def _energy(self, place: Any) -> Any:
        return sum(s.energy for s in self._strains(place))
