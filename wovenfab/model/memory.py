"""What the next step depends on: snapshots, and internal variables of effects.

Objects with a memory have ``snapshot()``, which returns it as a tree of dictionaries and lists,
and ``resume(snapshot)``, which takes it. Leaves are plain values, arrays over the unknowns of a
rank (with ghosts, or its own ones alone) and values at quadrature points.

Internal variables stand at the quadrature points of their effect. In a step they keep their values
at its start; once it is accepted they are updated. So each step has a potential and a symmetric
tangent as without them, and they lag behind by one step: an error of first order in its length.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.algorithms import expand_derivatives
from ufl.constantvalue import Zero

from wovenfab.forms.balance import Balance
from wovenfab.forms.effect import Target, Term, along_fields, by_parameter
from wovenfab.forms.friction import mean_over_angles
from wovenfab.forms.kinematics import Point, point_of, shear_angle
from wovenfab.model.assembly import compile_expression

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PointValues:
    """Values at the quadrature points of a rank's own cells.

    Attributes:
        parts: One array for each effect, shape (own cells, values of a cell).
    """

    parts: tuple[Array, ...]


def attributes(owner: object, *names: str) -> dict[str, Any]:
    """Return attributes by name, without a leading underscore."""
    return {name.lstrip("_"): getattr(owner, name) for name in names}


def take_attributes(owner: object, snapshot: Mapping[str, Any], *names: str) -> None:
    """Set attributes as :func:`attributes` returned them."""
    for name in names:
        setattr(owner, name, snapshot[name.lstrip("_")])


def finest_rule(degree: int) -> int:
    """Return the degree of the finest quadrature with a unique stress of yarns that stick.

    It has no more points in a cell than a continuous field of the elements' degree has unknowns,
    degree**2 / 2 in a large mesh. With fewer ones yarns slip between the points, without loss.

    Args:
        degree: Of the elements.
    """
    found = 1
    while _points(found + 1) <= degree**2 / 2:
        found += 1
    return found


def _points(degree: int) -> int:
    """Return the number of points of a quadrature rule in a triangle."""
    return len(basix.make_quadrature(basix.CellType.triangle, degree)[1])


def point_function(mesh: Any, size: int, degree: int) -> fem.Function:
    """Return a function of ``size`` components at the points of a quadrature rule, zero there."""
    element = basix.ufl.quadrature_element(
        mesh.basix_cell(), value_shape=(size,), scheme="default", degree=degree
    )
    return fem.Function(fem.functionspace(mesh, element))


class Variables:
    """The internal variables of one effect of a scene.

    Attributes:
        term: The effect, with its variables among its values.
        now, last: Their values in this step and in the one before, a component for each.
        accepted: Those that the next step begins with, and those of the last one; arrays of shape
            (own cells, values of a cell).
    """

    def __init__(self, mesh: Any, term: Term, degree: int) -> None:
        """Start with the initial values.

        Args:
            mesh: The mesh.
            term: An effect with a memory, with the values of its parameters.
            degree: Degree of its quadrature rule.
        """
        size, own = len(term.effect.memory), mesh.topology.index_map(2).size_local
        self.now, self.last = (point_function(mesh, size, degree) for _ in range(2))
        self.points, _ = basix.make_quadrature(basix.CellType.triangle, degree)
        self._mesh, self._cells = mesh, np.arange(own, dtype=np.int32)
        self._dofs = self.now.function_space.dofmap.list[:own]
        self.term = self.with_values(term, self.now)
        self.start()

    def __str__(self) -> str:
        """Return the effect with the names of its variables."""
        effect = self.term.effect
        return f"{effect.name}: {', '.join(v.name for v in effect.memory)}"

    def start(self) -> None:
        """Take the initial values."""
        initial = [float(v.initial) for v in self.term.effect.memory] * len(self.points)
        self.accepted = (np.tile(initial, (len(self._cells), 1)),) * 2
        self.begin()

    def begin(self) -> None:
        """Give the forms the values of the next step."""
        for function, values in zip((self.now, self.last), self.accepted, strict=True):
            self.put(function, values)

    def put(self, function: fem.Function, values: Array) -> None:
        """Give a function like ``now`` its values, shape (own cells, values of a cell)."""
        rows = function.x.array.reshape(-1, function.function_space.dofmap.bs)
        rows[self._dofs] = values.reshape(*self._dofs.shape, -1)

    def compiled(self, vector: Any) -> fem.Expression | None:
        """Return a vector with a component for each variable, compiled; None for zero; collective.

        Args:
            vector: In UFL; it may have derivatives.
        """
        expanded = expand_derivatives(vector)
        if isinstance(expanded, Zero):
            return None
        one = fem.Constant(self._mesh, 1.0)  # FFCx takes no expression that is a plain number
        return compile_expression(one * expanded, self.points)

    def at(self, *expressions: fem.Expression | None) -> Array:
        """Return the sum of compiled vectors at the points, shape (own cells, values of a cell)."""
        total = np.zeros((len(self._cells), len(self.points) * len(self.term.effect.memory)))
        for expression in expressions:
            if expression is not None:
                total += expression.eval(self._mesh, self._cells).reshape(total.shape)
        return total

    @staticmethod
    def with_values(term: Term, function: fem.Function) -> Term:
        """Return a term with the components of a function as its variables."""
        variables = {v.name: function[i] for i, v in enumerate(term.effect.memory)}
        return replace(term, values={**term.values, **variables})


class Memory:
    """The internal variables of all effects of a scene.

    Attributes:
        variables: Those of each effect that has any.
        before: Displacement where the step starts, m.
        step: Its length, s.
        stage: Where in it equilibrium holds, as of the time scheme; a constant of UFL.
    """

    def __init__(self, variables: Sequence[Variables], balance: Balance, stage: Any) -> None:
        """Compile the updates; collective.

        Args:
            variables: Those of each effect.
            balance: Balance of the scene.
            stage: Where in a step equilibrium holds.
        """
        space = balance.field.function_space
        self.variables, self.before = tuple(variables), fem.Function(space)
        self.step, self.stage = fem.Constant(space.mesh, 1.0), stage
        self._balance = balance
        self._updates = [v.compiled(self.updated(v.term)) for v in variables]

    def updated(self, term: Term) -> Any:
        """Return the variables of an effect at the end of a step in UFL, a vector."""
        now, before = self._points()
        variables = term.effect.memory
        return ufl.as_vector([v.update(now, before, term.values, self.step) for v in variables])

    def loss(self, term: Term) -> Any:
        """Return the energy (J) of a step that an effect with a stored energy loses, in UFL."""
        return self.yielded(term) if term.effect.lost else self.released(term)

    def yielded(self, term: Term) -> Any:
        """Return the energy (J) that a step loses as the variables of an effect yield, in UFL.

        Values that depend on the shear angle count with their mean over the step.
        """
        assert term.effect.lost is not None
        angles = [shear_angle(p.f, p.fibres) for p in reversed(self._points())]
        names = [v.name for v in term.effect.memory]
        means = {
            name: value if name in names else mean_over_angles(value, term.angle, *angles)
            for name, value in term.values.items()
        }
        moved = self.updated(term)
        density = term.effect.lost([moved[i] for i in range(len(names))], means)
        rule = {"quadrature_degree": self._balance.quadrature}
        return term.weight * density * ufl.dx(metadata=rule)

    def released(self, term: Term) -> Any:
        """Return the stored energy (J) that the last change of an effect's variables has released.

        It is taken at the states whose forces make up the work of the step.
        """
        variables = next(v for v in self.variables if v.term.effect is term.effect)
        earlier, (now, before) = variables.with_values(term, variables.last), self._points()

        def fall(point: Point) -> Any:
            stored = term.effect.stored
            return stored(point, earlier.values) - stored(point, term.values)

        mean = fall(before) / 2 + (self.stage - 0.5) * fall(now)
        rule = {"quadrature_degree": self._balance.quadrature}
        return term.weight * mean * ufl.dx(metadata=rule)

    def start(self) -> None:
        """Take the initial values."""
        for variables in self.variables:
            variables.start()

    def begin(self, before: Array, step: float) -> None:
        """Begin a step.

        Args:
            before: State at its start, m.
            step: Its length, s.
        """
        self.before.x.array[:], self.step.value = before, step
        for variables in self.variables:
            variables.begin()

    def accept(self) -> None:
        """Update the variables by the step that ends with the model's present field."""
        for variables, update in zip(self.variables, self._updates, strict=True):
            variables.accepted = variables.at(update), variables.accepted[0]
            if variables.term.effect.lost:
                variables.begin()

    def snapshot(self) -> dict[str, Any]:
        """Return the values by effect and names of its variables."""
        return {str(v): PointValues(v.accepted) for v in self.variables}

    def resume(self, snapshot: Mapping[str, PointValues]) -> list[str]:
        """Go on with the values of a snapshot; return the names of those that it has."""
        known = [v for v in self.variables if str(v) in snapshot]
        for variables in known:
            now, last = snapshot[str(variables)].parts
            variables.accepted = now, last
            variables.begin()
        return [str(v) for v in known]

    def _points(self) -> tuple[Point, Point]:
        """Return the point at the end and at the start of a step."""
        b = self._balance
        now, before = (point_of(u, b.fibres, b.second_gradient) for u in (b.field, self.before))
        return now, before


