"""The physics of a woven sheet in UFL: symbols only, no mesh and no solver."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

if __name__ != "wovenfab.forms":
    raise ImportError("the package forms is now wovenfab.forms", name="forms")

from wovenfab.forms.effect import Effect


@cache
def effects() -> Mapping[str, Effect]:
    """Return all effects by name, in alphabetical order of their files.

    Raises:
        ValueError: If two files define an effect of the same name.
    """
    package = importlib.import_module(__name__)
    found: dict[str, Effect] = {}
    for module in sorted(pkgutil.iter_modules(package.__path__), key=lambda m: m.name):
        effect = getattr(
            importlib.import_module(f"{package.__name__}.{module.name}"), "EFFECT", None
        )
        if isinstance(effect, Effect):
            if effect.name in found:
                raise ValueError(f"{module.name}.py: there is an effect {effect.name!r} already")
            found[effect.name] = effect
    return MappingProxyType(found)
