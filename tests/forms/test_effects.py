"""Each effect of the catalogue: consistent derivatives, frame indifference, symmetry.

The tests run over whatever effects the folder holds, so that a new one is tested
like the others as soon as its file is there.
"""

from __future__ import annotations

from math import cos, pi, sin
from typing import Any

import numpy as np
import pytest

from tests import scenes
from wovenfab.forms import effects
from wovenfab.forms.effect import Effect
from wovenfab.forms.table import TABLE, ForceTable
from wovenfab.model.model import Model, Numerics

#: All laws that are functions; a set-valued one has no potential of the rate.
ALL = [law for e in effects().values() for law in e.all_laws if not law.set_valued]
STORED = [e for e in ALL if not e.dissipative]
STRAINED = [e for e in ALL if e.strains is not None]
ON_FACETS = [e for e in ALL if e.facet_strains is not None]
SHEET = scenes.sheet(1.0, 1.0, 0.5, fibres=(0.3, -0.9))


def each(effects: list[Effect]) -> pytest.MarkDecorator:
    """Return the mark of a test that runs with each of some effects."""
    return pytest.mark.parametrize(
        "effect", [pytest.param(e, marks=marks(e)) for e in effects], ids=key
    )


def marks(effect: Effect) -> list[pytest.MarkDecorator]:
    """Return the marks of tests of an effect: of two laws with internal variables one is quick."""
    return [pytest.mark.slow] if effect.law == "iwan" else []


def key(effect: Effect) -> str:
    """Return the name of an effect and its law, as ``scenes.effect`` takes it."""
    return f"{effect.name}:{effect.law}"


#: Tables that the strains of a random state cross and leave.
TABLES = (ForceTable((0.05, 0.1, 0.2), (0.1, 0.3, 0.4)), ForceTable((0.1, 0.15), (0.2, 0.5)))


def plain_values(effect: Effect) -> dict[str, Any]:
    """Return distinct values of order one for the parameters of any effect."""
    tables = (
        {} if effect.table is None else {TABLE: TABLES if effect.table.per_family else TABLES[0]}
    )
    numbers = {
        p.name: (1.3 + i, 0.7 + i) if p.per_family else 1.9 + i
        for i, p in enumerate(effect.parameters)
    }
    slides = {"strength": 0.03} if effect.lost else {}  # so that some points slide, and some stick
    return tables | numbers | slides


def scene(effect: Effect, mixed: bool = False, values: dict | None = None) -> Model:
    """Return a model of the effect alone in a random, strongly deformed state."""
    numerics = Numerics(2, history=2, mixed=mixed)
    numbers = {effect.name: values or plain_values(effect)}
    model = scenes.model(SHEET, [key(effect)], numerics, numbers, rotation_edges=("left",))
    random = np.random.default_rng(20)
    for field in (model.field, *model.history):
        field.x.array[:] = 0.02 * random.standard_normal(field.x.array.size)
    model.last.x.array[:] = model.field.x.array
    for weight, value in zip(model.rate_weights, (3.0, -4.0, 1.0), strict=False):
        weight.value = value
    return model


def jacobian_times(model: Model, direction: np.ndarray) -> np.ndarray:
    matrix = scenes.tangent(model)
    x, y = matrix.createVecs()
    x.array_w[:] = direction
    matrix.mult(x, y)
    return y.array_r.copy()


@each(ALL)
def test_residual_is_the_derivative_of_the_potential(effect: Effect) -> None:
    model = scene(effect)
    start = model.field.x.array.copy()
    direction = np.random.default_rng(21).standard_normal(start.size)
    slope, at_start = scenes.internal_force(model) @ direction, scenes.energy(model)
    remainders = []
    for h in 2e-4 / 2.0 ** np.arange(4):
        model.field.x.array[:] = start + h * direction
        remainders.append(abs(scenes.energy(model) - at_start - h * slope))
    assert scenes.orders(remainders).min() > 1.9
    assert slope != 0


