"""Effects of the user's own, from a file beside the case."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from tests.case.reading import EXAMPLE, WriteCase, again, told
from tests.cli.test_commands import rows, wovenfab
from wovenfab import forms
from wovenfab.case import Case, CaseError, read_case
from wovenfab.case.custom_effects import REMEDY, custom_effect_errors
from wovenfab.record.summary import read_summary

DOCS = Path(__file__).parents[2] / "docs"
OWN = """\
from wovenfab.forms.effect import Effect, Needs, Parameter

EFFECT = Effect(
    name="drag",
    summary="Something new",
    parameters=(
        Parameter("factor", "N*s/m^3", "how much", per_family=True),
        Parameter("power", "1", "exponent", default=2.0, above=1.0),
    ),
    needs=Needs(placements=2, rate=True),
    dissipation=lambda rate, values: abs(values["factor"][0] * rate) ** values["power"],
    measure=lambda point: point.slip[0],
    resists=frozenset({"slipping"}),
)
"""
BAD = YAML(typ="safe").load(EXAMPLE.with_name("bad_effects.yaml"))
LAW, IMPORT = (
    'abs(values["factor"][0] * rate) ** values["power"]',
    "import Effect, Needs, Parameter",
)
COUPLING = "coupling: {stiffness: 6.0e7 N/m^3}"
DRAG = "drag: {file: drag.py, factor: 3 kN*s/m^3}"


def test_an_own_effect_is_read_with_its_values_and_comes_last(
    example: str, write_case: WriteCase
) -> None:
    path = write_case(example.replace("stretch:", f"{DRAG}\n  stretch:"))
    Path("drag.py").write_text(OWN)
    case = read_case(path)
    assert [e.name for e in case.scene] == [*sorted(case.effects.keys() - {"drag"}), "drag"]
    own = case.scene[-1]
    assert own.values == {"factor": (3000.0, 3000.0), "power": 2.0}
    assert own.effect.summary == "Something new"
    assert own.file == Path("drag.py").resolve()
    assert case.needs.placements == 2


def test_what_it_needs_and_resists_counts(example: str, write_case: WriteCase) -> None:
    friction = "  slip_friction: {strength: 199.2 kN/m^2, slope: 70 s/m}\n"
    path = write_case(example.replace(COUPLING, DRAG).replace(friction, ""))
    Path("drag.py").write_text(OWN)
    assert read_case(path).needs.rate
    Path("drag.py").write_text(OWN.replace('resists=frozenset({"slipping"}),', ""))
    assert "nothing ties the two families together" in told(path)


@pytest.mark.parametrize("row", BAD, ids=lambda row: row["says"].removeprefix("<file>")[:60])
def test_what_is_wrong_is_told_with_both_lines(
    row: dict[str, Any], example: str, write_case: WriteCase
) -> None:
    path = write_case(example.replace(COUPLING, row.get("entry", DRAG)))
    text, changes = row.get("text", OWN), dict(row.get("change", {}))
    if "law" in row:
        changes = {LAW: row["law"], IMPORT: "import *; from ufl import as_vector, dx, ln"}
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    if text is not None:
        Path("drag.py").write_text(text)
    says = row["says"].replace("<file>", "case.yaml:11: effects.drag.file: drag.py")
    assert told(path) == says.replace("<remedy>", REMEDY)


def test_a_function_that_fails_where_a_model_is_built_is_told_with_its_line(
    example: str, write_case: WriteCase
) -> None:
    path = write_case(example.replace(COUPLING, DRAG))
    Path("drag.py").write_text(OWN)
    scene = read_case(path).scene
    with pytest.raises(CaseError, match=r"^drag.py:11: .*KeyError: 'factor'.* UFL"):  # noqa: SIM117
        with custom_effect_errors(scene):
            scene[-1].effect.dissipation(1.0, {})
    with pytest.raises(CaseError, match=r"^drag.py: .*RuntimeError: no memory"):  # noqa: SIM117
        with custom_effect_errors(scene):
            raise RuntimeError("no memory")
    with pytest.raises(RuntimeError), custom_effect_errors(scene[:-1]):
        raise RuntimeError


REMEMBER = """\
    memory=(InternalVariable("slid", "m", "so far", lambda now, before, values, step: values["slid"]
        + abs(now.slip[0] - before.slip[0])),),
