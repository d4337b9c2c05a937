"""Cases that start from another one and say only what differs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any, NamedTuple

from pydantic_core import PydanticCustomError

from .document import Document, read_document
from .files import LAW, existing_file
from .problems import CaseError, Path, near_miss

FROM = "from"
#: The key that says what kind of mapping it is; another kind takes nothing over.
_KINDS = ("type", LAW)
_ABSENT = "there is nothing here to take out"


class _Change(NamedTuple):
    """Something that a case puts in place of what it starts from, or adds to it.

    Attributes:
        path: Where.
        new: The value, None to take it out.
        beside: What the other file has there, by key.
    """

    path: Path
    new: Any
    beside: Mapping[str, Any]

    @property
    def known(self) -> bool:
        """Whether the other file has this key."""
        return self.path[-1] in self.beside


def resolved_document(path: FilePath) -> Document:
    """Return the contents of a case file with all that it takes over from others.

    Mappings are merged key by key, everything else is replaced, and null takes a key out.

    Raises:
        CaseError: A file cannot be read, or what they say does not fit together.
    """
    return _resolved(path, ())


def _resolved(path: FilePath, below: tuple[FilePath, ...]) -> Document:
    document = read_document(path)
    if not isinstance(document.data, dict) or FROM not in document.data:
        return document
    base_path = _base_of(document, path, (*below, path.resolve()))
    own = {key: value for key, value in document.data.items() if key != FROM}
    base = _resolved(base_path, (*below, path.resolve()))
    return _merged(base, replace(document, data=own))


def _base_of(document: Document, path: FilePath, known: tuple[FilePath, ...]) -> FilePath:
    """Return the file that a document starts from; ``known`` are those that may not return."""
    given = document.data[FROM]
    try:
        found = existing_file(given, path.parent, (".yaml", ".yml"))
    except PydanticCustomError as error:
        told = error.context or {}
        problem = document.problem((FROM,), told["message"], told["remedy"])
        raise CaseError([problem]) from error
    if found in known:
        loop = " from ".join(file.name for file in (*known[known.index(found) :], found))
        raise CaseError([document.problem((FROM,), f"this goes round in a circle: {loop}")])
    return path.parent / str(given)


def _merged(base: Document, own: Document) -> Document:
    """Return ``own`` laid over ``base``."""
    if not isinstance(base.data, dict):
        raise CaseError([base.problem((), "expected keys with values")])
    changes = list(_changes(base.data, own.data))
    absent = [change for change in changes if change.new is None and not change.known]
    if absent:
        raise CaseError(
            own.problem(c.path, _ABSENT, near_miss(c.path[-1], c.beside)) for c in absent
        )
    gone = {change.path for change in changes}
    kept = {
        path: place
        for path, place in base.places.items()
        if path not in own.places and not any(path[:n] in gone for n in range(len(path)))
    }
    return replace(own, data=_laid_over(base.data, own.data), places={**own.places, **kept})


def _changes(
    base: Mapping[str, Any], own: Mapping[str, Any], above: Path = ()
) -> Iterator[_Change]:
    """Yield where a mapping says something else than the one below it, or something new."""
    for key, new in own.items():
        if _merge(base.get(key), new):
            yield from _changes(base[key], new, (*above, key))
        else:
            yield _Change((*above, key), new, base)


def _laid_over(base: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """Return a mapping with what another one changes in it."""
    new = {k: _laid_over(base[k], v) if _merge(base.get(k), v) else v for k, v in own.items()}
    return {k: v for k, v in {**base, **new}.items() if k not in own or v is not None}


def _merge(base: Any, own: Any) -> bool:
    """Return whether a value is merged with the one below it, rather than put in its place."""
    if not isinstance(base, dict) or not isinstance(own, dict):
        return False
    return all(own.get(kind, base.get(kind)) == base.get(kind) for kind in _KINDS)
