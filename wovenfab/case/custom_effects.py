"""A user's own effects, each a Python file beside the case that names it.

Such a file is run only because a case names it, and leaves nothing behind: the
effect is passed on as an object, so that two cases may each have their own effect
of the same name.
"""

from __future__ import annotations

import re
import sys
import traceback
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import ufl
from pydantic_core import PydanticCustomError

from wovenfab import forms
from wovenfab.case import units
from wovenfab.case.document import FILE, LAW, existing_file
from wovenfab.case.effects import RESISTIBLE, CustomEffect, CustomEffects, Scene
from wovenfab.case.errors import case_error, one_of, value_error
from wovenfab.forms.effect import Effect, Values
from wovenfab.forms.kinematics import Point, point_of
from wovenfab.forms.table import COEFFICIENTS, TABLE
from wovenfab.lacking import LackingError
from wovenfab.plain_text import in_brief

#: Keys of an effect that are no parameters.
RESERVED = (FILE, LAW, TABLE)
_NAME = re.compile(r"[a-zA-Z][a-zA-Z0-9_]*")


def custom_effects(files: Mapping[str, Any], folder: Path) -> CustomEffects:
    """Return the effects that a case in a folder names by (perhaps invalid) files, in its order."""
    effects: dict[str, CustomEffect | PydanticCustomError] = {}
    for key, file in files.items():
        try:
            effects[key] = _custom_effect(key, file, folder)
        except PydanticCustomError as error:
            effects[key] = error
    return effects


def _custom_effect(key: str, value: Any, folder: Path) -> CustomEffect:
    path = existing_file(value, folder, (".py",))
    if key in forms.effects():
        raise value_error(f"there is an effect '{key}' already", "Give yours another name.")
    if not _NAME.fullmatch(key):
        raise value_error("the name of an effect is a letter, then letters, digits and '_'")
    effect = _loaded(path, value)
    if effect.name != key:
        raise value_error(
            f"{value} defines the effect '{effect.name}', not '{key}'",
            f"Use '{effect.name}' as the key here, or set name=\"{key}\" there.",
        )
    with _faults(path, value):
        resisted = frozenset().union(*(law.resists for law in effect.all_laws))
        if unknown := sorted(resisted - set(RESISTIBLE)):
            raise value_error(
                f"{value}: the effect resists '{unknown[0]}', which is not known",
                f"It may be {one_of(RESISTIBLE)}.",
            )
        for law in effect.all_laws:
            _check_parameters(law, value)
            _require_numbers(law)
    return CustomEffect(effect, path)


@contextmanager
def _faults(path: Path, value: str) -> Iterator[None]:
    """Take what fails inside for a fault of a file, told with the last of its lines."""
    try:
        yield
    except PydanticCustomError:
        raise
    except (Exception, SystemExit) as error:
        line = "".join(f":{line}" for line in _lines(error, path)[-1:])
        raise value_error(f"{value}{line}: {in_brief(error)}", REMEDY) from error


def _loaded(path: Path, value: str) -> Effect:
    """Return ``EFFECT`` of a file, which is run for that."""
    # As if it lay in forms/, so that it can be moved there as it is.
    module = ModuleType(f"wovenfab.forms.custom:{path}")
    module.__package__, module.__file__ = "wovenfab.forms", str(path)
    sys.modules[module.__name__] = module  # dataclasses look themselves up there
    try:
        exec(compile(path.read_bytes(), str(path), "exec", dont_inherit=True), module.__dict__)
    except SyntaxError as error:
        line = error.lineno if error.filename == str(path) else _line(error, path)
        raise value_error(f"{value}:{line}: {error.msg}", "This is not valid Python.") from error
    except (Exception, SystemExit) as error:
        old = isinstance(error, ImportError) and (error.name or "").partition(".")[0] == "forms"
        remedy = "Import from wovenfab.forms in place of forms." if old else ""
        raise value_error(f"{value}:{_line(error, path)}: {in_brief(error)}", remedy) from error
    finally:
        sys.modules.pop(module.__name__)
    if "EFFECT" not in module.__dict__:
        raise value_error(f"{value} defines no EFFECT", "It must end with 'EFFECT = Effect(...)'.")
    effect = module.__dict__["EFFECT"]
    if not isinstance(effect, Effect):
        raise value_error(
            f"EFFECT in {value} is of type {type(effect).__name__}, not Effect",
            "It must be an Effect of wovenfab.forms.effect.",
        )
    return effect


def _line(error: BaseException, path: Path) -> int | None:
    """Return the last line of a file that led to an error, or its first."""
    return [1, *_lines(error, path)][-1]


def _lines(error: BaseException, path: Path) -> list[int | None]:
    frames = traceback.extract_tb(error.__traceback__)
    return [frame.lineno for frame in frames if frame.filename == str(path)]


