"""Cases that start from another one: what they take over, and where their faults are."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from tests.case.reading import EXAMPLE, told
from wovenfab.case import json_schema, read_case
from wovenfab.cli.check import published_schema

DATA = YAML(typ="safe").load(EXAMPLE)
EFFECT = (Path(__file__).parents[2] / "docs" / "examples" / "my_effect.py").read_text()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, example: str) -> Path:
    """Return the current folder, a fresh one with the example as base.yaml."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "base.yaml").write_text(example)
    return tmp_path


def _derived(text: str, name: str = "case.yaml") -> Path:
    Path(name).write_text(f"from: base.yaml\n{text}")
    return Path(name)


def test_only_what_differs_is_said(folder: Path) -> None:
    case = read_case(
        _derived(
            "effects: {bending: {stiffness: 24.05 N*m}, slip_friction: {slope: 700 s/m}}\n"
            "program: {amplitudes: [30 mm]}\n"
        )
    )
    assert case.name == "case"
    assert case.effects["bending"] == {"stiffness": (24.05, 24.05)}
    assert case.effects["slip_friction"] == {"strength": 199.2e3, "slope": 700.0}
    assert case.program[0].model_dump(exclude_none=True) == {
        "type": "cycles",
        "amplitudes": (0.03,),
        "repeat": 1,
        "max_velocity": (0.5,),
    }
    base = read_case(folder / "base.yaml")
    assert case.sheet == base.sheet
    assert case.boundary == base.boundary


def test_null_takes_out(folder: Path) -> None:
    case = read_case(
        _derived("effects: {slip_friction: null}\nprogram: {max_velocity: ~, frequency: 2 Hz}\n")
    )
    assert "slip_friction" not in case.effects
    assert case.program[0].model_dump(exclude_none=True) == {
        "type": "cycles",
        "amplitudes": (0.02, 0.04, 0.06),
        "repeat": 1,
        "frequency": (2.0,),
    }


def test_another_type_takes_nothing_over(folder: Path) -> None:
    case = read_case(_derived("program: {type: ramp, to: 40 mm, velocity: 0.1 m/s}\n"))
    assert case.program[0].model_dump(exclude_none=True) == {
        "type": "ramp",
        "to": 0.04,
        "steps": 20,
        "velocity": 0.1,
    }


def test_another_law_takes_nothing_over(folder: Path) -> None:
    case = read_case(_derived("effects: {slip_friction: {law: coulomb, strength: 20 kN/m^2}}\n"))
    assert case.effects["slip_friction"] == {"strength": 2e4}
    assert not case.needs.rate and case.needs.history
    assert "strength" in told(_derived("effects: {slip_friction: {law: coulomb}}\n"))


def test_another_kind_of_sheet_takes_nothing_over(folder: Path) -> None:
    (folder / "plate.geo").write_text("")
    fibres = "fibres: [0 deg, 90 deg]"
    case = read_case(_derived(f"sheet: {{file: plate.geo, {fibres}}}\n", "plate.yaml"))
    assert case.sheet.file.name == "plate.geo"
    rectangle = f"shape: rectangle, length: 1 m, width: 0.5 m, {fibres}"
    (folder / "back.yaml").write_text(f"from: plate.yaml\nsheet: {{{rectangle}}}\n")
    assert read_case(folder / "back.yaml").sheet.length == 1.0


def test_the_type_may_stand_in_the_case_alone(folder: Path) -> None:
    base = json.loads(json.dumps(DATA))
    kind = base["program"].pop("type")
    (folder / "base.yaml").write_text(json.dumps(base))
    case = read_case(_derived(f"program: {{type: {kind}}}\n"))
    assert case.model_dump() == read_case(EXAMPLE).model_dump()


