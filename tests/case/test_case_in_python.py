"""Cases that are built in Python, and cases that are changed."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import pytest

from tests.case.reading import WriteCase
from wovenfab.case import (
    Case,
    CaseError,
    CyclesSection,
    Discretisation,
    EdgeCondition,
    HoldSection,
    RampSection,
    Rectangle,
    SheetFile,
    TableSection,
    Time,
    read_case,
)

CONFIGS = Path(__file__).parents[2] / "configs"
#: What example.yaml says.
SECTIONS: dict[str, Any] = {
    "title": "Bias extension",
    "sheet": {"length": "0.90 m", "width": 0.3, "fibres": ["45 deg", "-45 deg"]},
    "effects": {"stretch": {"stiffness": "1.27e8 N/m"}, "shear": {"stiffness": "400 N/m"}},
    "boundary": {"left": "clamp", "right": {"displacement": ["program", 0]}},
    "program": {"type": "cycles", "amplitudes": ["20 mm", "40 mm"], "max_velocity": "0.5 m/s"},
}


def _refusal(**sections: Any) -> list[str]:
    with pytest.raises(CaseError) as caught:
        Case(**SECTIONS | sections)
    return str(caught.value).split("\n")


@pytest.mark.parametrize(
    "sections",
    [
        {},
        {"sheet": Rectangle(length="0.9 m", width=0.3, fibres=("45 deg", "-45 deg"))},
        {"program": CyclesSection(amplitudes=("20 mm", "0.04 m"), max_velocity="0.5 m/s")},
        {"program": (CyclesSection(amplitudes=["20 mm", "40 mm"], max_velocity=0.5),)},
        {"boundary": {"left": EdgeCondition(clamp="placement"),
                      "right": (EdgeCondition(displacement=("program", 0)),)}},
        {"time": Time(), "discretisation": Discretisation(degree=3)},
    ],
)  # fmt: skip
def test_sections_are_mappings_or_objects(sections: dict[str, Any], write_case: WriteCase) -> None:
    case = Case(**SECTIONS | sections)
    assert (case.name, case.path, case.overrides) == ("case", None, ())
    assert case == read_case(write_case(case.to_yaml()))
    assert case.discretisation.mesh_size == pytest.approx(0.075)
    assert case.output.fields == ("displacement", "shear_angle", "stretch")
    assert pickle.loads(pickle.dumps(case)) == case


def test_files_are_relative_to_the_current_folder(tmp_path: Path, write_case: WriteCase) -> None:
    (tmp_path / "u.csv").write_text("time_s,displacement_m\n0,0\n1,1e-3\n")
    (tmp_path / "sheet.geo").write_text("")
    sheet = SheetFile(file="sheet.geo", fibres=("45 deg", "-45 deg"))
    case = Case(**SECTIONS | {"sheet": sheet, "program": [TableSection(file="u.csv")]})
    assert case.sheet.file == tmp_path / "sheet.geo"
    assert case.program[0].samples.values == (0.0, 1e-3)


@pytest.mark.parametrize(
    ("sections", "messages"),
    [
        ({"sheet": {"length": "3 s"}}, [
            "sheet.length: expected a length such as '40 mm', got 's'.",
            "sheet.width: missing. For example 'width: 0.30 m'.",
            "sheet.fibres: missing. For example 'fibres: [45 deg, -45 deg]'."]),
        ({"time": {"scheme": "bdf4"}, "titel": ""}, [
            "time.scheme: expected 'bdf2', 'bdf3', 'backward-euler' or 'midpoint', got 'bdf4'. "
            "Did you mean 'bdf3'?", "titel: unknown key. Did you mean 'title'?"]),
        ({"boundary": {"lft": "clamp"}}, [
            "boundary.lft: unknown edge. Did you mean 'left'? The edges are left, right, bottom, "
            "top.",
            "boundary: the held edges leave the sheet free to move along x. Clamp an edge, as in "
            "'left: clamp'.",
            "program: no edge uses the program. For example 'right: {displacement: [program, 0]}' "
            "in boundary."]),
        ({"discretisation": Discretisation(mesh_size="1 m")}, [
            "discretisation.mesh_size: is larger than the shorter side, 0.3 m."]),
        ({"program": [HoldSection(duration=1), RampSection(to=0)]}, [
            "program.1.to: the displacement is 0 m already. Use {type: hold} to wait."]),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_by_its_key(sections: dict[str, Any], messages: list[str]) -> None:
    assert _refusal(**sections) == messages


def test_a_section_alone_is_checked_like_one_of_a_case() -> None:
    with pytest.raises(CaseError) as caught:
        Rectangle(length="0 m", widht=1, fibres=(0, 1))
    assert repr(caught.value) == (
        "CaseError(\"length: must be positive, got '0 m'.\\n"
        "widht: unknown key. Did you mean 'width'?\")"
    )


def test_a_case_and_its_sections_are_shown_in_short() -> None:
    case = Case(**SECTIONS)
    assert repr(case) == (
        "<Case case: 0.9 m x 0.3 m; effects shear, stretch; edges left, right; program cycles>"
    )
    assert repr(RampSection(to="1 m")) == "RampSection(type='ramp', to=1.0, steps=20)"


def test_a_changed_case_is_checked_again_and_keeps_its_origin(
    example: str, write_case: WriteCase
) -> None:
    path = write_case(example)
    case = read_case(str(path), {"effects.shear.stiffness": "500 N/m", "output.every": 2})
    assert case.overrides == ("effects.shear.stiffness=500 N/m", "output.every=2")
    other = case.changed("output.every=3", {"program.amplitudes": ["30 mm"]})
    assert (other.path, other.output.every, other.program[0].amplitudes) == (path, 3, (0.03,))
    assert other == read_case(path, other.overrides)
    assert case.data["output"]["every"] == 2
    with pytest.raises(CaseError, match=r"^--set time.scheme: expected"):
        case.changed({"time.scheme": "x"})
    assert Case(**SECTIONS).changed("sheet.length=2 m").sheet.length == 2


@pytest.mark.parametrize("name", ["bias-1x3", "biaxial", "coulomb", "programs/measured"])
def test_a_copy_with_other_sections_stays_so_when_it_is_changed(name: str) -> None:
    case, other = (read_case(CONFIGS / f"{n}.yaml") for n in (name, "probes-1x3"))
    steps = case.time.model_copy(update={"steps_per_cycle": 24})
    sections: dict[str, Any] = {
        "time": steps,
        "solver": case.solver.model_copy(update={"tolerance": 1e-7}),
        "discretisation": case.discretisation.model_copy(update={"degree": 2}),
        "program": (RampSection(to=0.01, steps=7, velocity=0.1),),
        "second_program": None,
        "output": other.output,
        "title": "another",
    }
    for section, value in sections.items():
        copy = case.model_copy(update={section: value})
        again = copy.changed()
        assert getattr(again, section) == value == getattr(copy, section)
        assert again == copy
        assert copy.changed("title=more") == again.changed({"title": "more"})
        assert case.changed() == case
    copy = case.model_copy(update=sections)
    assert copy.changed("output.every=7").output.every == 7
    assert copy.changed("output.every=7").time == steps
    if case.path is not None:
        assert read_case(case.path, copy.overrides) == copy


@pytest.mark.parametrize("name", ["bias-1x3", "picture-frame", "force-cycles", "programs/measured"])
def test_what_a_case_says_reads_as_the_case(name: str) -> None:
    case = read_case(CONFIGS / f"{name}.yaml")
    assert case.changed() == case
    assert Case(**case.data).to_yaml() == case.to_yaml() == case.changed().to_yaml()
    assert case.changed().remarks() == case.remarks()


def test_values_that_depend_on_others_follow_them_unless_given() -> None:
    case = read_case(CONFIGS / "bias-1x3.yaml", ["discretisation=null", "output=null"])
    half = case.changed({"sheet.width": case.sheet.width / 2, "effects.slip_friction": None})
    assert half.discretisation.mesh_size == case.discretisation.mesh_size / 2
    kept = case.model_copy(update={"discretisation": case.discretisation})
    assert kept.changed("sheet.width=0.15 m").discretisation == case.discretisation
    plain = case.changed("time=null")
    assert plain.changed("accuracy=1 %").changed("accuracy=null") == plain


def test_problems_of_a_changed_case_have_their_lines(example: str, write_case: WriteCase) -> None:
    """A short form is written out in the model; its line is that of the short form."""
    path = write_case(example)
    case = read_case(path).changed("output.every=3")
    assert str(case.problem("boundary.right.displacement.0", "no")) == str(
        read_case(path).problem("boundary.right.displacement.0", "no")
    )
    with pytest.raises(CaseError, match=r"^case.yaml:\d+: boundary.left: .*"):
        case.changed("boundary.left.rotation=held", "effects.bending=null")
    with pytest.raises(CaseError, match=r"^--set program.amplitudes.0: must be positive"):
        case.changed("program.0.amplitudes=[-1 mm]")


def test_a_copy_without_its_accuracy_does_not_get_it_back() -> None:
    case = read_case(CONFIGS / "elastic-1x3.yaml", ["accuracy=1 %", "discretisation=null"])
    chosen = case.discretisation.model_copy(update={"degree": 4, "mesh_size": 0.05})
    copy = case.model_copy(update={"accuracy": None}).model_copy(update={"discretisation": chosen})
    again = copy.changed("output.every=7")
    assert again.accuracy is None and again.discretisation == chosen
    with pytest.raises(CaseError, match=r"discretisation\.degree: is chosen by the program"):
        copy.changed("accuracy=1 %")
