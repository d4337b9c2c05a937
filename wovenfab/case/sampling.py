"""What formulas come to at points of the sheet."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import needs
from .boundary import EdgeCondition
from .expression import NUMPY_FUNCTIONS, Expression
from .parameters import quantity
from .problems import Path
from .scene import Scene, SceneEffect, Value

Array = NDArray[np.float64]
#: Where, what and the remedy.
Finding = tuple[Path, str, str]

_REMEDY = "Keep it in bounds, as with max(..., ...) or if(..., ..., ...)."


def samples_of(length: float, width: float) -> tuple[Array, Array]:
    """Return x and y (m, flat) of a 50 by 50 grid that covers a rectangle, its edges included."""
    x, y = np.meshgrid(np.linspace(0, length, 50), np.linspace(0, width, 50))
    return x.ravel(), y.ravel()


def values_at(value: Value, x: Array, y: Array, program: float = 0.0) -> Array:
    """Return a parameter's value at points, or a force's for a program (m)."""
    if not isinstance(value, Expression):
        return np.full_like(x, value)
    known = {"x": x, "y": y, "program": program}
    with np.errstate(all="ignore"):
        found: Array = np.zeros_like(x) + value.evaluate(known, NUMPY_FUNCTIONS)
    return found


def unfit_values(scene: Scene, x: Array, y: Array) -> Iterator[Finding]:
    """Yield each formula of a scene that is out of bounds at any of some points.

    Args:
        scene: The effects with their values.
        x: First coordinates of the points, m.
        y: Second coordinates, m.
    """
    for e in scene:
        for p in e.effect.parameters:
            bounds = quantity(p)
            for path, value in _formulas(("effects", e.name, p.name), e.values[p.name]):
                found = values_at(value, x, y)
                if not np.isfinite(found).all():
                    yield _infinite(path, found, x, y)
                    continue
                worst = int(np.argmin(found))
                if broken := bounds.broken(found[worst]):
                    place = _place(x, y, worst)
                    yield path, f"must {broken}, but is {found[worst]:g} at {place}", _REMEDY


def unsound_places(scene: Scene, x: Array, y: Array) -> Iterator[Finding]:
    """Yield what nothing resists at any of some points, where formulas vanish."""
    if needs.lacking(scene, needs.acting(scene)):
        return  # which is so everywhere
    active = np.array([_acting(e, x, y) for e in scene])
    patterns, first = np.unique(active, axis=1, return_index=True)
    for pattern, i in zip(patterns.T, first, strict=True):
        lack = needs.lacking(scene, [e for e, on in zip(scene, pattern, strict=True) if on])
        if lack:
            place = _place(x, y, int(i))
            yield ("effects",), f"{lack[1]} at {place}", "Keep the values above zero there."
            return


def unfit_conditions(
    edge: str, conditions: Sequence[EdgeCondition], x: Array, y: Array, programs: Sequence[float]
) -> Iterator[Finding]:
    """Yield each formula of an edge that has no finite value at any of its points.

    Args:
        edge: Name of the edge.
        conditions: What is prescribed there.
        x: First coordinates of points on the edge, m.
        y: Second coordinates, m.
        programs: Displacements (m) that the program reaches.
    """
    for i, condition in enumerate(conditions):
        for k, component in enumerate(condition.components):
            if component.expression is not None:
                path: Path = ("boundary", edge, i, "displacement", k)
                over = [component.at(x, y, program) for program in programs]
                yield from _if_infinite(path, np.sum(over, axis=0), x, y)
        for path, value in _formulas(("boundary", edge, i, "force"), condition.force or ()):
            over = [values_at(value, x, y, program) for program in programs]
            yield from _if_infinite(path, np.sum(over, axis=0), x, y)


def _formulas(path: Path, given: Any) -> Iterator[tuple[Path, Expression]]:
    """Yield a parameter's formula, or those of a pair."""
    if isinstance(given, tuple):
        same = len(set(given)) == 1
        for i, value in enumerate(given[:1] if same else given):
            yield from _formulas(path if same else (*path, i), value)
    elif isinstance(given, Expression):
        yield path, given


def _acting(e: SceneEffect, x: Array, y: Array) -> NDArray[np.bool_]:
    everywhere = np.ones_like(x, dtype=bool)
    for given in e.values.values():
        values: Iterable[Value] = given if isinstance(given, tuple) else (given,)
        for value in values:
            everywhere &= values_at(value, x, y) > 0
    return everywhere


def _if_infinite(path: Path, found: Array, x: Array, y: Array) -> Iterator[Finding]:
    if not np.isfinite(found).all():
        yield _infinite(path, found, x, y)


def _infinite(path: Path, found: Array, x: Array, y: Array) -> Finding:
    place = _place(x, y, int(np.argmin(np.isfinite(found))))
    return path, f"has no finite value at {place}", ""


def _place(x: Array, y: Array, i: int) -> str:
    return f"x = {x[i]:.4g} m, y = {y[i]:.4g} m"
