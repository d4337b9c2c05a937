"""The balance of a sheet, eq. (12): a sum of effects, varied; and the interior penalty.

A time step minimises the incremental potential W(chi) + R(rate)/c with the rate
c chi + (known history), where c is 1/dt for backward Euler. Stored energies and
Rayleigh potentials therefore enter alike, each as a density at a point.

A step solves R(u, earlier states; p) = 0. Its derivative by a material parameter p is the
tangent-linear equation dR/du du/dp = -dR/dp - sum_j dR/du_j du_j/dp; both parts on the right come
from the same potentials.

Densities are differentiated by the few measures at a point (or facet, or edge) rather than by the
field: kernels are smaller and compile faster, and nothing is typed by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import ufl

from wovenfab.forms.effect import Effect, Strain, Term, Values
from wovenfab.forms.kinematics import (
    Edge,
    Facet,
    Pair,
    Point,
    as_variables,
    displacements,
    edge_of,
    edge_variation,
    facet_of,
    facet_variation,
    point_of,
    point_variation,
)

Place = Point | Facet | Edge
#: Safety over the smallest penalty for which the linear problem is proven stable.
SAFETY = 2.0


def facet_penalty(mesh: Any, degree: int, factor: Any | None = None) -> Any:
    """Return sigma/h (1/m) on interior facets of triangles.

    Without ``factor`` it is the local value from the trace inequality, sharp for
    every degree p: 3 a p(p-1)/8 h_F (1/|T+| + 1/|T-|), a > 1 (Bringmann, Carstensen,
    Streitberger 2023).

    Args:
        mesh: UFL domain or mesh.
        degree: Degree p of the elements.
        factor: sigma of a penalty sigma/h with h the mean of |T|/|F|, to override it.
    """
    length = ufl.FacetArea(mesh)("+")  # the same from both sides
    volume = ufl.CellVolume(mesh)
    if factor is not None:
        return factor * length / ufl.avg(volume)
    trace = 3 * SAFETY * degree * (degree - 1) / 8
    return trace * length * (1 / volume("+") + 1 / volume("-"))


def edge_penalty(mesh: Any, degree: int, factor: Any | None = None) -> Any:
    """Return sigma/h (1/m) on boundary facets: 3 a p(p-1)/2 h_F/|T|, or with ``factor``."""
    inverse = ufl.FacetArea(mesh) / ufl.CellVolume(mesh)
    return (3 * SAFETY * degree * (degree - 1) / 2 if factor is None else factor) * inverse


@dataclass(frozen=True)
class Rate:
    """Rate of a measure m: weights[0] m(now) + sum_i weights[i] m(history[i-1]), 1/s."""

    weights: Sequence[Any]
    history: Sequence[Any]
    acting: Any = 1  # factor of what depends on the rate; 0 to come to rest
    stage: Any = 1  # where in the step the rate holds, as of the time scheme


@dataclass(frozen=True)
class Load:
    """A dead load on some edges.

    Attributes:
        force: Force per reference length, shape (2,), N/m.
        families: 0, 1 or both; both share the load equally.
        measure: UFL measure of the edges.
    """

    force: Any
    families: tuple[int, ...]
    measure: Any

    def work(self, displacement: Any) -> Any:
        """Return the work (J) of the load on a displacement field or its variation."""
        parts = displacements(displacement)
        shared = sum(ufl.dot(self.force, parts[a]) for a in self.families) / len(self.families)
        return shared * self.measure


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


@dataclass(frozen=True)
class Balance:
    """Everything that the balance of one scene is made of, as symbols.

    Its own forms are those inside the sheet and of the loads. What stands on facets is
    of one family only and in :meth:`lines`, to be assembled for the unknowns of that one.

    Attributes:
        terms: The effects of the scene.
        fibres: Reference directions D_1, D_2, shape (2,) each.
        field: Displacement, shape (2,) or (4,), m.
        rate: How rates are formed; None where no effect needs one.
        degree: Degree of the elements.
        quadrature: Quadrature degree of all integrals.
        penalty: sigma of the interior penalty, None for the automatic one.
        facets: For each family, measure of the interior facets that its fibres cross.
        held_edges: For each family, measure of the edges that hold its yarn directions,
            or None.
        loads: Dead loads.
        load_weight: UFL scalar that multiplies the loads in :meth:`potential`.
        potentials: Further potentials (J) of the field, each with its weight.
        geometric_weight: UFL scalar that multiplies the tangent but for its positive part.
    """

    terms: tuple[Term, ...]
    fibres: Pair
    field: Any
    rate: Rate | None
    degree: int
    quadrature: int
    penalty: Any | None = None
    facets: Pair = (ufl.dS, ufl.dS)
    held_edges: tuple[Any | None, Any | None] = (None, None)
    loads: tuple[Load, ...] = ()
    load_weight: Any = 1
    geometric_weight: Any = 1
    potentials: tuple[tuple[Any, Any], ...] = ()

    @property
    def second_gradient(self) -> bool:
        """Whether any effect needs second derivatives."""
        return any(t.effect.needs.second_gradient for t in self.terms)

    def potential(self) -> Any:
        """Return the incremental potential (J), each term times its weight."""
        point = self._point(self.field)
        total = sum(t.weight * self._density(t, point) for t in self.terms) * self._dx
        for load in self.loads:
            total -= self.load_weight * load.work(self.field)
        for weight, potential in self.potentials:
            total += weight * potential
        return total

    def power(self) -> Any | None:
        """Return the dissipated power (W), each term times its weight; None if no friction."""
        point = self._point(self.field)
        lossy = [t for t in self.terms if t.effect.dissipative]
        if not lossy:
            return None
        return sum(t.weight * self._dissipated(t, point) for t in lossy) * self._dx

    def densities(self) -> dict[str, Any]:
        """Return each effect's share of the potential's density inside the cells (J/m^2).

        Those with internal variables are left out: they have values at their own points alone.
        """
        point, terms = self._point(self.field), [t for t in self.terms if not t.effect.memory]
        return {t.effect.name: self._density(t, point) for t in terms}

    def residual(self, test: Any) -> Any:
        """Return the first variation of the potential (N) for a test field."""
        point = self._point(self.field)
        total = first_variation(self._density_of(self.terms), point, self._vary(test)) * self._dx
        for load in self.loads:
            total -= load.work(test)
        for _, potential in self.potentials:
            total += ufl.derivative(potential, self.field, test)
        return total

    def jacobian(self, trial: Any, test: Any, last: Any | None = None) -> Any:
        """Return the tangent of the residual.

        Args:
            trial: Trial field.
            test: Test field.
            last: Displacement of the last iterate for the mixed-integration-point
                tangent; None for the plain second variation.
        """
        point, s, t = self._point(self.field), self._vary(trial), self._vary(test)
        strained = [k for k in self.terms if k.effect.strains is not None]
        others = [k for k in self.terms if k.effect.strains is None]
        before = None if last is None else self._point(last)
        total = ufl.as_ufl(0.0)
        if others:
            total += second_variation(self._density_of(others), point, s, t)
        for term in strained:
            strains = _bound(term.effect.strains, term.values)
            total += strain_variation(strains, point, s, t, self.geometric_weight, before)
        form = total * self._dx
        for _, potential in self.potentials:
            first = ufl.derivative(potential, self.field, test)
            form += self.geometric_weight * ufl.derivative(first, self.field, trial)
        return form

    @property
    def _dx(self) -> Any:
        return ufl.dx(metadata={"quadrature_degree": self.quadrature})

    def _point(self, field: Any) -> Point:
        return point_of(field, self.fibres, self.second_gradient)

    def _vary(self, field: Any) -> list[Any]:
        return point_variation(field, self.fibres, self.second_gradient)

    def _density(self, term: Term, point: Point) -> Any:
        """Return the term's share of the incremental potential density (J/m^2)."""
        effect = term.effect
        if effect.dissipation is None:
            return effect.stored(point, term.values)
        assert self.rate is not None
        dissipation = effect.dissipation(self.rate_of(effect, point), term.values)
        return self.rate.acting * dissipation / self.rate.weights[0]

    def _dissipated(self, term: Term, point: Point) -> Any:
        """Return the dissipated power density dR/d(rate)·rate (W/m^2)."""
        assert term.effect.dissipation is not None
        rate = ufl.variable(self.rate_of(term.effect, point))
        return ufl.inner(ufl.diff(term.effect.dissipation(rate, term.values), rate), rate)

    def rate_of(self, effect: Effect, point: Point) -> Any:
        """Return the rate of an effect's measure with the present state at ``point``."""
        assert self.rate is not None and effect.measure is not None
        now, *before = self.rate.weights
        total = now * effect.measure(point)
        for weight, field in zip(before, self.rate.history, strict=True):
            total += weight * effect.measure(self._point(field))
        return total

    def _density_of(self, terms: Sequence[Term]) -> Callable[[Point], Any]:
        return lambda point: sum(self._density(t, point) for t in terms)

    def lines(self, family: int, field: Any) -> list[FacetTerm]:
        """Return one family's integrals over facets and over edges that hold its directions.

        Args:
            family: 0 or 1.
            field: Its displacement, shape (2,), m.
        """
        mesh = ufl.domain.extract_unique_domain(field)
        normal, rule = ufl.FacetNormal(mesh), {"quadrature_degree": self.quadrature}
        on_facets = [(t, t.effect.facet_strains) for t in self.terms if t.effect.facet_strains]
        on_edges = [(t, t.effect.edge_strains) for t in self.terms if t.effect.edge_strains]
        terms, held = [], self.held_edges[family]
        if on_facets:
            penalty = facet_penalty(mesh, self.degree, self.penalty)
            facet = facet_of(field, self.fibres, family, penalty, normal)
            vary = partial(facet_variation, fibres=self.fibres, family=family)
            where = self.facets[family](metadata=rule)
            terms.append(FacetTerm(facet, on_facets, vary, where, self.geometric_weight))
        if on_edges and held is not None:
            penalty = edge_penalty(mesh, self.degree, self.penalty)
            edge = edge_of(field, self.fibres, family, penalty, normal)
            vary = partial(edge_variation, fibres=self.fibres, family=family)
            terms.append(
                FacetTerm(edge, on_edges, vary, held(metadata=rule), self.geometric_weight)
            )
        return terms

    def alone(self, term: Term) -> Balance:
        """Return the balance of one effect, without loads and further potentials."""
        return replace(self, terms=(term,), loads=(), potentials=())


