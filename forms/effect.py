"""What an effect is: a name, its parameters with units, its needs and its potential.

An effect is one file of this folder that defines ``EFFECT``; ``wovenfab.forms.effects``
finds it, and everything else (case keys, spaces, integrals, history columns)
follows from what the effect states here.

An effect in a scene: with its values, and with a weight that selects its share.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any

import ufl

from wovenfab.forms.kinematics import Edge, Facet, Point
from wovenfab.forms.table import TABLE, ForceTable, TableParameter

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
        usual: Values outside are asked back, since a unit is probably wrong; zero is not.
        of_angle: Whether it may depend on the shear angle.
    """

    name: str
    unit: str
    meaning: str
    per_family: bool = False
    zero_allowed: bool = True
    default: float | None = None
    above: float | None = None
    usual: tuple[float, float] = (0.0, inf)
    of_angle: bool = False


@dataclass(frozen=True)
class OfShearAngle:
    """A value that depends on the shear angle, such as of friction that grows with it.

    In a step it is that of the angle to which the two states before lead (extrapolated, of second
    order in the step). So a potential stays one of the present state, with a symmetric tangent.

    Attributes:
        function: Returns a UFL scalar from the position (m) and the angle gamma (rad).
    """

    function: Callable[[Any, Any], Any]


@dataclass(frozen=True)
class Needs:
    """What must be there for the effect to act; what nobody needs is not built.

    Attributes:
        placements: 1, or 2 for an effect that acts on their difference.
        second_gradient: Second derivatives in the cells and jumps on the facets.
        rate: The effect depends on a rate, hence on time and on history.
        increment: It depends on what changes in a step, hence on history, not on time.
    """

    placements: int = 1
    second_gradient: bool = False
    rate: bool = False
    increment: bool = False

    @property
    def history(self) -> bool:
        """Whether earlier states matter, so that the result depends on the steps."""
        return self.rate or self.increment


@dataclass(frozen=True)
class Strain:
    """One term of a stored energy that depends on strains.

    It is ``stiffness/2 * measure**2``, or ``stiffness * measure * other`` of two measures, or
    ``stiffness * law(measure)``. The tangent of such a term has an elastic part, by the slopes of
    the measures, and a geometric one, by their curvature and the force. The elastic parts of
    squares and of convex laws are never negative.

    Attributes:
        measure: A scalar or a vector.
        stiffness: A scalar.
        other: Another measure of the same shape; None for a square.
        law: Convex energy of a scalar measure; None for half of its square.
        mixed: Whether the force in the geometric part is linearised from the last iterate,
            which keeps Newton's method quick where the stiffness is huge
            (Magisano, Leonetti, Garcea, CMAME 2017).
    """

    measure: Any
    stiffness: Any
    other: Any | None = None
    law: Callable[[Any], Any] | None = None
    mixed: bool = True

    @property
    def energy(self) -> Any:
        """The energy density of the term."""
        if self.law is not None:
            return self.stiffness * self.law(self.measure)
        if self.other is None:
            return self.stiffness / 2 * ufl.inner(self.measure, self.measure)
        return self.stiffness * ufl.inner(self.measure, self.other)

    def force(self, measure: Any) -> Any:
        """Return the derivative of the energy by a measure, for a stiffness of one."""
        return measure if self.law is None else _slope(self.law, measure)

    def tangent(self, measure: Any) -> Any:
        """Return the second derivative in the same way."""
        return 1 if self.law is None else _slope(self.force, measure)


def _slope(function: Callable[[Any], Any], at: Any) -> Any:
    at = ufl.variable(at)
    return ufl.diff(function(at), at)


@dataclass(frozen=True)
class DualFrictionLaw:
    """A friction stress that has a bound: the law seen from the stress.

    Below the bound the rate is ``creep(stress)``; at the bound it may be anything
    larger in the same direction. With several components each has the bound for itself.
    A solver that carries the stress itself needs the law in this form; it is the only
    form of a set-valued law such as Coulomb's, which has no creep.

    Attributes:
        strength: Largest stress from the values.
        creep: Rate of one component from its stress and the values, the inverse of the
            derivative of the effect's ``dissipation``; None where there is none.
    """

    strength: Callable[[Values], Any]
    creep: Callable[[Any, Values], Any] | None = None


@dataclass(frozen=True)
class InternalVariable:
    """What an effect remembers at a point, such as the sliding so far.

    The functions of the effect find it among the values by its name. In a step that is its value
    at the start, so that a potential stays one of the present state, with a symmetric tangent.

    Attributes:
        name: Key among the values.
        unit: SI unit, as of a parameter.
        meaning: One line.
        update: Its value at the end of an accepted step, a scalar, from the points at its end and
            at its start, the values, and its length (s).
        initial: Value at the start of a run.
    """

    name: str
    unit: str
    meaning: str
    update: Callable[[Point, Point, Values, Any], Any]
    initial: float = 0.0


