"""The errors of pydantic in the words of this project, with their lines."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import ValidationError

from .document import Document
from .problems import Path, Problem, describe, near_miss, nearest, one_of


def problems_in(
    error: ValidationError, document: Document, schema: Mapping[str, Any]
) -> Iterator[Problem]:
    """Yield a problem for each error.

    Args:
        error: What pydantic found in the document's data.
        document: The data with its lines.
        schema: JSON Schema of the case, for the keys that there are.
    """
    misspelt: set[Path] = set()
    # What is missing may be there under a misspelt key, so that this comes first.
    for item in sorted(error.errors(include_url=False), key=lambda e: e["type"] == "missing"):
        missing = item["type"] == "missing"
        path = document.locate(item["loc"], missing)
        keys = _keys(schema, document.data, path[:-1])
        if path in misspelt or (item["type"] == "too_short" and item["input"]):
            continue  # the items of the list are wrong, which is said there
        if item["type"] == "extra_forbidden":
            misspelt.add((*path[:-1], nearest(path[-1], keys) or ""))
        message, remedy = _words(dict(item), path, keys)
        if item["type"].startswith("union_tag"):
            path = (*path, item["ctx"]["discriminator"].strip("'()"))
        if missing and isinstance(path[-1], int):
            path = path[:-1]
        yield document.problem(path, message, remedy)


def _words(item: Mapping[str, Any], path: Path, keys: Mapping[str, Any]) -> tuple[str, str]:
    """Return message and remedy of one error; ``keys`` are those beside its own."""
    given, context = item["input"], item.get("ctx", {})
    match item["type"]:
        case "wrong":
            return context["message"], context["remedy"]
        case "missing" if isinstance(path[-1], int):
            return f"expected two values, got {path[-1]}", ""
        case "missing":
            return "missing", _for_example(str(path[-1]), keys)
        case "extra_forbidden":
            noun = "effect" if path[:-1] == ("effects",) else "key"
            meant = near_miss(path[-1], keys)
            known = f"The {noun}s are {', '.join(keys)}."
            own = f"One of your own takes its file: '{path[-1]}: {{file: {path[-1]}.py}}'."
            if noun == "effect":
                return "unknown effect", f"{meant} {known}".strip() if meant else f"{known} {own}"
            law = keys.get("law", {}).get("const")
            return f"unknown key with the law '{law}'" if law else "unknown key", meant or known
        case "literal_error" | "union_tag_invalid":
            said = context.get("expected") or context["expected_tags"]
            options = said.replace("'", "").replace(" or ", ", ").split(", ")
            given = context.get("tag", given)
            return f"expected {one_of(options)}, got {describe(given)}", near_miss(given, options)
        case "union_tag_not_found":
            return "missing", "For example 'type: ramp'."
        case "too_short":
            return "the list is empty", ""
        case "too_long":
            return f"expected two values, got {context['actual_length']}", ""
        case "model_type" | "model_attributes_type" | "dict_type" | "mapping_type":
            return f"expected keys with values, got {describe(given)}", ""
        case "tuple_type" | "list_type":
            return f"expected a list, got {describe(given)}", ""
        case "string_type":
            return f"expected text, got {describe(given)}", "Put it in quotes."
        case "bool_type":
            return f"expected true or false, got {describe(given)}", ""
    return str(item["msg"]), ""


def _for_example(key: str, keys: Mapping[str, Any]) -> str:
    examples = keys.get(key, {}).get("examples")
    return f"For example '{key}: {_flow(examples[0])}'." if examples else ""


def _flow(value: Any) -> str:
    """Return a value as YAML in one line."""
    match value:
        case dict():
            return "{" + ", ".join(f"{k}: {_flow(v)}" for k, v in value.items()) + "}"
        case list():
            return "[" + ", ".join(map(_flow, value)) + "]"
    return str(value)


def _keys(schema: Mapping[str, Any], data: Any, path: Path) -> Mapping[str, Any]:
    """Return the schemas of the keys that may stand in the mapping at ``path``."""
    places = list(_forms(schema, schema, data))
    for part in path:
        data = data[part]
        places = [f for p in places for s in _inner(p, part) for f in _forms(schema, s, data)]
    return {k: v for p in places for k, v in p.get("properties", {}).items()}


def _forms(
    root: Mapping[str, Any], schema: Mapping[str, Any], data: Any
) -> Iterator[Mapping[str, Any]]:
    """Yield the alternatives of a schema, less those for another ``type`` or ``law``."""
    if "$ref" in schema:
        yield from _forms(root, root["$defs"][schema["$ref"].split("/")[-1]], data)
    for alternative in (*schema.get("anyOf", ()), *schema.get("oneOf", ())):
        yield from _forms(root, alternative, data)
    for key in ("type", "law") if isinstance(data, dict) else ():
        kind = schema.get("properties", {}).get(key, {}).get("const")
        if kind and data.get(key, kind) != kind:
            return
    if schema.get("type") in ("object", "array"):
        yield schema


def _inner(schema: Mapping[str, Any], part: str | int) -> Iterator[Mapping[str, Any]]:
    """Yield the schemas of one value in a mapping or a list."""
    if part in schema.get("properties", {}):
        yield schema["properties"][part]
    elif isinstance(schema.get("additionalProperties"), dict):
        yield schema["additionalProperties"]
    elif "items" in schema and isinstance(part, int):
        yield schema["items"]
