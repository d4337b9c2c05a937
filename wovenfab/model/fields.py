"""The fields that a user sees, evaluated cell by cell at given points.

Values are not averaged between cells: curvatures jump there, and that shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from wovenfab.forms.kinematics import (
    curvature_vector,
    displacements,
    norm,
    point_of,
    shear_angle,
    stretch,
)
from wovenfab.model.assembly import compile_expression
from wovenfab.model.model import Model


@dataclass(frozen=True)
class Field:
    """A field of the deformed sheet.

    Attributes:
        name: Name in the results, such as ``curvature_1``.
        group: Name in the case file, such as ``curvature``.
        unit: SI unit, empty where there is none.
        expression: UFL scalar or vector.
    """

    name: str
    group: str
    unit: str
    expression: Any

    @property
    def size(self) -> int:
        """Number of components."""
        return int(np.prod(self.expression.ufl_shape, dtype=int))


def available(model: Model) -> tuple[Field, ...]:
    """Return all fields that the model's effects give a meaning to."""
    balance = model.balance
    point = point_of(model.field, balance.fibres, balance.second_gradient)
    families = tuple(enumerate(displacements(model.field), start=1))
    fields = []
    if point.slip is None:
        fields.append(Field("displacement", "displacement", "m", families[0][1]))
    else:
        fields += [Field(f"displacement_{a}", "displacement", "m", u) for a, u in families]
        fields.append(Field("relative_displacement", "relative_displacement", "m", -point.slip))
        fields.append(Field("beta", "relative_displacement", "m", norm(point.slip)))
    if point.g is not None:
        fields += [
            Field(f"curvature_{a}", "curvature", "1/m", norm(curvature_vector(f, g)))
            for a, (f, g) in enumerate(zip(point.f, point.g, strict=True), start=1)
        ]
    fields.append(Field("shear_angle", "shear_angle", "rad", shear_angle(point.f, point.fibres)))
    fields += [Field(f"stretch_{a}", "stretch", "", stretch(f)) for a, f in enumerate(point.f, 1)]
    return tuple(fields)


class FieldProbe:
    """Evaluates chosen fields on this rank's own cells at the same reference points."""

    def __init__(
        self,
        model: Model,
        groups: Sequence[str],
        points: NDArray[np.float64],
        cells: NDArray[np.int32] | None = None,
    ) -> None:
        """Compile the evaluation; collective.

        Args:
            model: The model whose present field is evaluated.
            groups: Groups of fields; those that the model lacks are left out.
            points: Reference points, shape (n, 2).
            cells: Some of the own cells; all if None.
        """
        mesh = model.sheet.mesh
        own = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        self.fields = tuple(f for f in available(model) if f.group in groups)
        self.cells = own if cells is None else cells
        self._mesh = mesh
        self._points_per_cell = len(points)
        everything = [f.expression for f in self.fields]
        self._values = compile_expression(ufl.as_vector(_components(everything)), points)
        place = ufl.SpatialCoordinate(mesh)
        self._places: fem.Expression = compile_expression(place, points)

    def positions(self) -> NDArray[np.float64]:
        """Return the reference positions of all points, shape (cells, n, 2), m."""
        return self._evaluate(self._places, 2)

    def together(self) -> NDArray[np.float64]:
        """Return all fields one after the other, shape (cells, n, components of all)."""
        return self._evaluate(self._values, sum(f.size for f in self.fields))

    def values(self) -> dict[str, NDArray[np.float64]]:
        """Return each field at all points, shape (cells, n, components)."""
        parts = np.split(self.together(), np.cumsum([f.size for f in self.fields])[:-1], axis=2)
        return {f.name: part for f, part in zip(self.fields, parts, strict=True)}

    def _evaluate(self, expression: fem.Expression, size: int) -> NDArray[np.float64]:
        values: NDArray[np.float64] = expression.eval(self._mesh, self.cells)
        return values.reshape(len(self.cells), self._points_per_cell, size)


def _components(expressions: Sequence[Any]) -> list[Any]:
    components: list[Any] = []
    for e in expressions:
        components += [e] if e.ufl_shape == () else [e[i] for i in range(e.ufl_shape[0])]
    return components


def interpolated(model: Model, name: str) -> fem.Function:
    """Return a field of the present state as a function, discontinuous between cells; collective.

    Args:
        model: The model.
        name: Name of the field, such as ``shear_angle``.

    Raises:
        KeyError: If the model's effects give it no meaning.
    """
    fields = {f.name: f for f in available(model)}
    if name not in fields:
        raise KeyError(f"the effects of this case have no field {name!r}, but {', '.join(fields)}")
    shape = () if fields[name].size == 1 else (fields[name].size,)
    mesh, degree = model.sheet.mesh, model.balance.degree
    element = basix.ufl.element("DG", "triangle", degree, shape=shape)
    space = fem.functionspace(mesh, element)
    function = fem.Function(space, name=name)
    points = basix.ufl.element("DG", "triangle", degree).basix_element.points
    probe = FieldProbe(model, [fields[name].group], points)
    rows = function.x.array.reshape(-1, fields[name].size)
    rows[space.dofmap.list[: len(probe.cells)]] = probe.values()[name]
    function.x.scatter_forward()
    return function
