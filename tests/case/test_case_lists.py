"""Units in lists: one rule in case files, on the command line and in Python."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wovenfab.case import Case, CaseError, json_schema, read_case
from wovenfab.case.schema import ZoneSection
from wovenfab.study.variations import read_over, read_sweep_file

BIAS = Path(__file__).parents[2] / "configs" / "bias-1x3.yaml"
AT = "output.probes.p"


def from_file(key: str, value: Any, folder: Path) -> Case:
    """Return the case with a value that stands in a file."""
    path = folder / "case.yaml"
    inner = value if isinstance(value, str) else repr(value).replace("'", "")
    for name in reversed(key.split(".")):
        inner = f"{{{name}: {inner}}}"
    path.write_text(f"from: {BIAS}\n{inner[1:-1]}\n")
    return read_case(path)


def with_set(key: str, value: Any, _: Path) -> Case:
    text = value if isinstance(value, str) else repr(value).replace("'", "")
    return read_case(BIAS, [f"{key}={text}"])


def in_python(key: str, value: Any, _: Path) -> Case:
    return read_case(BIAS).changed({key: value})


def by_objects(key: str, value: Any, _: Path) -> Case:
    """Return the case built from Python values alone."""
    data: Any = dict(read_case(BIAS).data)
    *above, last = key.split(".")
    place = data
    for name in above:
        place[name] = dict(place.get(name, {}))
        place = place[name]
    place[last] = value
    return Case(**data)


WAYS = [from_file, with_set, in_python, by_objects]
Way = Callable[[str, Any, Path], Case]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    ("key", "value", "readings"),
    [
        ("program.amplitudes", [20, "40 mm"], "[20 mm, 40 mm] or [20 m, 40 mm]"),
        ("program.amplitudes", [0.02, "40 mm"], "[0.02 mm, 40 mm] or [0.02 m, 40 mm]"),
        ("program.amplitudes", ["20 mm", 40], "[20 mm, 40 mm] or [20 mm, 40 m]"),
        ("sheet.fibres", ["45 deg", -45], "[45 deg, -45 deg] or [45 deg, -45 rad]"),
        ("effects.stretch.stiffness", [1, "2 kN/m"], "[1 kN/m, 2 kN/m] or [1 N/m, 2 kN/m]"),
        ("time.extra_times", [1, 2, "30 ms"], "[1 ms, 2 ms, 30 ms] or [1 s, 2 s, 30 ms]"),
        ("boundary.right.displacement", [5, "10 mm"], "[5 mm, 10 mm] or [5 m, 10 mm]"),
        ("boundary.top", {"force": [5, "1 N/mm"]}, "[5 N/mm, 1 N/mm] or [5 N/m, 1 N/mm]"),
        (
            AT,
            {"type": "point", "at": [0.45, "150 mm"]},
            "[0.45 mm, 150 mm] or [0.45 m, 150 mm]",
        ),
        (
            "effects.stretch.stiffness",
            [400, "400 kN/m * (1 + x/0.3 m)"],
            "[400 kN/m, 400 kN/m * (1 + x/0.3 m)] or [400 N/m, 400 kN/m * (1 + x/0.3 m)]",
        ),
        (
            "effects.stretch.stiffness",
            ["20 kN * exp(-x/1 m) / 1 m", 30],
            "[20 kN * exp(-x/1 m) / 1 m, 30 N/m]",
        ),
        (
            "boundary.right.displacement",
            ["program + 5 mm", 3],
            "[program + 5 mm, 3 mm] or [program + 5 mm, 3 m]",
        ),
        (
            "boundary.top",
            {"force": ["1 kN/m * x/0.3 m", 5]},
            "[1 kN/m * x/0.3 m, 5 kN/m] or [1 kN/m * x/0.3 m, 5 N/m]",
        ),
        (
            AT,
            {"type": "line", "ends": [["0 m", "0.1 m"], [0.5, "150 mm"]]},
            "[0.5 mm, 150 mm] or [0.5 m, 150 mm]",
        ),
    ],
)
def test_numbers_and_units_in_one_list_are_refused_with_both_readings(
    key: str, value: Any, readings: str, way: Way, tmp_path: Path
) -> None:
    with pytest.raises(CaseError) as caught:
        way(key, value, tmp_path)
    (problem,) = caught.value.problems
    assert problem.key.startswith(key)
    assert "has no unit" in problem.message and readings in problem.remedy
    assert (problem.line is not None) is (way is from_file)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    ("key", "value", "same"),
    [
        ("program.amplitudes", ["20 mm", "4 cm"], [0.02, 0.04]),
        ("program.amplitudes", "20, 40 mm", [0.02, 0.04]),
        ("program.amplitudes", "0.02, 0.04", [0.02, 0.04]),
        ("program.amplitudes", "20 mm, 4 cm", [0.02, 0.04]),
        ("sheet.fibres", [0, "90 deg"], [0.0, math.pi / 2]),
        ("sheet.fibres", "45, -45 deg", [math.pi / 4, -math.pi / 4]),
        ("effects.stretch.stiffness", "1, 2 kN/m", [1e3, 2e3]),
        ("boundary.right.displacement", ["program", "0 mm"], ["program", 0]),
        ("boundary.top", {"force": "0, 5 N/mm"}, {"force": [0, 5e3]}),
        ("boundary.top", {"force": [0, "5 N/mm"]}, {"force": [0, 5e3]}),
        ("boundary.right.displacement", ["program + 5 mm", 0], ["program + 5 mm", "0 m"]),
        ("boundary.right.displacement", ["2*program", 0.003], ["2*program", "3 mm"]),
        (AT, {"type": "point", "at": [0, "150 mm"]}, {"type": "point", "at": [0, 0.15]}),
        (AT, {"type": "point", "at": "450, 150 mm"}, {"type": "point", "at": [0.45, 0.15]}),
    ],
)
def test_each_number_has_its_unit_or_a_text_has_one_for_all(
    key: str, value: Any, same: Any, way: Way, tmp_path: Path
) -> None:
    if way in (from_file, with_set) and isinstance(value, dict):
        value = str(value).replace("'type'", "type")
    elif way is from_file and isinstance(value, str):
        value = f'"{value}"'
    assert way(key, value, tmp_path).to_yaml() == by_objects(key, same, tmp_path).to_yaml()


@given(
    numbers=st.lists(st.floats(1e-6, 1e3), min_size=2, max_size=5),
    unit=st.sampled_from(["mm", "cm", "m", "inch"]),
)
def test_a_text_with_one_unit_is_the_list_with_this_unit_everywhere(
    numbers: list[float], unit: str
) -> None:
    text = ", ".join(map(repr, numbers)) + f" {unit}"
    each = [f"{number!r} {unit}" for number in numbers]
    case = read_case(BIAS)
    changed = (case.changed({"program.amplitudes": value}) for value in (text, each))
    assert next(changed).program == next(changed).program


@pytest.mark.parametrize("text", ["20,5 mm", "0,5", "20 mm, 5", "20, 30 mm, 40 mm", "20, mm", ", "])
def test_a_decimal_comma_is_no_list_nor_is_half_a_list(text: str) -> None:
    with pytest.raises(CaseError, match=r"program\.amplitudes"):
        read_case(BIAS).changed({"program.amplitudes": text})


def test_a_text_that_lacks_its_quotes_within_braces_is_told() -> None:
    program = "{type: cycles, amplitudes: 20, 40 mm, frequency: 1 Hz}"
    with pytest.raises(CaseError, match=r"40 mm: unknown key\. Within { } a text .* quotes"):
        read_case(BIAS, [f"program={program}"])


def test_sections_in_python_have_the_same_rule() -> None:
    with pytest.raises(CaseError, match=re.escape("[0.4 mm, 150 mm] or [0.4 m, 150 mm]")):
        ZoneSection(type="zone", centre=(0.4, "150 mm"), radius=0.1)
    zone = ZoneSection(type="zone", centre="400, 150 mm", radius=0.1)  # type: ignore[arg-type]
    assert zone.centre == (0.4, 0.15)


def quantity_lists(schema: Any, path: str = "") -> Iterator[str]:
    """Yield where lists of values with a unit stand in a schema."""
    if isinstance(schema, dict):
        items = schema.get("prefixItems", [schema.get("items")])[0]
        if schema.get("type") == "array" and items and items.get("unit", "1") != "1":
            yield path
        for key, value in schema.items():
            yield from quantity_lists(value, f"{path}.{key}")
    elif isinstance(schema, list):
        for i, value in enumerate(schema):
            yield from quantity_lists(value, f"{path}.{i}")


def test_every_list_of_quantities_has_this_rule() -> None:
    """Its text has a place in the schema: the rule comes with it."""
    schema = json_schema()
    for path in quantity_lists(schema):
        holder: Any = schema
        *above, place = path.strip(".").split(".")
        for key in above:
            holder = holder[int(key)] if isinstance(holder, list) else holder[key]
        assert isinstance(holder, list), path
        others = [one for i, one in enumerate(holder) if i != int(place)]
        assert any(_takes_text(one) for one in others), path
    assert len(list(quantity_lists(schema))) > 10


def _takes_text(schema: Any) -> bool:
    return schema.get("type") == "string" or any(map(_takes_text, schema.get("anyOf", ())))


def test_values_of_a_sweep_have_the_same_rule(tmp_path: Path) -> None:
    for text in ("200,300 mm", "200, 300 mm", "200 mm,300 mm"):
        values = [variation.values for variation in read_over(f"sheet.length={text}")]
        assert values == [{"sheet.length": "200 mm"}, {"sheet.length": "300 mm"}]
    with pytest.raises(CaseError, match=r"--over sheet.length: 300 has no unit, but others have"):
        read_over("sheet.length=200 mm,300")
    for values in ("400,400 kN/m * x/0.3 m", "400 kN/m * x/0.3 m,400"):
        with pytest.raises(CaseError, match=r"400 has no unit, but others have"):
            read_over(f"effects.stretch.stiffness={values}")
    path = tmp_path / "sweep.yaml"
    path.write_text(f"case: {BIAS}\nover:\n  sheet.length: [200, 300 mm]\n")
    with pytest.raises(CaseError, match=r"sweep.yaml:3: over.sheet.length: 200 has no unit"):
        read_sweep_file(path)
    path.write_text(f"case: {BIAS}\nover:\n  sheet.length: 200, 300 mm\n")
    values = [variation.values for variation in read_sweep_file(path).variations]
    assert values == [{"sheet.length": "200 mm"}, {"sheet.length": "300 mm"}]
