"""Files that are no cases at all, and values given on the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.case.reading import WriteCase, told
from wovenfab.case import CyclesSection, read_case


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
    assert told(Path(path)) == says


def test_a_byte_order_mark_does_no_harm(example: str, write_case: WriteCase) -> None:
    assert read_case(write_case("\ufeff" + example)) == read_case(write_case(example))


@pytest.mark.parametrize("text", ["", "# nothing\n", "---\n"])
def test_an_empty_file_says_where_to_start(text: str, write_case: WriteCase) -> None:
    says = told(write_case(text))
    assert says.startswith("case.yaml")
    assert "the file is empty" in says or "got nothing" in says


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
    assert "lists or mappings are nested too deeply" in told(write_case(text))


def test_numbers_that_python_cannot_read_are_named(example: str, write_case: WriteCase) -> None:
    says = told(write_case(example.replace("degree: 3", f"degree: {'9' * 5000}")))
    assert says == "case.yaml:21: discretisation.degree: this number cannot be read."


def test_numbers_mean_the_same_in_yaml_1_1_and_1_2(example: str, write_case: WriteCase) -> None:
    texts = ("1e8", "1E8", "'1e8'", "1.0e+8", "100_000_000", "1e8 N/m", "100 MN/m")
    for text in texts:
        case = read_case(write_case(example.replace("1.27e8 N/m", text)))
        assert case.effects["stretch"]["stiffness"] == (1e8, 1e8)


def test_aliases_and_anchors_are_read(example: str, write_case: WriteCase) -> None:
    text = example.replace("left: clamp", "left: &grip clamp\n  right: *grip", 1)
    text = text.replace("  right: {displacement: [program, 0]}\n", "")
    assert "no edge uses the program" in told(write_case(text))


def test_overrides_replace_add_and_take_out(example: str, write_case: WriteCase) -> None:
    case = read_case(
        write_case(example),
        [
            "effects.shear.stiffness=500 N/m",
            "effects.spin_friction={strength: 30 N/m, slope: 40 s}",
            "effects.coupling=null",
            "program.amplitudes.1=30 mm",
            "sheet.fibres=[0, 90 deg]",
            "solver.petsc.pc_type=lu",
            "output.every=2",
            "output.every=3",
        ],
    )
    assert case.effects["shear"] == {"stiffness": 500.0}
    assert case.effects["spin_friction"] == {"strength": 30.0, "slope": 40.0}
    assert "coupling" not in case.effects
    assert isinstance(case.program[0], CyclesSection)
    assert case.program[0].amplitudes == (0.02, 0.03, 0.06)
    assert case.sheet.fibres[0] == 0
    assert case.solver.petsc == {"pc_type": "lu"}
    assert case.output.every == 3


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
