"""The JSON Schema as editors use it, and the page on the effects."""

from __future__ import annotations

from typing import Any

import forms
from forms.effect import Effect, Parameter
from wovenfab.case.document import FROM
from wovenfab.case.quantities import Json

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
    text = {"description": schema["description"]} if "description" in schema else {}
    return text | {"anyOf": [schema, {"type": "null"}]}


_HEAD = """\
# The effects and their parameters

Written by `make docs` from the files in [forms/](../forms). Energies and potentials are in
[the model](model.md); units are those in which results are given, a case may use any other.

| effect | what it is | parameters | what it needs |
|---|---|---|---|
"""


def effects_page() -> str:
    """Return the page in Markdown."""
    known = forms.effects().values()
    return _HEAD + "".join(_row(law, law is effect) for effect in known for law in effect.all_laws)


def _row(effect: Effect, default: bool) -> str:
    name = f"`{effect.name}`" if default else f"`{effect.name}` with `law: {effect.law}`"
    parameters = "; ".join(map(_parameter, effect.parameters))
    needs = (
        (effect.needs.placements == 2, "two placements"),
        (effect.needs.second_gradient, "second gradients"),
        (effect.needs.rate, "rates"),
        (effect.needs.increment or bool(effect.memory), "history"),
    )
    needed = ", ".join(what for is_needed, what in needs if is_needed)
    cells = (name, effect.summary, parameters, needed)
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |\n"


def _parameter(p: Parameter) -> str:
    unit = "a number" if p.unit == "1" else p.unit
    bound = "" if p.zero_allowed else ", above 0"
    bound = bound if p.above is None else f", above {p.above:g}"
    default = "" if p.default is None else f", {p.default:g} unless given"
    family = ", may differ between the families" if p.per_family else ""
    return f"`{p.name}` ({unit}{bound}{default}{family}): {p.meaning}"
