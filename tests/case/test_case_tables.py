"""Tables of forces: how they are read, written again, and refused."""

from __future__ import annotations

from math import radians
from pathlib import Path

import numpy as np
import pytest

from tests.case.reading import WriteCase, again, told
from wovenfab.case import Case, read_case
from wovenfab.case.fingerprint import fingerprint
from wovenfab.forms.table import ForceTable

SHEAR = "shear: {stiffness: 400 N/m}"
STRETCH = "stretch: {stiffness: 1.27e8 N/m}"
TABLE = "shear: {law: table, table: shear.csv}"
CURVE = "angle (deg),force (gf/cm)\n10,2\n20,5\n"


@pytest.fixture
def tabulated(example: str, write_case: WriteCase) -> Path:
    """Return a case with a tabulated shear law, beside its table."""
    assert SHEAR in example
    path = write_case(example.replace(SHEAR, TABLE))
    Path("shear.csv").write_text(CURVE)
    return path


def table_of(case: Case, name: str) -> ForceTable | tuple[ForceTable, ForceTable] | None:
    return next(e.table for e in case.scene if e.name == name)


def test_a_file_has_any_units_and_begins_at_rest(tabulated: Path) -> None:
    table = table_of(read_case(tabulated), "shear")
    assert isinstance(table, ForceTable)
    assert table.strains == pytest.approx((0, radians(10), radians(20)))
    assert table.forces == pytest.approx((0, 1.96133, 4.903325))


@pytest.mark.parametrize(
    "written",
    [
        '{angle: "0, 10, 20 deg", force: "0, 2, 5 gf/cm"}',
        "{angle: [10 deg, 20 deg], force: [2 gf/cm, 5 gf/cm]}",
    ],
)
def test_lists_in_the_case_are_the_same_as_a_file(tabulated: Path, written: str) -> None:
    inside = read_case(tabulated, [f"effects.shear.table={written}"])
    one, two = (table_of(case, "shear") for case in (inside, read_case(tabulated)))
    assert isinstance(one, ForceTable) and isinstance(two, ForceTable)
    assert one.strains == pytest.approx(two.strains, rel=1e-15)
    assert one.forces == pytest.approx(two.forces, rel=1e-15)


def test_what_is_recorded_needs_the_file_no_more(tabulated: Path) -> None:
    case = read_case(tabulated)
    Path("shear.csv").unlink()
    elsewhere = again(case, Path("elsewhere"))
    assert elsewhere == case and table_of(elsewhere, "shear") == table_of(case, "shear")
    assert case.changed("effects.shear.scale=2").effects["shear"]["scale"] == 2


def test_the_fingerprint_is_that_of_the_rows(tabulated: Path) -> None:
    before = fingerprint(read_case(tabulated))
    Path("shear.csv").write_text(CURVE.replace("(deg)", "[deg]") + "\n")
    assert fingerprint(read_case(tabulated)) == before
    Path("shear.csv").write_text(CURVE.replace("5", "5.01"))
    assert fingerprint(read_case(tabulated)) != before


def test_a_file_is_sought_beside_the_case_that_names_it(tabulated: Path) -> None:
    Path("further").mkdir()
    path = Path("further/case.yaml")
    path.write_text("from: ../case.yaml\ntitle: Another\n")
    assert table_of(read_case(path), "shear") == table_of(read_case(tabulated), "shear")


def test_families_may_have_tables_of_their_own(example: str, write_case: WriteCase) -> None:
    for name, force in (("warp", 30), ("weft", 20)):
        Path(f"{name}.csv").write_text(f"strain (%),force (N/mm)\n1,{force / 100}\n2,{force}\n")
    one, two = (
        read_case(write_case(example.replace(STRETCH, f"stretch: {{law: table, table: {given}}}")))
        for given in ("warp.csv", "[warp.csv, weft.csv]")
    )
    warp, weft = (ForceTable((0.01, 0.02), (10.0 * f, 1e3 * f)) for f in (30, 20))
    assert table_of(one, "stretch") == (warp, warp)
    assert table_of(two, "stretch") == (warp, weft)
    assert again(two, Path("elsewhere")) == two


