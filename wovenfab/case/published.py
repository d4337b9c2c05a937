"""The JSON Schema as editors use it: of whole cases, and of those that start from another."""

from __future__ import annotations

from typing import Any

from .derived import FROM
from .values import Json

#: Ends the name of the definition of what says only a part.
_PART = "_part"


def published_schema(whole: Json) -> Json:
    """Return a schema for both kinds of cases, given that of a whole one.

    A case that starts from another may leave out every key, and take one out by null.
    """
    head = {key: whole[key] for key in ("$schema", "title", "description")}
    case = {key: value for key, value in whole.items() if key not in (*head, "$defs")}
    parts = {name + _PART: _part(value) for name, value in whole["$defs"].items()}
    return {
        **head,
        "if": {"type": "object", "required": [FROM]},
        "then": _part(case),
        "else": case,
        "$defs": whole["$defs"] | parts,
    }


def _part(schema: Any) -> Any:
    """Return the schema of something of which any part may be said."""
    if isinstance(schema, list):
        return [_part(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    left = {k: v for k, v in schema.items() if k not in ("required", "discriminator", "default")}
    part = {{"oneOf": "anyOf"}.get(k, k): _part(v) for k, v in left.items()}
    if "$ref" in part:
        part["$ref"] += _PART
    if isinstance(schema.get("properties"), dict):
        part["properties"] = {k: _or_null(_part(v)) for k, v in schema["properties"].items()}
    return part


def _or_null(schema: Json) -> Json:
    told = {"description": schema["description"]} if "description" in schema else {}
    return told | {"anyOf": [schema, {"type": "null"}]}