def _check_parameters(effect: Effect, value: str) -> None:
    named: list[tuple[Any, str]] = [(p, "parameter") for p in effect.parameters]
    named += [(v, "internal variable") for v in effect.memory]
    times = Counter(one.name for one, _ in named)
    for one, kind in reversed(named):
        if not _NAME.fullmatch(one.name) or one.name in RESERVED or times[one.name] > 1:
            article = "an" if kind[0] in "aeiou" else "a"
            raise value_error(
                f"{value}: {article} {kind} cannot be named {one.name!r}",
                f"Names are unique, of letters, digits and '_', and not {one_of(RESERVED)}.",
            )
    for one, kind in named:
        try:
            factor, _ = units.in_si("" if one.unit == "1" else one.unit)
        except ValueError as error:
            raise value_error(f"{value}: the {kind} '{one.name}' has {error}") from error
        if factor != 1:
            raise value_error(
                f"{value}: the unit '{one.unit}' of '{one.name}' is not an SI unit",
                "Write it in m, kg, s, N, J or rad; a case may use any other.",
            )


#: What is asked of the functions of an effect.
REMEDY = (
    "Its functions return one number in J/m^2 (an energy), W/m^2 (a dissipation) or the unit of "
    "an internal variable (its update), made of what they are given by Python's operators and the "
    "functions of UFL."
)


@contextmanager
def custom_effect_errors(scene: Scene) -> Iterator[None]:
    """Take what fails inside, where a scene is built, for a fault of the user's own effects.

    Raises:
        CaseError: If the scene has any, with their files and the cause.
    """
    try:
        yield
    except (OSError, MemoryError, LackingError):
        raise
    except (Exception, SystemExit) as error:
        lines = {e.file: _lines(error, e.file) for e in scene if e.file}
        if not lines:
            raise
        guilty = {file: of[-1] for file, of in lines.items() if of} or dict.fromkeys(lines)
        files, line = ", ".join(file.name for file in guilty), next(iter(guilty.values()))
        message = f"the effect cannot be compiled: {in_brief(error)}"
        raise case_error(files, message, REMEDY, line) from error


def _require_numbers(effect: Effect) -> None:
    """Call the functions of an effect with symbols, and raise what gives no number.

    What UFL and the compiler make of the numbers is found where a model is built, as for effects
    of forms/; :func:`custom_effect_errors` tells of it.

    Raises:
        ValueError: If a function gives something else than one number at each point.
        Exception: Whatever the functions raise.
    """
    point, values = _symbols(effect)
    if effect.energy is not None:
        _require_scalar("energy", effect.energy(point, values))
    if effect.strains is not None:
        for strain in effect.strains(point, values):
            _require_scalar("the measure of a strain", strain.measure)
            _require_scalar("the stiffness of a strain", strain.stiffness)
    if effect.measure is not None and effect.dissipation is not None:
        rate = ufl.variable(effect.measure(point))
        _require_scalar("dissipation", effect.dissipation(rate, values))
    if effect.bound is not None:
        _require_scalar("the strength of a bound", effect.bound.strength(values))
    for variable in effect.memory:
        updated = variable.update(point, point, values, 1.0)
        _require_scalar(f"the update of '{variable.name}'", updated)
    if effect.stretch_stiffness is not None:
        one = np.ones(1)
        ones: dict[str, Any] = {
            p.name: (one, one) if p.per_family else one for p in effect.parameters
        }
        if effect.table is not None:
            rows = np.ones((3, COEFFICIENTS))
            ones[TABLE] = (rows, rows) if effect.table.per_family else rows
        if np.shape(np.array(effect.stretch_stiffness(ones), dtype=float)) not in ((2,), (2, 1)):
            raise ValueError("the stiffness by stretch gives something else than two numbers")


def _symbols(effect: Effect) -> tuple[Point, Values]:
    """Return a point of a sheet, and values of parameters and internal variables."""
    import basix.ufl  # not for those without effects of their own

    def element(degree: int, size: int) -> Any:
        return basix.ufl.element("Lagrange", "triangle", degree, shape=(size,))

    mesh = ufl.Mesh(element(1, 2))
    field = ufl.Coefficient(ufl.FunctionSpace(mesh, element(2, 2 * effect.needs.placements)))
    fibres = (ufl.Constant(mesh, shape=(2,)), ufl.Constant(mesh, shape=(2,)))
    values: dict[str, Any] = {
        p.name: (ufl.Constant(mesh), ufl.Constant(mesh)) if p.per_family else ufl.Constant(mesh)
        for p in effect.parameters
    } | {v.name: ufl.Constant(mesh) for v in effect.memory}
    if effect.table is not None:
        pieces = ufl.Constant(mesh, shape=(3, COEFFICIENTS))
        values[TABLE] = (pieces, pieces) if effect.table.per_family else pieces
    return point_of(field, fibres, effect.needs.second_gradient), values


def _require_scalar(what: str, given: Any) -> None:
    try:
        value = ufl.as_ufl(given)
    except (TypeError, ValueError):
        value = None
    if not isinstance(value, ufl.classes.Expr) or isinstance(value, ufl.classes.Condition):
        raise ValueError(f"{what} gives {type(given).__name__}, not a number")
    if value.ufl_shape != ():
        raise ValueError(f"{what} gives a value of shape {value.ufl_shape}, not one number")
