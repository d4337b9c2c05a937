"""Effects of the user's own, from a file beside the case."""

from __future__ import annotations

import csv
import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import forms
from wovenfab.case import Case, CaseError, read_case
from wovenfab.case.custom_effects import REMEDY

WriteCase = Callable[[str], Path]

DOCS = Path(__file__).parents[2] / "docs"
OWN = """\
from forms.effect import Effect, Needs, Parameter

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
COUPLING = "coupling: {stiffness: 6.0e7 N/m^3}"
DRAG = "drag: {file: drag.py, factor: 3 kN*s/m^3}"


def told(path: Path) -> str:
    with pytest.raises(CaseError) as caught:
        read_case(path)
    return str(caught.value)


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


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("factor: 0 N/m",
         "drag.factor: expected a value in N*s/m^3 such as '1 N*s/m^3', got 'N/m'."),
        ("factor: [1, -1]", "drag.factor.1: must not be negative, got -1."),
        ("factr: 1", "drag.factr: unknown key. Did you mean 'factor'?"),
        ("power: 3", "drag.factor: missing. For example 'factor: 1 N*s/m^3'."),
        ("factor: 1, power: 1", "drag.power: must be more than 1, got 1."),
        ("factor: 1, power: 3 m", "drag.power: expected a plain number such as 0.5, got 'm'."),
        ("factor: 1, power: 1 + x/9 m", "drag.power: must be more than 1, but is 1 at x = 0 m, "
         "y = 0 m. Keep it in bounds, as with max(..., ...) or if(..., ..., ...)."),
    ],
)  # fmt: skip
def test_its_values_are_checked_like_all_others(
    given: str, message: str, example: str, write_case: WriteCase
) -> None:
    path = write_case(example.replace(COUPLING, f"drag: {{file: drag.py, {given}}}"))
    Path("drag.py").write_text(OWN)
    assert told(path).startswith(f"case.yaml:11: effects.{message}")
    assert "\n" not in told(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = (\n", "drag.py:1: '(' was never closed. This is not valid Python."),
        ("import nowhere\n", "drag.py:1: ModuleNotFoundError: No module named 'nowhere'."),
        ("def f():\n    return 1 / 0\nf()\n", "drag.py:2: ZeroDivisionError: division by zero."),
        ("raise SystemExit\n", "drag.py:1: SystemExit."),
        (OWN.replace("measure=lambda point: point.slip[0],\n", ""),
         "drag.py:3: ValueError: effect 'drag': a dissipation needs a measure and no other."),
        ("effect = 1\n", "drag.py defines no EFFECT. It must end with 'EFFECT = Effect(...)'."),
        ("EFFECT = 'drag'\n", "EFFECT in drag.py is of type str, not Effect. It must be an Effect "
         "of forms.effect."),
        (OWN.replace("drag", "brake"), "drag.py defines the effect 'brake', not 'drag'. Use "
         "'brake' as the key here, or set name=\"drag\" there."),
        (OWN.replace("slipping", "slip"), "drag.py: the effect resists 'slip', which is not known. "
         "It may be 'stretching', 'shearing', 'slipping' or 'curving'."),
        (OWN.replace("factor", "file"), "drag.py: a parameter cannot be named 'file'. Names are "
         "unique, of letters, digits and '_', and not 'file' or 'law'."),
        (OWN.replace("power", "factor"), "drag.py: a parameter cannot be named 'factor'. Names are "
         "unique, of letters, digits and '_', and not 'file' or 'law'."),
        (OWN.replace("N*s/m^3", "N*s/x^3"),
         "drag.py: the parameter 'factor' has the unknown unit 'N*s/x^3'."),
        (OWN.replace("N*s/m^3", "kN*s/m^3"), "drag.py: the unit 'kN*s/m^3' of 'factor' is not an "
         "SI unit. Write it in m, kg, s, N, J or rad; a case may use any other."),
        (None, "there is no file 'drag.py'. Names are relative to the case file."),
    ],
)  # fmt: skip
def test_what_is_wrong_with_the_file_is_told_with_both_lines(
    text: str | None, message: str, example: str, write_case: WriteCase
) -> None:
    path = write_case(example.replace(COUPLING, DRAG))
    if text is not None:
        Path("drag.py").write_text(text)
    assert told(path) == f"case.yaml:11: effects.drag.file: {message}"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("rate.size",
         ":11: AttributeError: 'Variable' object has no attribute 'size'"),
        ("as_vector([rate, rate])",
         ": ValueError: dissipation gives a value of shape (2,), not one number"),
        ("max(0, rate)",
         ":11: ValueError: UFL conditions cannot be evaluated as bool in a Python context"),
        ('values["fctr"] * rate', ":11: KeyError: 'fctr'"),
        ("rate > 1", ": ValueError: dissipation gives GT, not a number"),
        ("None", ": ValueError: dissipation gives NoneType, not a number"),
        ("rate**2 * dx", ": ValueError: dissipation gives Form, not a number"),
        ("ln(rate, 2)",
         ":11: TypeError: ln() takes 1 positional argument but 2 were given"),
    ],
)  # fmt: skip
def test_energies_that_cannot_be_varied_are_told_with_the_cause(
    given: str, message: str, example: str, write_case: WriteCase
) -> None:
    path = write_case(example.replace(COUPLING, DRAG))
    law = 'abs(values["factor"][0] * rate) ** values["power"]'
    assert law in OWN
    source = OWN.replace(law, given).replace(
        "import Effect, Needs, Parameter\n", "import *; from ufl import as_vector, dx, ln\n"
    )
    Path("drag.py").write_text(source)
    assert told(path) == f"case.yaml:11: effects.drag.file: drag.py{message}. {REMEDY}"


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
         "of letters, digits and '_', and not 'file' or 'law'."),
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


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("drag: {file: drag.txt}",
         "drag.file: expected a file that ends in '.py', got 'drag.txt'."),
        ("drag: {file: [drag.py]}", "drag.file: expected the name of a file, got a list."),
        ("coupling: {file: drag.py}",
         "coupling.file: there is an effect 'coupling' already. Give yours another name."),
        ("'drag,2': {file: drag.py}",
         "drag,2.file: the name of an effect is a letter, then letters, digits and '_'."),
    ],
)  # fmt: skip
def test_what_is_wrong_with_its_key_is_told(
    entry: str, message: str, example: str, write_case: WriteCase
) -> None:
    path = write_case(example.replace(COUPLING, entry))
    Path("drag.py").write_text(OWN)
    assert told(path) == f"case.yaml:11: effects.{message}"


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
    (tmp_path / "elsewhere").mkdir()
    again = tmp_path / "elsewhere" / "case.yaml"
    again.write_text(case.to_yaml())
    assert read_case(again) == case
    assert repr(read_case(again)) == repr(case)


@pytest.mark.parametrize("line", ["from .effect import", "from forms.effect import"])
def test_the_file_may_be_one_of_forms(line: str, example: str, write_case: WriteCase) -> None:
    """An effect can move between a case's folder and forms/ without an edit."""
    path = write_case(example.replace(COUPLING, DRAG))
    Path("drag.py").write_text(
        OWN.replace("from forms.effect import", f"from __future__ import annotations\n{line}")
        + "from dataclasses import dataclass\n@dataclass\nclass A:\n    a: 'int' = 1\n"
    )
    assert read_case(path).scene[-1].name == "drag"


def test_the_documented_example_is_the_one_in_the_docs() -> None:
    page = (DOCS / "case-file.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```\w+\n(.*?)```", page, re.DOTALL)
    assert (DOCS / "examples" / "my_effect.py").read_text(encoding="utf-8") in blocks


def test_the_documented_example_runs_and_has_its_column(tmp_path: Path) -> None:
    case = DOCS / "examples" / "my_effect.yaml"
    command = [sys.executable, "-m", "wovenfab", "run", str(case), "-o", "results"]
    ended = subprocess.run(command, cwd=tmp_path, text=True, capture_output=True, check=False)
    assert ended.returncode == 0, ended.stderr
    with (tmp_path / "results" / "history.csv").open() as stream:
        last = list(csv.DictReader(stream))[-1]
    assert float(last["energy_my_effect_J"]) > 0
    summary = json.loads((tmp_path / "results" / "summary.json").read_text())
    assert summary["outcome"] == "finished"
    assert {p.name for p in case.parent.iterdir()} >= {"my_effect.py", "my_effect.yaml"}
