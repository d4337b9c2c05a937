"""The JSON Schema."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from forms import catalogue
from forms.effect import Effect, Needs, Parameter
from wovenfab.case import json_schema


def _objects(schema: Any) -> Iterator[dict[str, Any]]:
    if isinstance(schema, dict):
        if "properties" in schema:
            yield schema
        for value in schema.values():
            yield from _objects(value)
    elif isinstance(schema, list):
        for value in schema:
            yield from _objects(value)


def test_it_is_plain_json() -> None:
    schema = json_schema()
    assert json.loads(json.dumps(schema, allow_nan=False)) == schema


def test_every_key_is_described_and_no_other_is_allowed() -> None:
    schema = json_schema()
    effects = schema["$defs"]["Effects"]
    own = effects["additionalProperties"]
    assert own["required"] == ["file"]
    for section in _objects(schema):
        if section not in (effects, own):
            assert section["additionalProperties"] is False
        for key, value in section["properties"].items():
            definition = schema["$defs"].get(value.get("$ref", "").split("/")[-1], {})
            assert value.get("description") or definition.get("description"), key


def test_every_parameter_has_its_unit_and_meaning() -> None:
    definitions = json_schema()["$defs"]
    for name, effect in catalogue.effects().items():
        keys = definitions[name]["properties"]
        assert definitions[name]["required"] == [
            p.name for p in effect.parameters if p.default is None
        ]
        for p in effect.parameters:
            value = keys[p.name]
            assert value["description"] == p.meaning
            assert (value["anyOf"][0] if p.per_family else value)["unit"] == (p.unit or "1")


def test_a_new_effect_is_in_the_schema_without_another_edit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drag = Effect(
        name="drag",
        summary="Something new",
        parameters=(Parameter("factor", "N*s/m^3", "how much"),),
        needs=Needs(placements=2, rate=True),
        dissipation=lambda rate, values: rate,
        measure=lambda point: point,
    )
    monkeypatch.setattr(catalogue, "effects", lambda: {"drag": drag})
    schema = json_schema()
    assert schema["$defs"]["drag"]["properties"]["factor"]["unit"] == "N*s/m^3"
    assert schema["$defs"]["drag"]["description"] == "Something new"