@st.composite
def _split(draw: st.DrawFn) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the example in two parts: what is in the base, and what the case says."""

    def deal(data: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        base: dict[str, Any] = {}
        own: dict[str, Any] = {}
        for key, value in data.items():
            where = draw(st.sampled_from(["base", "own", "both", "apart"]))
            if where == "apart" and isinstance(value, dict):
                base[key], own[key] = deal(value)
            else:
                if where != "own":
                    wrong = where == "both" and not isinstance(value, dict)
                    base[key] = ["of the base"] if wrong else copy.deepcopy(value)
                if where in ("own", "both"):
                    own[key] = copy.deepcopy(value)
        return base, own

    return deal(DATA)


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(_split())
def test_a_case_in_two_parts_reads_as_the_whole(
    folder: Path, parts: tuple[dict[str, Any], dict[str, Any]]
) -> None:
    base, own = parts
    (folder / "base.yaml").write_text(json.dumps(base))
    Path("case.yaml").write_text(json.dumps({"from": "base.yaml", **own}))
    assert read_case(Path("case.yaml")).model_dump() == read_case(EXAMPLE).model_dump()


def test_the_case_as_resolved_needs_no_other_file(folder: Path) -> None:
    text = "effects: {coupling: null, slip_friction: null}\noutput: {fields: null}\n"
    case = read_case(_derived(text))
    Path("whole.yaml").write_text(case.to_yaml())
    (folder / "base.yaml").unlink()
    assert read_case(Path("whole.yaml")).model_dump() == case.model_dump()


def test_files_are_relative_to_the_file_that_names_them(folder: Path, example: str) -> None:
    """Each folder has an own effect, a geometry and a table; the right ones must be found."""
    far, near = folder / "far", folder / "near"
    for place, stiffness in ((far, 1), (near, 2), (folder, 3)):
        place.mkdir(exist_ok=True)
        (place / "my_effect.py").write_text(EFFECT.replace("/ 2", f"* {stiffness}"))
        (place / "sheet.geo").write_text("")
        (place / "u.csv").write_text(f"time_s,displacement_m\n0,0\n1,{stiffness}e-3\n")
    shape = "  shape: rectangle\n  length: 0.90 m\n  width: 0.30 m\n"
    text = example.replace(shape, "  file: sheet.geo\n")
    text = text.replace("effects:", "effects:\n  my_effect: {file: my_effect.py, stiffness: 1}")
    (far / "base.yaml").write_text(text.replace("discretisation:\n  degree: 3", "discretisation:"))
    (near / "middle.yaml").write_text("from: ../far/base.yaml\nsheet: {file: sheet.geo}\n")
    Path("case.yaml").write_text(
        "from: near/middle.yaml\nprogram: {type: table, file: u.csv}\n"
        "effects: {my_effect: {stiffness: 2}}\n"
    )
    case = read_case(Path("case.yaml"))
    assert [e.file for e in case.scene if e.file] == [far / "my_effect.py"]
    assert case.sheet.file == near / "sheet.geo"
    assert case.program[0].samples.values == (0.0, 3e-3)
    replaced = read_case(Path("case.yaml"), ["sheet.file=far/sheet.geo"])
    assert replaced.sheet.file == far / "sheet.geo"


def test_a_fault_is_told_where_it_was_written(folder: Path, example: str) -> None:
    (folder / "base.yaml").write_text(example.replace("steps_per_cycle: 80", "steps_per_cycle: 81"))
    assert told(_derived("effects:\n  bending:\n    stifness: 24 N*m\n")) == (
        "case.yaml:4: effects.bending.stifness: unknown key. Did you mean 'stiffness'?\n"
        "base.yaml:24: time.steps_per_cycle: must be even, got 81."
    )


def test_a_combination_is_told_where_its_last_part_was_written(folder: Path) -> None:
    path = _derived("title: x\neffects: {bending: null}\nboundary: {left: {clamp: rotation}}")
    assert told(path).startswith("case.yaml:4: boundary.left: yarn directions cannot be held")
    assert told(_derived("sheet: {width: 10 mm}")) == (
        "base.yaml:22: discretisation.mesh_size: is larger than the shorter side, 0.01 m."
    )


def test_the_command_line_has_the_last_word(folder: Path) -> None:
    path = _derived("effects: {bending: {stiffness: 24.05 N*m}}\n")
    case = read_case(path, ["effects.bending.stiffness=1 N*m", "effects.coupling=null"])
    assert case.effects["bending"] == {"stiffness": (1.0, 1.0)}
    assert "coupling" not in case.effects
    assert told(path, ["time.scheme=x"]).startswith("--set time.scheme: expected")


def _objects(schema: Any) -> Iterator[dict[str, Any]]:
    if isinstance(schema, dict):
        yield schema
        schema = list(schema.values())
    for value in schema if isinstance(schema, list) else ():
        yield from _objects(value)


def test_the_schema_of_a_part_requires_nothing_and_lets_take_out() -> None:
    schema = json_schema()
    published = published_schema(schema)
    assert published["else"]["required"] == schema["required"]
    parts = {k: v for k, v in published["$defs"].items() if k not in schema["$defs"]}
    assert {k.removesuffix("_part") for k in parts} == set(schema["$defs"])
    for part in _objects([published["then"], *parts.values()]):
        assert "required" not in part
        assert "oneOf" not in part
        if "$ref" in part:
            assert part["$ref"].removeprefix("#/$defs/") in parts
        keys = part.get("properties", {}) if "additionalProperties" in part else {}
        for value in keys.values():
            assert {"type": "null"} in value["anyOf"]