@pytest.mark.parametrize(
    ("content", "place", "cause"),
    [
        (CURVE.replace("20,5", "20,1"), "shear.csv:3", "force must increase, got 0.98"),
        (CURVE.replace("20,5", "20,2"), "shear.csv:3", "force must increase"),
        (CURVE.replace("20,5", "10,5"), "shear.csv:3", "angle must increase"),
        (CURVE.replace("10,2", "-10,2"), "shear.csv:2", "angle must be finite and not negative"),
        (CURVE.replace("10,2", "0,2"), "shear.csv:2", "force must be zero at rest"),
        (CURVE.replace("10,2", "10,0"), "shear.csv:2", "force must increase"),
        (CURVE.replace("10,2", "10,x"), "shear.csv:2", "force must be a finite number, got 'x'"),
        (CURVE.replace("10,2", "10"), "shear.csv:2", "force must be a finite number, got nothing"),
        (CURVE.replace("10,2", "10,nan"), "shear.csv:2", "force must be a finite number"),
        (CURVE.replace("(deg)", ""), "shear.csv:1", "the column 'angle' has no unit"),
        (CURVE.replace("deg", "mm"), "shear.csv:1", "'angle (mm)' is no column with an angle"),
        (CURVE.replace("angle", "winkel"), "shear.csv:1", "there is no column 'angle'"),
        (CURVE.replace(",", ";"), "shear.csv:1", "there is no column 'angle'"),
        (CURVE.replace("force", "angle"), "shear.csv:1", "several columns 'angle'"),
        ("angle (deg),force (N/m)\n", "shear.csv", "angle must have one value above zero"),
        ("", "shear.csv:1", "there is no column 'angle'"),
        ("\xff\xfe", "shear.csv", "not a text file"),
        (CURVE + "95,9\n", "effects.shear.table", "ends at 95 deg, but yarns align at 90 deg"),
    ],
)
def test_bad_rows_are_told_with_file_and_line(
    tabulated: Path, content: str, place: str, cause: str
) -> None:
    Path("shear.csv").write_text(content, encoding="latin-1")
    words = told(tabulated)
    assert words.startswith("case.yaml:9: effects.shear.table: ")
    assert place in words and cause in words


def test_too_many_rows_are_refused(tabulated: Path) -> None:
    rows = "\n".join(f"{i / 10},{i}" for i in range(1, 400))
    Path("shear.csv").write_text(f"angle (deg),force (N/m)\n{rows}\n")
    assert "more than 100 rows" in told(tabulated)


@pytest.mark.parametrize(
    ("written", "key", "cause"),
    [
        ("none.csv", "table", "there is no file 'none.csv'"),
        ("3", "table", "expected"),
        ("{angle: [10 deg]}", "table.force", "missing"),
        ("{angle: [10 deg], force: [1 m]}", "table.force.0", "expected a force per length"),
        ("{angle: [10 deg, 20 deg], force: [1 N/m]}", "table", "has 1 values for 2"),
        ("{angle: [10 deg, 20 deg], force: [2 N/m, 1 N/m]}", "table", "row 2: force must increase"),
        ("{angle: [10 deg], torque: [1 N/m]}", "table.torque", "unknown key"),
    ],
)
def test_bad_tables_in_a_case_are_told_with_their_key(
    tabulated: Path, written: str, key: str, cause: str
) -> None:
    words = told(tabulated, [f"effects.shear.table={written}"])
    assert f"--set effects.shear.{key}: " in words
    assert cause in words


def test_the_law_with_a_stiffness_takes_no_table(tabulated: Path) -> None:
    assert "effects.shear.table: unknown key" in told(tabulated, ["effects.shear.law=tangent"])
    assert "effects.shear.table: missing" in told(tabulated, ["effects.shear.table=null"])
    assert "effects.shear.scale: expected" in told(tabulated, ["effects.shear.scale=1 m"])


@pytest.mark.parametrize(
    ("strains", "forces"), [((0.1,), (1.0, 2.0)), ((), ()), ((0.1,), (np.inf,))]
)
def test_what_is_no_law_is_refused_in_python(strains: tuple, forces: tuple) -> None:
    with pytest.raises(ValueError, match=r"^the (strain|force)"):
        ForceTable(strains, forces)
