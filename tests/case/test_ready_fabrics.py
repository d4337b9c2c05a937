"""The tests and fabrics of the project: each test takes each fabric, and does what it states."""

from __future__ import annotations

from math import acos, atan, degrees, pi, sqrt
from pathlib import Path

import pytest

from wovenfab.case import Case, CaseError, Rectangle, read_case
from wovenfab.case.boundary import conditions_of
from wovenfab.case.document import resolved_document
from wovenfab.case.program import RampSection, reached
from wovenfab.cli.check import check_case

CONFIGS = Path(__file__).parents[2] / "configs"
TESTS = sorted((CONFIGS / "tests").glob("*.yaml"))
FABRICS = sorted((CONFIGS / "fabrics").glob("*.yaml"))


@pytest.mark.parametrize("fabric", FABRICS, ids=lambda p: p.stem)
@pytest.mark.parametrize("test", TESTS, ids=lambda p: p.stem)
def test_every_test_takes_every_fabric(test: Path, fabric: Path) -> None:
    """But for conditions on one family, which need yarns that slide."""
    slides = "coupling" in resolved_document(fabric).data["effects"]
    if "family" in str(resolved_document(test).data["boundary"]) and not slides:
        with pytest.raises(CaseError) as caught:
            read_case(test, fabric=fabric)
        assert {p.key.rpartition(".")[2] for p in caught.value.problems} == {"family"}
        return
    case = read_case(test, fabric=fabric)
    assert not case.remarks()
    assert case.fabric and (case.fabric.measured or case.fabric.assumed)


@pytest.mark.parametrize("test", TESTS, ids=lambda p: p.stem)
def test_check_says_of_every_test_what_would_be_built(
    test: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fabric = CONFIGS / "fabrics" / "paper-standard.yaml"
    assert check_case(test, [], fabric=fabric) == 0
    said = capsys.readouterr().out
    assert f"{test.stem}-paper-standard: " in said and "the case is valid" in said
    known = read_case(test, fabric=fabric).fabric
    assert known and known.name in said and known.source in said


def _case(name: str) -> Case:
    fabric = CONFIGS / "fabrics" / "unbalanced.yaml"
    return read_case(CONFIGS / "tests" / f"{name}.yaml", fabric=fabric)


@pytest.mark.parametrize(
    ("name", "ends"), [("picture-frame", (0.0, 40.0)), ("cyclic-shear-frame", (-1.0, 1.0))]
)
def test_the_frame_turns_by_the_angle_that_is_stated(name: str, ends: tuple[float, float]) -> None:
    case = _case(name)
    (frame,) = {c.frame for _, _, c in conditions_of(case.boundary)}
    assert frame is not None
    travel = min(reached(case.program)), max(reached(case.program))
    angles = [pi / 2 - 2 * acos(1 / sqrt(2) + d / (2 * frame.length)) for d in travel]
    assert [*map(degrees, angles)] == pytest.approx(ends, abs=0.02)


def test_the_jaw_of_the_shear_test_goes_to_eight_degrees_both_ways() -> None:
    case = _case("kes-shear")
    assert isinstance(case.sheet, Rectangle)
    angles = [degrees(atan(u / case.sheet.length)) for u in reached(case.program)]
    assert (min(angles), max(angles)) == pytest.approx((-8, 8), abs=0.01)
    (jaw,) = case.boundary["right"]
    assert jaw.force is not None and jaw.force[0] == pytest.approx(9.80665)


def test_the_tension_test_ends_at_the_force_of_the_instrument() -> None:
    case = _case("kes-tension")
    assert isinstance(case.sheet, Rectangle)
    forces = [segment.to for segment in case.program if isinstance(segment, RampSection)]
    assert max(forces) / case.sheet.width == pytest.approx(490.3325)


@pytest.mark.parametrize("name", ["bias-extension", "bias-extension-held", "relaxation"])
def test_bias_extension_stays_below_the_displacement_at_which_it_locks(name: str) -> None:
    case = _case(name)
    assert isinstance(case.sheet, Rectangle)
    sheet = case.sheet
    assert max(reached(case.program)) < (sqrt(2) - 1) * (sheet.length - sheet.width)


def test_every_ready_test_and_fabric_is_listed_with_a_link() -> None:
    page = CONFIGS.parent / "docs" / "how-to" / "test-with-a-fabric.md"
    listed = page.read_text(encoding="utf-8")
    assert TESTS and FABRICS
    files = [f"{path.parent.name}/{path.name}" for path in (*TESTS, *FABRICS)]
    assert [name for name in files if f"(../../configs/{name})" not in listed] == []