@each(ALL)
def test_jacobian_is_the_derivative_of_the_residual(effect: Effect) -> None:
    model = scene(effect)
    start = model.field.x.array.copy()
    direction = np.random.default_rng(22).standard_normal(start.size)
    product, at_start = jacobian_times(model, direction), scenes.internal_force(model)
    remainders = []
    for h in 2e-4 / 2.0 ** np.arange(4):
        model.field.x.array[:] = start + h * direction
        remainders.append(np.linalg.norm(scenes.internal_force(model) - at_start - h * product))
    linear = remainders[-1] < 1e-12 * np.linalg.norm(product)  # near the state, if in pieces
    assert linear or scenes.orders(remainders).min() > 1.9
    assert np.linalg.norm(product) > 0


@each(ALL)
def test_jacobian_is_symmetric(effect: Effect) -> None:
    model = scene(effect)
    a, b = np.random.default_rng(23).standard_normal((2, model.field.x.array.size))
    left, right = a @ jacobian_times(model, b), b @ jacobian_times(model, a)
    assert left == pytest.approx(right, rel=1e-11)


@each(ALL)
def test_mixed_tangent_is_the_plain_one_where_the_last_iterate_is_the_present(
    effect: Effect,
) -> None:
    plain, mixed = scene(effect), scene(effect, mixed=True)
    direction = np.random.default_rng(24).standard_normal(plain.field.x.array.size)
    assert jacobian_times(mixed, direction) == pytest.approx(
        jacobian_times(plain, direction), rel=1e-10, abs=1e-10
    )


@each(STRAINED)
def test_the_positive_part_of_a_tangent_is_positive_where_the_whole_one_is_not(
    effect: Effect,
) -> None:
    model, lowest = scene(effect), []
    for share in (1.0, 0.0):
        model.geometric_weight.value = share
        matrix = scenes.tangent(model)
        values = np.linalg.eigvalsh(matrix.convert("dense").getDenseArray())
        lowest.append(values[0] / values[-1])
    whole, part = lowest
    assert whole < (-0.1 if effect.table is None else -0.01)  # a soft table is nearer to zero
    assert part > -1e-14


@pytest.mark.parametrize(
    ("effect", "parameter"),
    [pytest.param(e, p.name, marks=marks(e)) for e in ALL for p in e.parameters],
    ids=lambda v: key(v) if isinstance(v, Effect) else v,
)
def test_jacobian_changes_when_the_parameter_does(effect: Effect, parameter: str) -> None:
    values = plain_values(effect)
    old = values[parameter]
    changed = {
        **values,
        parameter: tuple(1.1 * v for v in old) if isinstance(old, tuple) else 1.1 * old,
    }
    direction = np.random.default_rng(25).standard_normal(scene(effect).field.x.array.size)
    before = jacobian_times(scene(effect), direction)
    after = jacobian_times(scene(effect, values=changed), direction)
    assert np.linalg.norm(after - before) > 1e-4 * np.linalg.norm(before)


@each(STORED)
@pytest.mark.parametrize("angle", [pi / 2, 2.1])
def test_rigid_rotation_stores_nothing_and_needs_no_force(effect: Effect, angle: float) -> None:
    model = scenes.model(SHEET, [key(effect)], values={effect.name: plain_values(effect)})
    turn = np.array([[cos(angle) - 1, -sin(angle)], [sin(angle), cos(angle) - 1]])
    scenes.set_field(model.field, lambda x: turn @ x[:2])
    force, stored = scenes.internal_force(model), scenes.energy(model)
    # Round-off is measured by what a random displacement of that size would need.
    random = np.random.default_rng(26).standard_normal(force.size)
    needed = jacobian_times(model, random)
    assert np.abs(force).max() < 1e-13 * np.abs(needed).max()
    assert abs(stored) < 1e-24 * abs(random @ needed)


@each(ON_FACETS)
def test_swapping_the_sides_of_every_facet_changes_nothing(
    effect: Effect, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = scene(effect)
    as_built = scenes.internal_force(model)

    scenes.swap_sides(monkeypatch)
    assert scenes.internal_force(scene(effect)) == pytest.approx(as_built, rel=1e-12, abs=1e-13)


def test_the_six_effects_of_the_paper_are_there() -> None:
    assert set(scenes.TABLE_1) <= set(effects())
