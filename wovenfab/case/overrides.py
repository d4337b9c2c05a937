"""Values that the command line puts in place of those of the case file."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from .document import Document, Place, parse_document
from .problems import OVERRIDE, CaseError, Path, dotted, refusal


def override(document: Document, text: str) -> Document:
    """Return the document with one value replaced.

    Args:
        document: What to change; it stays as it is.
        text: ``dotted.key=value``, the value in YAML; ``null`` takes the key out.

    Raises:
        CaseError: The text is malformed, or the key leads through a plain value.
    """
    key, equals, value = text.partition("=")
    path: Path = tuple(int(k) if k.isdecimal() else k for k in key.strip().split("."))
    if not equals or "" in path:
        raise refusal(
            OVERRIDE,
            f"expected 'key=value', got {text!r}",
            "For example --set time.steps_per_cycle=160.",
        )
    try:
        given = parse_document(value if value.strip() else "null", OVERRIDE)
    except CaseError as error:
        raise CaseError(replace(p, line=None, key=key.strip()) for p in error.problems) from error
    data = _with(document.data, path, given.data)
    places = {p: at for p, at in document.places.items() if p[: len(path)] != path}
    paths = [path[:n] for n in range(1, len(path))] + [path + p for p in given.places]
    return replace(document, data=data, places=dict.fromkeys(paths, Place(OVERRIDE, None)) | places)


def _with(data: Any, path: Path, value: Any, above: Path = ()) -> Any:
    """Return ``data`` with the value at ``path`` below ``above`` replaced, taken out if None."""
    first, *rest = path
    here = (*above, first)
    if isinstance(data, list):
        if not isinstance(first, int) or first >= len(data):
            raise _no_place(here, f"a list of {len(data)}, counted from 0")
        new = _with(data[first], tuple(rest), value, here) if rest else value
        return [*data[:first], new, *data[first + 1 :]]
    if not isinstance(data, dict | None):
        raise _no_place(here, "a plain value")
    others = {k: v for k, v in (data or {}).items() if k != str(first)}
    if not rest and value is None:
        return others
    old = (data or {}).get(str(first))
    return others | {str(first): _with(old, tuple(rest), value, here) if rest else value}


def _no_place(path: Path, holder: str) -> CaseError:
    above = dotted(path[:-1]) or "the case"
    return refusal(OVERRIDE, f"there is no such key, for {above} is {holder}", key=dotted(path))