def _bound(function: Any, values: Values) -> Callable[[Any], Any]:
    return lambda place: function(place, values)


def first_variation(energy: Callable[[Any], Any], place: Place, test: Sequence[Any]) -> Any:
    """Return the first variation of ``energy(place)``.

    Args:
        energy: Density as a function of the place.
        place: A point, facet or edge of the present state.
        test: Variations of its measures by the test field, in their order.
    """
    _, slopes = _slopes(energy, place)
    return sum(ufl.inner(s, t) for s, t in zip(slopes, test, strict=True))


def second_variation(
    energy: Callable[[Any], Any], place: Place, trial: Sequence[Any], test: Sequence[Any]
) -> Any:
    """Return the second variation of ``energy(place)``; arguments as above."""
    labelled, slopes = _slopes(energy, place)
    return sum(
        ufl.inner(ufl.dot(ufl.diff(slope, measure), s), t)
        for slope, t in zip(slopes, test, strict=True)
        for measure, s in zip(labelled.measures, trial, strict=True)
    )


def strain_variation(
    strains: Callable[[Any], tuple[Strain, ...]],
    place: Place,
    trial: Sequence[Any],
    test: Sequence[Any],
    geometric_weight: Any = 1,
    last: Place | None = None,
) -> Any:
    """Return the second variation of a sum of terms that depend on strains.

    That of k/2 s^2 is k ds ds + (k s) dds: an elastic part and a geometric one, by the force; that
    of k w(s) is k w'' ds ds + (k w') dds. The elastic parts of all squares and convex laws
    together have no negative eigenvalue: the positive part.

    In a mixed term the force of the geometric part is replaced by its linearisation from the last
    iterate, so that a large rotation of a stiff yarn is not taken for a large force
    (Magisano, Leonetti, Garcea, CMAME 2017). At the solution both are the same.

    Args:
        strains: The terms as a function of the place.
        place: A point, facet or edge of the present state.
        trial: Variations of the place's measures by the trial field.
        test: The same by the test field.
        geometric_weight: Factor of all but the positive part.
        last: The place at the last iterate; None for no linearisation.
    """
    labelled, before = as_variables(place), None if last is None else as_variables(last)

    def linearised(old: Any) -> Any:
        assert last is not None and before is not None
        growths = zip(before.measures, place.measures, last.measures, strict=True)
        return old + sum(ufl.inner(ufl.diff(old, m), p - q) for m, p, q in growths)

    def first(measure: Any, variation: Sequence[Any]) -> Any:
        pairs = zip(labelled.measures, variation, strict=True)
        return sum(ufl.inner(ufl.diff(measure, m), v) for m, v in pairs)

    def second(measure: Any) -> Any:
        return sum(
            ufl.inner(ufl.dot(ufl.diff(ufl.diff(measure, n), m), s), t)
            for n, t in zip(labelled.measures, test, strict=True)
            for m, s in zip(labelled.measures, trial, strict=True)
        )

    total = 0
    terms = strains(labelled)
    for now, old in zip(terms, terms if before is None else strains(before), strict=True):
        force = linearised if now.mixed and before is not None else lambda measure: measure
        source = old if now.mixed else now
        for (a, b), (u, v) in zip(_products(now), _products(source), strict=True):
            if now.other is None:
                elastic = now.tangent(a) * first(a, trial) * first(a, test)
                part = elastic + geometric_weight * force(source.force(u)) * second(a)
            else:
                part = first(a, trial) * first(b, test) + first(b, trial) * first(a, test)
                part = geometric_weight * (part + force(u) * second(b) + force(v) * second(a))
            total += now.stiffness * part
    return total


def _products(strain: Strain) -> list[tuple[Any, Any]]:
    """Return the scalars whose products make up the term."""
    a, b = strain.measure, strain.measure if strain.other is None else strain.other
    return [(a[i], b[i]) for i in range(len(a))] if ufl.shape(a) else [(a, b)]


def _slopes(energy: Callable[[Any], Any], place: Place) -> tuple[Any, list[Any]]:
    labelled = as_variables(place)
    density = energy(labelled)
    return labelled, [ufl.diff(density, m) for m in labelled.measures]