class VariableSlopes:
    """Derivatives of the internal variables of an effect by each parameter.

    Attributes:
        pairs: Their values in the forms, each with the field along which it changes.
    """

    def __init__(self, variables: Variables, count: int) -> None:
        """Start without any: initial values depend on no parameter."""
        self._variables = variables
        self.pairs = [(field, field.copy()) for field in (variables.now, variables.last)]
        zero = np.zeros_like(variables.accepted[0])
        self._slopes = [(zero, zero)] * count

    def compile(
        self, memory: Memory, pairs: Sequence[tuple[Any, Any]], targets: Sequence[Target]
    ) -> None:
        """Compile the derivatives of the update along fields, and by the parameters; collective."""
        variables, term = self._variables, self._variables.term
        self._along = variables.compiled(along_fields(memory.updated(term), pairs))
        symbols = [by_parameter(target, [term], memory.updated) for target in targets]
        self._by = [variables.compiled(ufl.zero() if s is None else s) for s in symbols]

    def set(self, target: int) -> None:
        """Give the fields the derivatives by a parameter."""
        for (_, field), values in zip(self.pairs, self._slopes[target], strict=True):
            self._variables.put(field, values)

    def update(self, target: int) -> None:
        """Go on to the values after the step."""
        updated = self._variables.at(self._along, self._by[target])
        self._slopes[target] = updated, self._slopes[target][0]