"""


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ('"m", "so far"', '"mm", "so far"',
         "the unit 'mm' of 'slid' is not an SI unit. Write it in m, kg, s, N, J or rad; a case may "
         "use any other."),
        ('"m", "so far"', '"ell", "so far"', "the internal variable 'slid' has the unknown unit "
         "'ell'."),
        ('("slid"', '("power"', "an internal variable cannot be named 'power'. Names are unique, "
         "of letters, digits and '_', and not 'file', 'law' or 'table'."),
        ("abs(now.slip[0] - before.slip[0])", "now.slip",
         ":13: UFLException|ValueError"),
        ('values["slid"]\n        + abs(now.slip[0] - before.slip[0])', "now.slip",
         "ValueError: the update of 'slid' gives a value of shape (2,), not one number. "),
    ],
)  # fmt: skip
def test_an_internal_variable_that_is_wrong_is_told_in_one_message(
    right: str, wrong: str, message: str, example: str, write_case: WriteCase
) -> None:
    path = write_case(example.replace(COUPLING, DRAG))
    source = OWN.replace("import Effect", "import Effect, InternalVariable")
    source = source.replace("    dissipation=", f"{REMEMBER}    dissipation=")
    assert right in source
    Path("drag.py").write_text(source)
    assert read_case(path).needs.history
    Path("drag.py").write_text(source.replace(right, wrong))
    said = told(path)
    assert said.startswith("case.yaml:11: effects.drag.file: drag.py") and "\n" not in said
    assert re.search(message, said) if "|" in message else message in said


def test_a_file_that_no_case_names_is_not_run(example: str, write_case: WriteCase) -> None:
    path = write_case(example)
    Path("drag.py").write_text("open('was-run', 'w')\n")
    read_case(path)
    assert not Path("was-run").exists()
    told(write_case(example.replace(COUPLING, DRAG)))
    assert Path("was-run").exists()


def test_two_cases_have_their_own_effects_of_the_same_name(example: str, tmp_path: Path) -> None:
    def case_in(name: str, factor: str, source: str) -> Case:
        folder = tmp_path / name
        folder.mkdir()
        (folder / "drag.py").write_text(source)
        text = example.replace(COUPLING, f"drag: {{file: drag.py, factor: {factor}}}")
        (folder / "case.yaml").write_text(text)
        return read_case(folder / "case.yaml")

    one, other = case_in("one", "1", OWN), case_in("other", "2", OWN.replace("new", "else"))
    assert one.scene[-1].effect.summary == "Something new"
    assert other.scene[-1].effect.summary == "Something else"
    assert one != other
    assert "drag" not in forms.effects()
    assert not [name for name in sys.modules if "drag" in name]


def test_the_case_as_written_finds_the_file_from_anywhere(
    example: str, write_case: WriteCase, tmp_path: Path
) -> None:
    path = write_case(example.replace(COUPLING, DRAG))
    Path("drag.py").write_text(OWN)
    case = read_case(path)
    other = again(case, tmp_path / "elsewhere")
    assert other == case and repr(other) == repr(case)


@pytest.mark.parametrize("line", ["from .effect import", "from wovenfab.forms.effect import"])
def test_the_file_may_be_one_of_forms(line: str, example: str, write_case: WriteCase) -> None:
    """An effect can move between a case's folder and forms/ without an edit."""
    path = write_case(example.replace(COUPLING, DRAG))
    Path("drag.py").write_text(
        OWN.replace(
            "from wovenfab.forms.effect import", f"from __future__ import annotations\n{line}"
        )
        + "from dataclasses import dataclass\n@dataclass\nclass A:\n    a: 'int' = 1\n"
    )
    assert read_case(path).scene[-1].name == "drag"


def test_a_file_that_imports_from_where_effects_were_is_told_from_where(
    example: str, write_case: WriteCase
) -> None:
    path = write_case(example.replace(COUPLING, DRAG))
    Path("drag.py").write_text(OWN.replace("from wovenfab.forms.effect", "from forms.effect"))
    with pytest.raises(CaseError, match=r"drag.py:\d+: .*Import from wovenfab.forms"):
        read_case(path)


def test_the_documented_example_is_the_one_in_the_docs() -> None:
    page = (DOCS / "case-file.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```\w+\n(.*?)```", page, re.DOTALL)
    assert (DOCS / "examples" / "my_effect.py").read_text(encoding="utf-8") in blocks


@pytest.mark.slow
def test_the_documented_example_runs_and_has_its_column(tmp_path: Path) -> None:
    case = DOCS / "examples" / "my_effect.yaml"
    ended = wovenfab("run", case, "-o", "results", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert float(rows(tmp_path / "results")[-1]["energy_my_effect_J"]) > 0
    assert read_summary(tmp_path / "results")["outcome"] == "finished"
    assert {p.name for p in case.parent.iterdir()} >= {"my_effect.py", "my_effect.yaml"}
