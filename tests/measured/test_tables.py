"""Which table of a file is read, which rows of it, and what is refused with its remedy."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from wovenfab.case import CaseError
from wovenfab.measured.cloud import read_cloud
from wovenfab.measured.curve import Measured, describe_reading, read_measured
from wovenfab.measured.layout import Layout, layout_of_options
from wovenfab.measured.table import read_table

N = 40
U = np.round(np.linspace(0.35, 47.4, N), 4)
F = np.round(0.36 + 0.0083 * U**2, 4)
INSTRON = (
    '"Specimen label","Twill 1"\n"Results Table 1"\n'
    '"","Maximum Load (N)","Extension at Maximum Load (mm)"\n'
    '"1","17.8509","47.421"\n"Mean","17.8509","47.421"\n\n'
)


def rows(first: int = 0, last: int = N, form: str = "{:.4f};{:.4f}", comma: bool = True) -> str:
    text = "".join(form.format(U[i], F[i]) + "\n" for i in range(first, last))
    return text.replace(".", ",") if comma else text


HEAD = "Weg [mm];Kraft [N]\n"
#: Files with the curve above, and how many rows are skipped in them.
READ: dict[str, tuple[str, dict[str, Any], int]] = {
    "results above, titles above units": (
        INSTRON + '"Time","Extension","Load"\n"(s)","(mm)","(N)"\n\n'
        + rows(form='"1{0:.4f}","{0:.4f}","{1:.4f}"', comma=False),
        {}, 0,
    ),
    "an empty first column and a strain": (
        INSTRON + '"Results Table 2"\n"","Extension","Load","Tensile strain (Extension)"\n'
        '"","(mm)","(N)","(%)"\n' + rows(form='"","{0:.4f}","{1:.4f}","{0:.4f}"', comma=False),
        {}, 0,
    ),
    "clock": (
        "Datum;Zeit;Weg [mm];Kraft [N]\n"
        + rows(form="14.03.2024;10:00:02;{:.4f};{:.4f}"),
        {}, 0,
    ),
    "repeated header, lost rows and a footer": (
        "Bericht;;\n" + HEAD + rows(0, 9) + "\n\n" + HEAD + rows(9, 20) + "NaN;NaN\n;\n"
        + rows(20, 30) + "25,0;---\n" + rows(30) + ";\nEinheiten;Weg in mm;Kraft in N\n"
        "Fmax;17,85;N\n",
        {}, 2,
    ),
    "errors of a spreadsheet": (
        HEAD + rows(0, 9) + "#WERT!;0,5\n" + rows(9, 30) + "12,5;#DIV/0!\n" + rows(30), {}, 2,
    ),
    "units below the table": ("Weg;Kraft\n" + rows() + "\nmm;N\n", {}, 0),
    "the last line has no force": (HEAD + rows() + "48,0;\n", {}, 1),
    "the last line is cut": (HEAD + rows() + "48,0", {}, 0),
    "the last number is cut": (HEAD + rows() + "48,0000;19,4", {}, 0),
    "specimens side by side": (
        "Probe 1;;Probe 2;\nWeg [mm];Kraft [N];Weg [mm];Kraft [N]\n"
        + rows(form="{0:.4f};9.0;{0:.4f};{1:.4f}"),
        {"columns": {"displacement": 3, "force": 4}}, 0,
    ),
    "specimens one below the other": (
        HEAD + rows() + "Probe 2\n" + HEAD + rows(3, 20),
        {"rows": (1, N + 1)}, 0,
    ),
    "a part between comments": (
        HEAD + rows(0, 20) + "Pause\n" + rows(20), {"rows": (2, 99)}, 0,
    ),
    "strain": (
        "Dehnung [%];Kraft [N]\n" + rows(form="{:.4f};{:.4f}"),
        {"columns": {"displacement": "Dehnung"}, "units": {"displacement": "1 mm"}}, 0,
    ),
    "force per width": (
        "Weg [mm];Kraft [N/mm]\n" + rows(), {"units": {"force": "1 N"}}, 0,
    ),
    "pull is negative": (
        HEAD + rows(form="{:.4f};-{:.4f}"), {"units": {"force": "-1 N"}}, 0,
    ),
    "grams": ("Weg [mm];Kraft [g]\n" + rows(), {"units": {"force": "N"}}, 0),
    "means below an empty line": (HEAD + rows() + "\n23,0;9,0\n", {}, 0),
    "blanks and units in brackets": (
        "Weg [mm]  Kraft [N]\n" + rows(form="  {:.4f}   {:.4f}", comma=False), {}, 0,
    ),
}  # fmt: skip


def written(text: str, folder: Path) -> Path:
    path = folder / "curve.csv"
    path.write_bytes(text.encode("cp1252"))
    return path


def is_the_curve(curve: Measured) -> None:
    np.testing.assert_allclose(curve.displacement, 1e-3 * U, rtol=1e-12)
    np.testing.assert_allclose(curve.force, F, rtol=1e-12)


@pytest.mark.parametrize("name", READ)
def test_the_table_is_read_whatever_else_is_in_the_file(name: str, tmp_path: Path) -> None:
    text, more, skipped = READ[name]
    curve = read_measured(written(text, tmp_path), Layout(**more))
    is_the_curve(curve)
    assert curve.reading is not None
    assert len(curve.reading.skipped) == skipped
    words = "\n".join(describe_reading(curve.reading))
    assert f"{N} rows" in words and f"largest force: {F[-1]:.5g} N" in words


@pytest.mark.parametrize(
    ("small", "large", "decimal"),
    [
        ("0,350", "1.580,5", ","),
        ("0.350", "1,580.5", "."),
        ("12,42", "1.580", ","),
        ("12.42", "1,580", "."),
        ("350", "1'580", "."),
        ("350,5", "1\u00a0580,5", ","),
    ],
)
def test_thousands_are_thousands(small: str, large: str, decimal: str, tmp_path: Path) -> None:
    text = HEAD + "".join(f"{i};{small}\n" for i in range(3)) + f"3;{large}\n4;{large}\n"
    force = read_measured(written(text, tmp_path)).force
    plain = small.replace(decimal, "."), large.replace("\u00a0", "").replace("'", "")
    other = "." if decimal == "," else ","
    largest = float(plain[1].replace(other, "").replace(decimal, "."))
    np.testing.assert_allclose(force, [float(plain[0])] * 3 + [largest] * 2)
    assert largest >= 1580


def test_whole_numbers_grow_into_thousands(tmp_path: Path) -> None:
    text = HEAD + "350;360\n1.580;669\n2.718;884\n3.970;1.063\n5.176;1.090\n"
    curve = read_measured(written(text, tmp_path))
    np.testing.assert_allclose(curve.displacement, [0.35, 1.58, 2.718, 3.97, 5.176])
    np.testing.assert_allclose(curve.force, [360, 669, 884, 1063, 1090])


AMBIGUOUS = HEAD + "1;1.360\n2;1.669\n3;1.884\n"


def test_what_numbers_do_not_tell_is_refused_with_both_readings(tmp_path: Path) -> None:
    path = written(AMBIGUOUS, tmp_path)
    with pytest.raises(CaseError) as caught:
        read_measured(path)
    for part in ("curve.csv:2", "'1.360'", "1.36 with a decimal point", "1360 with a decimal com"):
        assert part in str(caught.value)
    for decimal, factor in ((".", 1.0), (",", 1e3)):
        force = read_measured(path, Layout(decimal=decimal)).force
        np.testing.assert_allclose(force, factor * np.array([1.36, 1.669, 1.884]))


REFUSED: dict[str, tuple[str, dict[str, Any], tuple[str, ...]]] = {
    "two decimal signs": (HEAD + "0,5;0.25\n1,5;0.75\n2,5;0.85\n", {}, (":2:", "'0,5'", "'0.25'")),
    "too many lost": (
        HEAD + rows(0, 10) + "x;1,0\n" * 3 + rows(10, 20),
        {}, (":12:", "got 'x'", "3 of 23 rows", "10 %"),
    ),
    "two tables": (
        HEAD + rows(0, 20) + "Probe 2\n" + HEAD + rows(20),
        {}, ("two tables", "rows: 2-21", "--rows"),
    ),
    "two tables without titles": (
        HEAD + rows(0, 35) + "Pause\n" + rows(35), {}, ("two tables", "lines 38 to 42"),
    ),
    "strain": ("Dehnung [%];Kraft [N]\n" + rows(), {}, (":1:", "'Dehnung [%]' is a ratio", "mm")),
    "angle": ("Shear angle (deg);Force (N)\n" + rows(), {}, ("is an angle", "crosshead")),
    "force per width": (
        "Weg [mm];Kraft pro Breite [N/mm]\n" + rows(), {}, ("a force per length", "force: 100 N"),
    ),
    "force per width in grams": (
        "Weg [mm];Kraft [gf/cm]\n" + rows(), {}, ("a force per length", "force: 0.0980665 N"),
    ),
    "stress": ("Weg [mm];Kraft [MPa]\n" + rows(), {}, ("a force per area", "force: 50 N")),
    "mass": ("Weg [mm];Kraft [kg]\n" + rows(), {}, ("a mass", "force: kgf")),
    "names twice": (
        "Weg [mm];Kraft [N];Kraft [N]\n" + rows(form="{:.4f};{:.4f};9.0"),
        {"columns": {"force": "Kraft"}}, ("columns 2, 3 have the name", "force: 2"),
    ),
    "decimal commas between commas": (
        "Weg [mm],Kraft [N]\n" + rows(form="{:.4f},{:.4f}"), {}, ("4 numbers stand below 2 names",),
    ),
    "a column without a name": (
        HEAD + rows(form="7;{:.4f};{:.4f}"), {}, (":2:", "3 numbers stand below 2 names"),
    ),
    "names that blanks tear": (
        "Kraft bei 20 Grad Weg des Kopfes\n" + rows(form="{:.4f} {:.4f}", comma=False),
        {"units": {"displacement": "mm", "force": "N"}}, ("no column is known",),
    ),
    "thousands between blanks": (
        "Weg_um Kraft_N\n350,00 1,5\n1 580,00 2,5\n2 718,00 3,5\n", {}, ("blanks separate",),
    ),
    "rows without numbers": (HEAD + rows(), {"rows": (90, 99)}, ("lines 90 to 99",)),
    "no unit beside a number": (HEAD + rows(), {"units": {"force": "2"}}, ("without a unit",)),
    "two units": (
        "Weg [mm];Kraft [N]\nmm;kN\n" + rows(), {}, ("several units of the force", "'kN'"),
    ),
    "a step too large for thousands": (
        HEAD + "1;1\n2;1.250\n3;1.500\n4;2\n", {}, (":3:", "1250 with a decimal comma"),
    ),
    "zero": (HEAD + rows(), {"units": {"force": "0 N"}}, ("not be zero",)),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_sure_reading_is_refused_with_a_remedy(name: str, tmp_path: Path) -> None:
    text, more, parts = REFUSED[name]
    with pytest.raises(CaseError) as caught:
        read_measured(written(text, tmp_path), Layout(**more))
    assert "curve.csv" in str(caught.value)
    assert [part for part in parts if part not in str(caught.value)] == []


@pytest.mark.parametrize("start", [b"PK\x03\x04", b"\xd0\xcf\x11\xe0", b"%PDF", b"a\0\1\2\0\0"])
def test_files_that_are_no_text_are_refused(start: bytes, tmp_path: Path) -> None:
    (tmp_path / "curve.csv").write_bytes(start + bytes(range(256)))
    with pytest.raises(CaseError, match="this is not text"):
        read_measured(tmp_path / "curve.csv")


def test_options_say_the_same_as_a_layout() -> None:
    names = ("displacement", "force", "time")
    layout = layout_of_options(
        ["force=Kraft, N, displacement=1"], ["force=-1 N"], "12-", "comma", None, names
    )
    assert layout.columns == {"force": "Kraft, N", "displacement": 1}
    assert (layout.units, layout.decimal) == ({"force": "-1 N"}, ",")
    assert layout.rows is not None and layout.rows[0] == 12
    for bad in ({"columns": ["force"]}, {"units": ["mass=kg"]}, {"rows": "9-3"}, {"decimal": "x"}):
        given: dict[str, Any] = {
            "columns": [],
            "units": [],
            "rows": None,
            "decimal": None,
            "sheet": None,
            **bad,
        }
        with pytest.raises(CaseError, match="--"):
            layout_of_options(**given, quantities=names)


@pytest.mark.parametrize(
    ("head", "more"),
    [
        ("# GOM\nid;x [mm];y [mm];z [mm];displacement x [mm];displacement y [mm]", {}),
        (
            '"n";"X";"Y";"Z";"U";"V"',
            {"units": dict.fromkeys(("x", "y", "ux", "uy"), "mm")},
        ),
        (
            "n;a;b;c;d;e",
            {
                "columns": {"x": 2, "y": "b", "ux": 5, "uy": 6},
                "units": dict.fromkeys(("x", "y", "ux", "uy"), "mm"),
            },
        ),
    ],
)
def test_clouds_of_several_programs_are_read(
    head: str, more: dict[str, Any], tmp_path: Path
) -> None:
    lines = "0;1,5;2,5;0,0;0,25;-0,5\n1;3,5;4,5;0,0;NaN;\n2;5,5;6,5;0,0;0,75;1,5\n"
    found = read_cloud(written(f"{head}\n{lines}", tmp_path), Layout(**more))
    points, moved = found.points, found.displacements
    np.testing.assert_allclose(points, [[1.5e-3, 2.5e-3], [5.5e-3, 6.5e-3]])
    np.testing.assert_allclose(moved, [[0.25e-3, -0.5e-3], [0.75e-3, 1.5e-3]])


def test_a_file_without_an_end_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")  # nobody writes into it
    for path in (Path("/dev/zero"), tmp_path / "pipe.csv"):
        with pytest.raises(CaseError, match="not an ordinary file"):
            read_measured(path)
    with (tmp_path / "large.csv").open("wb") as file:
        file.truncate(10**10)  # takes no room on the disk
    with pytest.raises(CaseError, match="too large"):
        read_measured(tmp_path / "large.csv")


def test_lines_that_repeat_the_header_are_told(tmp_path: Path) -> None:
    rows = [f"{n};{2 * n}" for n in range(1, 41)]
    for place in (10, 21, 32):
        rows.insert(place, "displacement [mm];force [N]")
    file = tmp_path / "machine.csv"
    file.write_text("\n".join(["displacement [mm];force [N]", *rows, ""]))
    table = read_table(file, Layout())
    assert len(table.rows) == 40
    assert all(any(str(line) in note for note in table.notes) for line in (12, 23, 34))