@dataclass(frozen=True)
class Effect:
    """One effect of the model, or one law of it.

    Exactly one of ``energy``, ``strains`` and ``dissipation`` is given; a set-valued law
    of friction has a ``bound`` instead.

    Attributes:
        name: Key in the case file and suffix of the history columns.
        summary: One line on the physics, with the paper's equation.
        parameters: The material parameters.
        needs: What must be built for it.
        energy: Stored energy per area (J/m^2) from a point and the values.
        strains: The quadratic terms that make up the stored energy.
        dissipation: Rayleigh potential per area (W/m^2) from a rate and the values.
        measure: What the rate is the time derivative of, from a point.
        bound: The law seen from the stress, where a bound holds the stress.
        law: Key by which a case chooses among the effect's laws; empty if it has one.
        laws: Its other laws, each an effect of the same name; a case that names none
            gets this one.
        table: The table that it takes; its functions find the coefficients of the pieces, as
            :func:`wovenfab.forms.table.table_energy` takes them, among the values.
        facet_strains: Terms of the stored energy per length (J/m) of an interior facet.
        edge_strains: The same on an edge where the yarn directions are held.
        memory: The internal variables that its functions inside the sheet may depend on.
        lost: Energy (J/m^2) that a step loses, from the internal variables after it and the
            values. It is given where they yield, that is, where their update leaves the stress as
            it is: what is stored after a step is then that of the updated ones. Elsewhere the fall
            of the stored energy by an update is lost in the next step.
        stretch_stiffness: Lower bounds (N/m) at all stretches, from the values with the pieces of
            the table: with them as ``m``, the stored energy less ``m_1 l_1^2/2 + m_2 l_2^2/2`` is
            convex in the lengths ``l_1``, ``l_2`` of ``f_1``, ``f_2``. None for zero.
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
    bound: DualFrictionLaw | None = None
    law: str = ""
    laws: tuple[Effect, ...] = ()
    table: TableParameter | None = None
    facet_strains: Callable[[Facet, Values], tuple[Strain, ...]] | None = None
    edge_strains: Callable[[Edge, Values], tuple[Strain, ...]] | None = None
    memory: tuple[InternalVariable, ...] = ()
    lost: Callable[[Sequence[Any], Values], Any] | None = None
    stretch_stiffness: Callable[[Values], tuple[Any, Any]] | None = None
    resists: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        """Refuse an effect that does not say what it is."""
        given = [p for p in (self.energy, self.strains, self.dissipation) if p is not None]
        if len(given) + self.set_valued != 1:
            raise ValueError(
                f"effect {self.name!r} must give exactly one of energy, strains, dissipation, "
                "or a bound instead"
            )
        if self.dissipative != (self.measure is not None):
            raise ValueError(f"effect {self.name!r}: a dissipation needs a measure and no other")
        if self.needs.rate != (self.dissipation is not None):
            raise ValueError(f"effect {self.name!r}: a dissipation needs the rate, and only it")
        if self.needs.increment != self.set_valued:
            raise ValueError(f"effect {self.name!r}: a set-valued law needs the increment")
        if self.bound and (self.bound.creep is None) != self.set_valued:
            raise ValueError(f"effect {self.name!r}: a creep belongs to a dissipation")
        words = [one.law for one in self.all_laws]
        if self.laws and (len(set(words)) < len(words) or "" in words):
            raise ValueError(f"effect {self.name!r}: each of its laws needs a word of its own")
        if any(one.name != self.name or one.laws for one in self.laws):
            raise ValueError(f"effect {self.name!r}: its laws are effects of the same name")
        if self.lost and not self.releases:
            raise ValueError(f"effect {self.name!r}: what yields stores energy and has a memory")
        if self.memory and (self.facet_strains or self.edge_strains):
            raise ValueError(f"effect {self.name!r}: a memory is inside the sheet, not on facets")

    def __call__(
        self,
        *values: Any,
        law: str = "",
        table: ForceTable | tuple[ForceTable, ForceTable] | None = None,
        **named: Any,
    ) -> Term:
        """Return the effect with its parameters in SI units, as in ``shear(stiffness=400.0)``.

        Args:
            *values: Parameters in their order: numbers, UFL expressions, or functions of the
                position that return UFL; a pair where both families have their own. Strengths of
                friction may be :class:`OfShearAngle`.
            law: One of the effect's laws; the first one unless given.
            table: The table of a law that takes one; a pair where both families have their own.
            **named: Parameters by name.

        Raises:
            TypeError: A parameter is missing, unknown or given twice, it may not depend on the
                shear angle, or there is no such law.
        """
        known = {one.law: one for one in self.all_laws}
        if law and law not in known:
            raise TypeError(f"{self.name} has no law {law!r}, but {', '.join(known)}")
        effect = known[law] if law else self
        parameters = {p.name: p for p in effect.parameters}
        if len(values) > len(parameters):
            raise TypeError(f"{self.name} takes {', '.join(parameters)}, but got {len(values)}")
        given = dict(zip(parameters, values, strict=False))
        if unknown := [name for name in named if name not in parameters or name in given]:
            raise TypeError(
                f"{self.name} takes no {unknown[0]!r}, or not twice, but {', '.join(parameters)}"
            )
        given |= named
        for name, parameter in parameters.items():
            if name not in given and parameter.default is None:
                raise TypeError(f"{self.name} needs {name} ({parameter.unit}): {parameter.meaning}")
            value = given.get(name, parameter.default)
            if isinstance(value, OfShearAngle) and not parameter.of_angle:
                raise TypeError(f"{self.name}: {name} cannot depend on the shear angle")
            pair = parameter.per_family and not isinstance(value, tuple)
            given[name] = (value, value) if pair else value
        if (effect.table is None) != (table is None):
            takes = f"no {TABLE}" if effect.table is None else effect.table.meaning
            raise TypeError(f"{self.name} takes {takes}")
        if effect.table is not None:
            pair = effect.table.per_family and not isinstance(table, tuple)
            given[TABLE] = (table, table) if pair else table
        return Term(effect, given)

    @property
    def all_laws(self) -> tuple[Effect, ...]:
        """The effect itself and its other laws."""
        return (self, *self.laws)

    @property
    def set_valued(self) -> bool:
        """Whether the stress is no function of the rate, as with Coulomb's law."""
        return self.bound is not None and self.dissipation is None

    @property
    def dissipative(self) -> bool:
        """Whether the effect loses energy or stores it."""
        return self.dissipation is not None or self.set_valued

    @property
    def releases(self) -> bool:
        """Whether it stores energy that is lost as internal variables change, as by damage."""
        return bool(self.memory) and not self.dissipative

    @property
    def loses(self) -> bool:
        """Whether it loses energy in any way."""
        return self.dissipative or self.releases

    def stored(self, point: Point, values: Values) -> Any:
        """Return the stored energy density (J/m^2) at ``point``; zero if dissipative."""
        if self.energy is not None:
            return self.energy(point, values)
        if self.strains is not None:
            return sum(s.energy for s in self.strains(point, values))
        return 0


