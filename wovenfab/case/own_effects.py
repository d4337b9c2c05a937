"""A user's own effects, each a Python file beside the case that names it.

Such a file is run only because a case names it, and leaves nothing behind: the
effect is handed on as an object, so that two cases may each have their own effect
of the same name.
"""

from __future__ import annotations

import re
import sys
import traceback
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from pydantic_core import PydanticCustomError

from forms import catalogue
from forms.effect import Effect

from . import units
from .files import FILE, LAW, existing_file
from .needs import RESISTIBLE
from .own_trial import REMEDY, try_forms
from .problems import in_brief, one_of, wrong

#: Keys of an effect that are no parameters.
RESERVED = (FILE, LAW)
_NAME = re.compile(r"[a-zA-Z][a-zA-Z0-9_]*")


@dataclass(frozen=True)
class OwnEffect:
    """An effect and the file it was read from."""

    effect: Effect
    file: Path


#: By key in the case; what is wrong with a file stands in place of its effect.
OwnEffects = Mapping[str, OwnEffect | PydanticCustomError]


def own_effects(data: Any, folder: Path) -> OwnEffects:
    """Return the effects that a case names by file, in its order.

    Args:
        data: The case as plain data; it may be invalid.
        folder: Where the case lies.
    """
    section = data.get("effects") if isinstance(data, dict) else None
    given = section.items() if isinstance(section, dict) else ()
    files = {key: v[FILE] for key, v in given if isinstance(v, dict) and FILE in v}
    found: dict[str, OwnEffect | PydanticCustomError] = {}
    for key, file in files.items():
        try:
            found[key] = _own_effect(key, file, folder)
        except PydanticCustomError as error:
            found[key] = error
    return found


def _own_effect(key: str, value: Any, folder: Path) -> OwnEffect:
    path = existing_file(value, folder, (".py",))
    if key in catalogue.effects():
        raise wrong(f"there is an effect '{key}' already", "Give yours another name.")
    if not _NAME.fullmatch(key):
        raise wrong("the name of an effect has letters, digits and '_' only")
    effect = _loaded(path, value)
    if effect.name != key:
        raise wrong(
            f"{value} defines the effect '{effect.name}', not '{key}'",
            f"Use '{effect.name}' as the key here, or set name=\"{key}\" there.",
        )
    resisted = frozenset().union(*(law.resists for law in effect.all_laws))
    if unknown := sorted(resisted - set(RESISTIBLE)):
        raise wrong(
            f"{value}: the effect resists '{unknown[0]}', which is not known",
            f"It may be {one_of(RESISTIBLE)}.",
        )
    for law in effect.all_laws:
        _check_parameters(law, value)
        _check_forms(law, path, value)
    return OwnEffect(effect, path)


def _loaded(path: Path, value: str) -> Effect:
    """Return ``EFFECT`` of a file, which is run for that."""
    # As if it lay in forms/, so that it can be moved there as it is.
    module = ModuleType(f"forms.own:{path}")
    module.__package__, module.__file__ = "forms", str(path)
    sys.modules[module.__name__] = module  # dataclasses look themselves up there
    try:
        exec(compile(path.read_bytes(), str(path), "exec", dont_inherit=True), module.__dict__)
    except SyntaxError as error:
        line = error.lineno if error.filename == str(path) else _line(error, path)
        raise wrong(f"{value}:{line}: {error.msg}", "This is not valid Python.") from error
    except (Exception, SystemExit) as error:
        raise wrong(f"{value}:{_line(error, path)}: {in_brief(error)}") from error
    finally:
        sys.modules.pop(module.__name__)
    if "EFFECT" not in module.__dict__:
        raise wrong(f"{value} defines no EFFECT", "It must end with 'EFFECT = Effect(...)'.")
    effect = module.__dict__["EFFECT"]
    if not isinstance(effect, Effect):
        raise wrong(
            f"EFFECT in {value} is of type {type(effect).__name__}, not Effect",
            "It must be an Effect of forms.effect.",
        )
    return effect


def _check_forms(effect: Effect, path: Path, value: str) -> None:
    problem = ""
    try:
        try_forms(effect)
    except Exception as error:
        line = "".join(f":{line}" for line in _lines(error, path)[-1:])
        problem = f"{value}{line}: {in_brief(error)}"
    if problem:  # told out here, where nothing holds the symbols any more
        raise wrong(problem, REMEDY)


def _line(error: BaseException, path: Path) -> int | None:
    """Return the last line of a file that led to an error, or its first."""
    return [1, *_lines(error, path)][-1]


def _lines(error: BaseException, path: Path) -> list[int | None]:
    frames = traceback.extract_tb(error.__traceback__)
    return [frame.lineno for frame in frames if frame.filename == str(path)]


def _check_parameters(effect: Effect, value: str) -> None:
    for name, times in Counter(p.name for p in effect.parameters).items():
        if not _NAME.fullmatch(name) or name in RESERVED or times > 1:
            raise wrong(
                f"{value}: a parameter cannot be named {name!r}",
                f"Names are unique, of letters, digits and '_', and not {one_of(RESERVED)}.",
            )
    for parameter in effect.parameters:
        try:
            factor, _ = units.in_si("" if parameter.unit == "1" else parameter.unit)
        except ValueError as error:
            raise wrong(f"{value}: the parameter '{parameter.name}' has {error}") from error
        if factor != 1:
            raise wrong(
                f"{value}: the unit '{parameter.unit}' of '{parameter.name}' is not an SI unit",
                "Write it in m, kg, s, N, J or rad; a case may use any other.",
            )
