"""Bad cases: each says all that is wrong, where, and what would be right."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from tests.case.reading import EXAMPLE, WriteCase, told
from wovenfab import forms
from wovenfab.case import CaseError, read_case
from wovenfab.case.errors import one_of

TABLE = YAML(typ="safe").load(EXAMPLE.with_name("bad_cases.yaml"))
DATA = YAML(typ="safe").load(EXAMPLE)


def listed(says: str | list[str]) -> list[str]:
    return [says] if isinstance(says, str) else says


def _with_names(says: str) -> str:
    """Return a message with the names of the effects that there are now."""
    known = forms.effects()
    says = says.replace("<effects>", ", ".join(known))
    for resistance in ("stretching", "shearing", "slipping"):
        names = [name for name, effect in known.items() if resistance in effect.resists]
        says = says.replace(f"<{resistance}>", one_of(names))
    return says


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row["name"])
def test_every_problem_is_told_with_line_and_remedy(
    row: dict[str, Any], example: str, write_case: WriteCase
) -> None:
    old, new = (
        row["replace"]
        if isinstance(row.get("replace"), list)
        else (row.get("replace", ""), row.get("by", ""))
    )
    assert old in example
    for name, text in row.get("files", {}).items():
        Path(name).write_text(example if text == "example" else text, encoding="utf-8")
    path = write_case(row["text"] if "text" in row else example.replace(old, new, 1))
    changes = [row["set"]] if "set" in row else []
    assert told(path, changes).split("\n") == [_with_names(line) for line in listed(row["says"])]


def test_problems_of_different_sections_are_told_together(
    example: str, write_case: WriteCase
) -> None:
    text = example.replace("400 N/m}", "400 N}").replace("bdf2", "bdf4").replace("left:", "lft:")
    with pytest.raises(CaseError) as caught:
        read_case(write_case(text))
    problems = caught.value.problems
    assert [(p.line, p.key) for p in problems] == [
        (9, "effects.shear.stiffness"),
        (14, "boundary.lft"),
        (25, "time.scheme"),
    ]


def _places(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield path
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from _places(value, (*path, key))


_ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
    | st.sampled_from(["40 mm", "program", "clamp", "auto", "cycles", "free", "9^9^9 m", 10**400]),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(st.text(max_size=4) | st.sampled_from(["type", "file", "clamp", "a.b"]),
                      inner, max_size=3),
    max_leaves=5,
)  # fmt: skip


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.sampled_from(list(_places(DATA))), value=_ANYTHING)
def test_whatever_stands_in_a_case_it_is_read_or_refused_with_reasons(
    place: tuple[Any, ...], value: Any, write_case: WriteCase, tmp_path: Path
) -> None:
    data = copy.deepcopy(DATA)
    if place:
        holder = data
        for key in place[:-1]:
            holder = holder[key]
        holder[place[-1]] = value
    else:
        data = value
    path = write_case("")
    with path.open("w", encoding="utf-8") as stream:
        YAML(typ="safe").dump(data, stream)
    try:
        case = read_case(path)
    except CaseError as error:
        assert error.problems
        assert all(p.message and p.file == "case.yaml" for p in error.problems)
    else:
        assert case.name == "case"