@dataclass(frozen=True)
class Term:
    """An effect of the scene with its parameter values.

    Attributes:
        effect: The effect.
        values: By parameter name (a pair where it is per family); UFL scalars where forms are
            made of them.
        weight: UFL scalar that multiplies the term in :meth:`Balance.potential` and
            :meth:`Balance.power` (and nowhere else), so that one compiled form can
            give each effect's share.
        angle: The shear angle (rad) that values depend on, a variable of UFL; None if none does.
    """

    effect: Effect
    values: Values
    weight: Any = 1
    angle: Any | None = None


@dataclass(frozen=True)
class Target:
    """A material parameter that something is differentiated by.

    Attributes:
        effect: Name of its effect.
        parameter: Name of the parameter.
        families: The families whose values follow it, 0, 1 or both; it is ignored where both
            have the same one.
        coefficient: Number of a coefficient in the formula of the value, from 1; 0 for the value.
        along: How the value changes with it, a function of position and shear angle; None for by
            one.
        relative: Whether it is the logarithm of a factor of the values, which keeps their ratio and
            the shape of a formula.
    """

    effect: str
    parameter: str
    families: tuple[int, ...] = (0, 1)
    coefficient: int = 0
    along: Callable[[Any, Any], Any] | None = field(default=None, compare=False)
    relative: bool = False

    def __str__(self) -> str:
        """Return ``effect.parameter``, the family if it is one of two, and the coefficient.

        A common factor is ``ln(effect.parameter)``.
        """
        family = "" if len(self.families) == 2 else f"[{self.families[0] + 1}]"
        coefficient = f"#{self.coefficient}" if self.coefficient else ""
        name = f"{self.effect}.{self.parameter}{family}{coefficient}"
        return f"ln({name})" if self.relative else name


def by_parameter(target: Target, terms: Sequence[Term], form: Callable[[Term], Any]) -> Any | None:
    """Return the derivative of a form by a parameter; None if the form does not depend on it.

    Args:
        target: The parameter.
        terms: The effects, of which one may have it.
        form: Returns the form, or an expression, of one effect.
    """
    for term in terms:
        if term.effect.name == target.effect and target.parameter in term.values:
            return _derivative(target, term, form)
    return None


def _derivative(target: Target, term: Term, form: Callable[[Term], Any]) -> Any | None:
    value = term.values[target.parameter]
    per_family = isinstance(value, tuple)
    values = list(value) if per_family else [value]
    change = ufl.variable(ufl.as_ufl(0.0))
    for family in target.families if per_family else (0,):
        of = values[family]
        along = of if target.relative else 1.0
        if target.along is not None:
            domain = ufl.domain.extract_unique_domain(of)
            along = target.along(ufl.SpatialCoordinate(domain), term.angle)
        values[family] = of + change * along
    named = {**term.values, target.parameter: tuple(values) if per_family else values[0]}
    total = form(replace(term, values=named))
    return None if total is None else ufl.diff(total, change)


def along_fields(form: Any, changes: Sequence[tuple[Any, Any]]) -> Any:
    """Return how a form, or an expression, changes; pairs are of a field and its change."""
    zero = ufl.zero(*form.ufl_shape) if isinstance(form, ufl.core.expr.Expr) else ufl.Form([])
    return sum((ufl.derivative(form, field, change) for field, change in changes), zero)
