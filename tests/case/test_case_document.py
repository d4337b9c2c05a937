"""Files that are no cases at all, and values given on the command line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from wovenfab.case import CaseError, Cycles, read_case

WriteCase = Callable[[str], Path]


def _told(path: Path, *overrides: str) -> str:
    with pytest.raises(CaseError) as caught:
        read_case(path, overrides)
    return str(caught.value)


@pytest.mark.parametrize(
    ("path", "content", "says"),
    [
        ("none.yaml", None, "none.yaml: there is no such file."),
        (".", None, ".: this is a folder. Name the case file in it."),
        ("/dev/zero", None, "/dev/zero: this is not an ordinary file."),
        (
            "case.yaml",
            b"#" * 1_000_001,
            "case.yaml: this is too large to be a case file (more than 1 MB).",
        ),
        (
            "case.yaml",
            b"title: x\nsheet: \xff\n",
            "case.yaml:2: this is not UTF-8 text. Save the file in UTF-8.",
        ),
        (
            "case.yaml",
            b"title: \x01",
            "case.yaml: this is not text: it has control characters in it.",
        ),
    ],
    ids=["missing", "folder", "device", "large", "encoding", "control characters"],
)
def test_what_is_no_text_file_is_named(
    path: str, content: bytes | None, says: str, write_case: WriteCase
) -> None:
    write_case("").write_bytes(content or b"")
    assert _told(Path(path)) == says


def test_a_byte_order_mark_does_no_harm(example: str, write_case: WriteCase) -> None:
    assert read_case(write_case("\ufeff" + example)) == read_case(write_case(example))


@pytest.mark.parametrize("text", ["", "# nothing\n", "---\n"])
def test_an_empty_file_says_where_to_start(text: str, write_case: WriteCase) -> None:
    told = _told(write_case(text))
    assert told.startswith("case.yaml")
    assert "the file is empty" in told or "got nothing" in told


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("[" * 500, id="brackets"),
        pytest.param("\n".join("  " * i + "a:" for i in range(40)), id="indented"),
        pytest.param("a: &a [*a]", id="alias to itself"),
        pytest.param(
            "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1]\n"
            + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 8)}]\n" for i in range(1, 9)),
            id="aliases that multiply",
        ),
    ],
)
def test_huge_nesting_is_refused(text: str, write_case: WriteCase) -> None:
    assert "lists or mappings are nested too deeply" in _told(write_case(text))


def test_numbers_that_python_cannot_read_are_named(example: str, write_case: WriteCase) -> None:
    told = _told(write_case(example.replace("degree: 3", f"degree: {'9' * 5000}")))
    assert told == "case.yaml:21: discretisation.degree: this number cannot be read."


def test_numbers_mean_the_same_in_yaml_1_1_and_1_2(example: str, write_case: WriteCase) -> None:
    texts = ("1e8", "1E8", "'1e8'", "1.0e+8", "100_000_000", "1e8 N/m", "100 MN/m")
    for text in texts:
        case = read_case(write_case(example.replace("1.27e8 N/m", text)))
        assert case.effects["stretch"]["stiffness"] == (1e8, 1e8)


def test_aliases_and_anchors_are_read(example: str, write_case: WriteCase) -> None:
    text = example.replace("left: clamp", "left: &grip clamp\n  right: *grip", 1)
    text = text.replace("  right: {displacement: [program, 0]}\n", "")
    assert "no edge uses the program" in _told(write_case(text))


def test_overrides_replace_add_and_take_out(example: str, write_case: WriteCase) -> None:
    case = read_case(
        write_case(example),
        [
            "effects.shear.stiffness=500 N/m",
            "effects.spin_friction={strength: 30 N/m, slope: 40 s}",
            "effects.coupling=null",
            "program.amplitudes.1=30 mm",
            "sheet.fibres=[0, 90 deg]",
            "solver.petsc.snes_type=newtontr",
            "output.every=2",
            "output.every=3",
        ],
    )
    assert case.effects["shear"] == {"stiffness": 500.0}
    assert case.effects["spin_friction"] == {"strength": 30.0, "slope": 40.0}
    assert "coupling" not in case.effects
    assert isinstance(case.program[0], Cycles)
    assert case.program[0].amplitudes == (0.02, 0.03, 0.06)
    assert case.sheet.fibres[0] == 0
    assert case.solver.petsc == {"snes_type": "newtontr"}
    assert case.output.every == 3


@pytest.mark.parametrize(
    ("override", "told"),
    [
        (
            "effects.shear.stiffness=5 mN",
            "--set effects.shear.stiffness: expected a force per length such as '400 N/m', "
            "got 'mN'.",
        ),
        (
            "effects.shear.stifness=5",
            "--set effects.shear.stifness: unknown key. Did you mean 'stiffness'?",
        ),
        (
            "effects.spin_friction.strength=30",
            "--set effects.spin_friction.slope: missing. For example 'slope: 2 s'.",
        ),
        (
            "program.amplitudes.7=1",
            "--set program.amplitudes.7: there is no such key, for program.amplitudes is a list "
            "of 3, counted from 0.",
        ),
        (
            "effects.shear.stiffness.x=1",
            "--set effects.shear.stiffness.x: there is no such key, for "
            "effects.shear.stiffness is a plain value.",
        ),
        (
            "time.scheme=[1",
            "--set time.scheme: this is not valid YAML: while parsing a flow sequence, "
            "expected ',' or ']', but got '<stream end>'.",
        ),
        (
            "effects.shear.stiffness",
            "--set: expected 'key=value', got 'effects.shear.stiffness'. For example --set "
            "time.steps_per_cycle=160.",
        ),
    ],
)
def test_errors_of_overrides_name_the_override(
    override: str, told: str, example: str, write_case: WriteCase
) -> None:
    assert _told(write_case(example), override) == told


def test_a_case_that_is_no_mapping_takes_no_override(write_case: WriteCase) -> None:
    told = _told(write_case("hello"), "time.scheme=bdf2")
    assert told == "--set time: there is no such key, for the case is a plain value."


def test_an_overridden_error_of_the_file_is_no_error(example: str, write_case: WriteCase) -> None:
    path = write_case(example.replace("400 N/m}", "soft}"))
    assert read_case(path, ["effects.shear.stiffness=1"]).effects["shear"]["stiffness"] == 1


def test_a_problem_found_later_has_the_line_of_its_key(example: str, write_case: WriteCase) -> None:
    path = write_case(example)
    assert str(read_case(path).problem("boundary.right", "no such group")) == (
        "case.yaml:15: boundary.right: no such group."
    )
    given = read_case(path, ["boundary.left=clamp"]).problem("boundary.left", "no such group")
    assert str(given) == "--set boundary.left: no such group."
