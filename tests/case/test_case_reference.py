"""The JSON Schema."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.case.reading import WriteCase
from wovenfab import forms
from wovenfab.case import json_schema, read_case

NewFile = Callable[[str, str], None]
DRAG = """\
from .effect import Effect, Needs, Parameter

EFFECT = Effect(
    name="drag",
    summary="Something new",
    parameters=(
        Parameter("factor", "N*s/m^3", "how much"),
        Parameter("power", "1", "exponent", default=2.0, above=1.0),
    ),
    needs=Needs(placements=2, rate=True),
    dissipation=lambda rate, values: rate,
    measure=lambda point: point,
)
"""


@pytest.fixture
def new_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[NewFile]:
    """Return a function that puts a file into a folder that counts as forms/ for one test."""
    monkeypatch.setattr(forms, "__path__", [*forms.__path__, str(tmp_path)])

    def write(name: str, text: str) -> None:
        (tmp_path / name).write_text(text)
        forms.effects.cache_clear()

    yield write
    forms.effects.cache_clear()
    for path in tmp_path.glob("*.py"):
        sys.modules.pop(f"wovenfab.forms.{path.stem}", None)


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
    for name, effect in forms.effects().items():
        keys = definitions[name]["properties"]
        assert definitions[name]["required"] == [
            p.name for p in effect.parameters if p.default is None
        ]
        for p in effect.parameters:
            value = keys[p.name]
            assert value["description"] == p.meaning
            assert (value["anyOf"][0] if p.per_family else value)["unit"] == (p.unit or "1")


def test_a_new_file_in_forms_is_a_key_and_in_the_schema_without_another_edit(
    new_file: NewFile, example: str, write_case: WriteCase
) -> None:
    new_file("new_drag.py", DRAG)
    drag = json_schema()["$defs"]["drag"]
    assert drag["description"] == "Something new"
    assert drag["properties"]["factor"]["unit"] == "N*s/m^3"
    assert drag["required"] == ["factor"]
    assert drag["properties"]["power"]["default"] == 2
    assert drag["properties"]["power"]["anyOf"][0]["exclusiveMinimum"] == 1
    case = read_case(
        write_case(example.replace("effects:", "effects:\n  drag: {factor: 3 kN*s/m^3}"))
    )
    assert case.effects["drag"] == {"factor": 3000.0, "power": 2.0}


def test_two_files_with_the_same_effect_are_refused(new_file: NewFile) -> None:
    new_file("new_drag.py", DRAG.replace('"drag"', '"shear"'))
    with pytest.raises(ValueError, match="there is an effect 'shear' already"):
        json_schema()
