"""A test and a fabric, each in a file of its own, are one case."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.case.reading import again, told
from wovenfab.case import CaseError, read_case
from wovenfab.case.fingerprint import fingerprint
from wovenfab.case.programs import effect_programs
from wovenfab.study.cluster import command_of
from wovenfab.study.sweep import members_of

EFFECT = (Path(__file__).parents[2] / "docs" / "examples" / "my_effect.py").read_text()

TEST = """\
title: A strip
sheet: {length: 0.3 m, width: 0.1 m, fibres: [45 deg, -45 deg]}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 20 mm, steps: 4}
"""
FABRIC = """\
fabric:
  name: Glass
  source: a table
  measured: [shear]
  assumed: ["stretch, 50 kN/m"]
effects:
  stretch: {stiffness: 50 kN/m}
  shear: {stiffness: 30 N/m}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the current folder, with a test and a fabric."""
    monkeypatch.chdir(tmp_path)
    Path("strip.yaml").write_text(TEST)
    Path("glass.yaml").write_text(FABRIC)
    return tmp_path


def _saved(text: str, name: str = "case.yaml") -> Path:
    Path(name).write_text(text)
    return Path(name)


def test_a_test_with_a_fabric_is_the_case_that_one_file_says(folder: Path) -> None:
    whole = read_case(_saved(TEST + FABRIC))
    listed = read_case(_saved("from: [strip.yaml, glass.yaml]\n"))
    joined = read_case("strip.yaml", fabric="glass.yaml")
    assert whole == listed == joined
    assert whole.to_yaml() == listed.to_yaml() == joined.to_yaml()
    assert fingerprint(whole) == fingerprint(joined)


def test_the_recorded_case_is_complete(folder: Path) -> None:
    joined = read_case("strip.yaml", fabric="glass.yaml")
    for name in ("strip.yaml", "glass.yaml"):
        Path(name).unlink()
    assert again(joined, folder / "results") == joined


def test_of_several_files_the_later_ones_win_and_the_case_over_all(folder: Path) -> None:
    _saved("effects: {shear: {stiffness: 40 N/m}, stretch: {stiffness: 60 kN/m}}\n", "other.yaml")
    path = _saved(
        "from: [strip.yaml, glass.yaml, other.yaml]\neffects: {shear: {stiffness: 50 N/m}}\n"
    )
    effects = read_case(path).effects
    assert effects["shear"] == {"stiffness": 50.0}
    assert effects["stretch"] == {"stiffness": (6e4, 6e4)}
    turned = _saved("from: [strip.yaml, other.yaml, glass.yaml]\n")
    assert read_case(turned).effects["shear"] == {"stiffness": 30.0}
    assert read_case(turned, fabric="other.yaml").effects["shear"] == {"stiffness": 40.0}
    override = ["effects.shear.stiffness=70 N/m"]
    assert read_case("strip.yaml", override, "glass.yaml").effects["shear"] == {"stiffness": 70.0}


def test_null_takes_out_what_an_earlier_file_gives(folder: Path) -> None:
    _saved("effects: {shear: null, coupling: null}\n", "other.yaml")
    message = "other.yaml:1: effects.coupling: there is nothing here to take out."
    assert told(_saved("from: [strip.yaml, glass.yaml, other.yaml]\n")) == message


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ("[]", "case.yaml:1: from: the list is empty. Name a case file, or several."),
        (
            "[strip.yaml, no.yaml]",
            "case.yaml:1: from.1: there is no file 'no.yaml'. Names are relative to the case file, "
            "those of --set to the current folder.",
        ),
        ("[strip.yaml, 3]", "case.yaml:1: from.1: expected the name of a file, got 3."),
        (
            "[strip.yaml, case.yaml]",
            "case.yaml:1: from.1: this goes round in a circle: case.yaml from case.yaml.",
        ),
        ("[strip.yaml, list.yaml]", "list.yaml:1: expected keys with values."),
        ("[list.yaml, strip.yaml]", "list.yaml:1: expected keys with values."),
    ],
)
def test_a_file_that_cannot_be_taken_over_is_told_by_its_place(
    folder: Path, start: str, message: str
) -> None:
    _saved("- 1\n", "list.yaml")
    assert told(_saved(f"from: {start}\n")) == message


def test_a_fault_is_told_in_the_file_that_has_it(folder: Path) -> None:
    _saved(FABRIC.replace("30 N/m", "30 N"), "glass.yaml")
    _saved(TEST.replace("steps: 4", "stepps: 4"), "strip.yaml")
    with pytest.raises(CaseError) as caught:
        read_case("strip.yaml", fabric="glass.yaml")
    assert {(p.file, p.line, p.key) for p in caught.value.problems} == {
        ("glass.yaml", 8, "effects.shear.stiffness"),
        ("strip.yaml", 4, "program.stepps"),
    }


def test_what_is_missing_is_told_in_the_test(folder: Path) -> None:
    _saved(TEST.replace("title", "accuracy: 1 %\ntitle").partition("sheet")[0], "strip.yaml")
    with pytest.raises(CaseError) as caught:
        read_case("strip.yaml", fabric="glass.yaml")
    assert {p.file for p in caught.value.problems} == {"strip.yaml"}
    assert {p.key for p in caught.value.problems} == {"sheet", "boundary", "program"}


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("source: a table", "source: ''", "fabric.source"),
        ("  source: a table\n", "", "fabric.source"),
        ("measured: [shear]", "measured: [3]", "fabric.measured.0"),
        ("measured", "measurred", "fabric.measurred"),
    ],
)
def test_a_fabric_says_where_its_values_are_from(
    folder: Path, old: str, new: str, key: str
) -> None:
    _saved(FABRIC.replace(old, new), "glass.yaml")
    with pytest.raises(CaseError) as caught:
        read_case("strip.yaml", fabric="glass.yaml")
    assert [(p.file, p.key) for p in caught.value.problems] == [("glass.yaml", key)]


def test_the_name_tells_test_and_fabric_also_of_a_changed_case(folder: Path) -> None:
    joined = read_case("strip.yaml", fabric="glass.yaml")
    assert joined.name == joined.changed("program.steps=5").name == "strip-glass"


def test_a_fabric_names_its_files_from_its_own_folder(folder: Path) -> None:
    (folder / "far").mkdir()
    _saved(EFFECT, "far/my_effect.py")
    own = "my_effect: {file: my_effect.py, stiffness: 1 N/m}"
    fabric = _saved(f"{FABRIC}  {own}\n", "far/own.yaml")
    joined = read_case("strip.yaml", fabric=fabric)
    assert [e.file for e in joined.scene if e.file] == [folder / "far" / "my_effect.py"]
    assert effect_programs(Path("strip.yaml"), fabric=fabric)


def test_a_sweep_runs_each_test_with_each_fabric(folder: Path) -> None:
    _saved(FABRIC.replace("30 N/m", "40 N/m"), "stiff.yaml")
    members = members_of([Path("strip.yaml")], fabrics=[Path("glass.yaml"), Path("stiff.yaml")])
    assert [m.name for m in members] == ["strip-glass", "strip-stiff"]
    for member in members:
        case = member.case
        command = command_of(case, folder, folder / "log", "", 1, sent=False)
        given = command.arguments[command.arguments.index("--fabric") + 1]
        assert read_case(case.files[0], fabric=given) == case
