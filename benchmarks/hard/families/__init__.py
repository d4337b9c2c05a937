"""The families of hard cases: every module here that defines ``FAMILY``."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from benchmarks.hard.row import Family, Row


@cache
def families() -> tuple[Family, ...]:
    """Return all families, in the order of the page."""
    members = [
        importlib.import_module(f"{__package__}.{module.name}").FAMILY
        for module in pkgutil.iter_modules(__path__)
    ]
    return tuple(sorted(members, key=lambda family: family.number))


def row_named(name: str) -> Row:
    """Return a row.

    Raises:
        KeyError: There is none of that name.
    """
    return {row.name: row for family in families() for row in family.rows}[name]
