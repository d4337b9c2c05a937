"""Workbooks are read as the same table in a text is; those that cannot be are told in words."""

from __future__ import annotations

import re
import struct
import sys
from collections.abc import Callable
from datetime import datetime, time, timedelta
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
import openpyxl
import pytest

from wovenfab.case import CaseError
from wovenfab.lacking import LackingError
from wovenfab.measured import workbook
from wovenfab.measured.cloud import read_cloud
from wovenfab.measured.curve import describe_reading, read_measured
from wovenfab.measured.layout import Layout
from wovenfab.study.fit.fit_file import read_fit

N = 40
U = np.round(np.random.default_rng(3).uniform(0.5, 1.0, N).cumsum(), 6)
F = np.round(0.36 + 0.0083 * U**2, 9)
HEAD = ["Weg [mm]", "Kraft [N]"]
Rows = list[list[Any]]


def curve(scale: float = 1.0) -> Rows:
    return [[float(u), scale * float(f)] for u, f in zip(U, F, strict=True)]


def made(
    path: Path, sheets: dict[str, Rows], change: Callable[[Any], None] = lambda book: None
) -> Path:
    """Write a workbook with such sheets; return its path."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    change(book)
    book.save(path)
    return path


def commas(rows: Rows) -> Rows:
    return [[f"{value:.17g}".replace(".", ",") for value in row] for row in rows]


def merged(book: Any) -> None:
    book.active.merge_cells("A1:B1")
    book.active.merge_cells("A2:A3")


def hide(book: Any) -> None:
    book["Raw"].sheet_state = "hidden"


LONG = [HEAD, *curve(9.0), *curve(9.0)]
#: Sheets with the curve above, how they are changed, what is said, and how many rows are skipped.
READ: dict[str, tuple[dict[str, Rows], Callable[[Any], None], dict[str, Any], int]] = {
    "numbers": ({"Data": [HEAD, *curve()]}, lambda book: None, {}, 0),
    "numbers as text with a decimal comma": (
        {"Data": [HEAD, *commas(curve())]}, lambda book: None, {}, 0,
    ),
    "numbers, some of them as text with a decimal comma": (
        {"Data": [HEAD, *commas(curve()[:7]), *curve()[7:]]}, lambda book: None, {}, 0,
    ),
    "merged and empty cells, names of two lines, units below": (
        {"Data": [["Probe 1", None], ["Twill", None], [None, None], [], ["Weg\n", "Kraft"],
                  ["mm", "N"], *curve()]},
        merged, {}, 0,
    ),
    "first columns and rows are empty": (
        {"Data": [[], [], [None, None, *HEAD], *([None, None, *row] for row in curve())]},
        lambda book: None, {}, 0,
    ),
    "dates, times and remarks beside": (
        {"Data": [["Datum", "Zeit", *HEAD, "Bemerkung"],
                  *([datetime(2024, 3, 14, 10, 0, i), time(10, 0, i), *row, "Riss" * (i > 30)]
                    for i, row in enumerate(curve()))]},
        lambda book: None, {}, 0,
    ),
    "errors and lost cells": (
        {"Data": [HEAD, *curve()[:5], ["#DIV/0!", 1.0], [7.0, None], *curve()[5:]]},
        lambda book: None, {}, 2,
    ),
    "the longest of several sheets": (
        {"Results": [["Name", "Fmax [N]"], ["a", 3.0], ["b", 4.0]], "Data": [HEAD, *curve()],
         "Other": [HEAD, *curve(9.0)[:10]]},
        lambda book: None, {}, 0,
    ),
    "a hidden sheet is longer": ({"Data": [HEAD, *curve()], "Raw": LONG}, hide, {}, 0),
    "a sheet by its name": ({"Raw": LONG, "Probe 2": [HEAD, *curve()]}, lambda book: None,
                            {"sheet": "probe 2"}, 0),
    "a hidden sheet by its name": (
        {"Data": LONG, "Raw": [HEAD, *curve()]}, hide, {"sheet": "Raw"}, 0,
    ),
    "rows and columns are said": (
        {"Data": [HEAD, *curve(9.0)[:9], *([a, 0.0, b] for a, b in curve())]}, lambda book: None,
        {"rows": (11, N + 10), "columns": {"displacement": 1, "force": 3}, "units": {"force": "N"}},
        0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", READ)
def test_numbers_of_a_workbook_are_read_exactly(name: str, tmp_path: Path) -> None:
    sheets, change, more, skipped = READ[name]
    found = read_measured(made(tmp_path / "curve.xlsx", sheets, change), Layout(**more))
    assert np.array_equal(found.displacement, 1e-3 * U)
    assert np.array_equal(found.force, F)
    assert found.reading is not None and len(found.reading.skipped) == skipped
    words = "\n".join(describe_reading(found.reading))
    assert f"sheet {more.get('sheet', 'Data')!r}".casefold() in words.casefold()
    assert f"{N} rows" in words and f"largest force: {F[-1]:.5g} N" in words


def test_lines_of_a_workbook_are_the_rows_that_a_spreadsheet_shows(tmp_path: Path) -> None:
    rows = [[], ["Report"], [], HEAD, *curve()]
    found = read_measured(made(tmp_path / "curve.xlsx", {"Data": rows}))
    assert found.reading is not None
    assert (found.reading.table.header, *found.reading.lines[[0, -1]]) == (4, 5, N + 4)


@pytest.mark.parametrize("value", [1.5, -0.1, 1e-300, 1.7e308, 3, -250, 5e-324])
def test_a_number_is_the_same_with_either_decimal_sign(value: float, tmp_path: Path) -> None:
    rows = [HEAD, *([i, value] for i in range(5))]
    for sign in (".", ","):
        found = read_measured(made(tmp_path / "curve.xlsx", {"Data": rows}), Layout(decimal=sign))
        assert set(found.force) == {value}


def test_durations_are_no_numbers_and_are_told(tmp_path: Path) -> None:
    rows = [["time [s]", *HEAD], *([timedelta(seconds=i), *r] for i, r in enumerate(curve()))]
    found = read_measured(made(tmp_path / "curve.xlsx", {"Data": rows}))
    assert found.time is None and found.reading is not None
    assert any("time" in note for note in found.reading.notes)


def test_other_sheets_of_a_similar_size_are_told(tmp_path: Path) -> None:
    sheets = {"A": [HEAD, *curve()], "B": [HEAD, *curve(2.0)[:-1]], "C": [HEAD, *curve()[:9]]}
    found = read_measured(made(tmp_path / "curve.xlsx", sheets))
    assert found.reading is not None
    told = [note for note in found.reading.notes if "--sheet" in note]
    assert len(told) == 1 and "'B'" in told[0]


def test_a_cloud_is_read_from_a_workbook(tmp_path: Path) -> None:
    head = ["x [mm]", "y [mm]", "u [mm]", "v [mm]"]
    rows = [head, *([i, 2.0 * i, 0.5, None if i == 3 else -0.25] for i in range(6))]
    found = read_cloud(made(tmp_path / "cloud.xlsx", {"Data": rows}))
    points, moved = found.points, found.displacements
    np.testing.assert_allclose(points[:, 1], 2e-3 * np.array([0, 1, 2, 4, 5]), rtol=1e-15)
    assert np.array_equal(moved, np.tile([0.5e-3, -0.25e-3], (5, 1)))


def test_a_fit_file_names_workbook_and_sheet(tmp_path: Path) -> None:
    made(tmp_path / "curve.xlsx", {"A": [HEAD, *curve()], "B": [HEAD, *curve(2.0)]})
    (tmp_path / "case.yaml").write_text(
        "sheet: {length: 0.6 m, width: 0.2 m, fibres: [45 deg, -45 deg]}\n"
        "effects: {stretch: {stiffness: 2e5 N/m}, shear: {stiffness: 60 N/m}}\n"
        "boundary: {left: clamp, right: {displacement: [program, 0]}}\n"
        "program: {type: ramp, to: 60 mm, steps: 8}\n"
    )
    (tmp_path / "fit.yaml").write_text(
        "tests: [{case: case.yaml, measured: curve.xlsx, sheet: B}]\n"
        "parameters: {shear.stiffness: }\n"
    )
    (test,) = read_fit(tmp_path / "fit.yaml").tests
    assert np.array_equal(test.measured.force, 2 * F)


PARTS = ("xl/workbook.xml", "xl/worksheets/sheet1.xml", "[Content_Types].xml", "xl/styles.xml")


def changed(part: str, change: Callable[[bytes], bytes | None]) -> bytes:
    """Return a workbook with the curve, one of whose parts is changed; None takes it away."""
    return repacked(with_sheets({"Data": [HEAD, *curve()]}), part, change)


def repacked(whole: bytes, part: str, change: Callable[[bytes], bytes | None]) -> bytes:
    """Return an archive with a changed part."""
    other = BytesIO()
    with ZipFile(BytesIO(whole)) as source, ZipFile(other, "w", ZIP_DEFLATED) as target:
        for name in source.namelist():
            raw = source.read(name)
            new = change(raw) if name == part else raw
            if new is not None:
                target.writestr(name, new)
    return other.getvalue()


def archive(*names: str, size: int = 3) -> bytes:
    raw = BytesIO()
    with ZipFile(raw, "w", ZIP_DEFLATED) as target:
        for name in names:
            target.writestr(name, b" " * size)
    return raw.getvalue()


def with_flag(raw: bytes) -> bytes:
    """Return an archive all of whose parts are said to be encrypted."""
    for mark, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        places = [i for i in range(len(raw)) if raw.startswith(mark, i)]
        for i in places:
            flags = struct.unpack_from("<H", raw, i + at)[0] | 1
            raw = raw[: i + at] + struct.pack("<H", flags) + raw[i + at + 2 :]
    return raw


def with_sheets(sheets: dict[str, Rows], change: Callable[[Any], None] = lambda b: None) -> bytes:
    raw = BytesIO()
    made(raw, sheets, change)  # type: ignore[arg-type]
    return raw.getvalue()


def with_size(raw: bytes) -> bytes:
    """Return a workbook whose sheet is said to be as large as one can be."""
    return repacked(raw, PARTS[1], lambda part: re.sub(rb'ref="[A-Z0-9:]+"', WHOLE_SHEET, part))


WHOLE_SHEET = b'ref="A1:XFD1048576"'
SHEET = PARTS[1]
WHOLE = changed("", lambda raw: raw)
OLE = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + b"\0" * 600
LAUGHS = (
    b'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "ha">'
    + b"".join(b'<!ENTITY %c "%s">' % (98 + i, b"&%c;" % (97 + i) * 20) for i in range(9))
    + b"]><worksheet>&j;</worksheet>"
)
FORMULAS = [HEAD, *([f"={i}/7", f"={i}/3"] for i in range(N))]
#: What is in a file that is no workbook with a curve, what is said, and parts of the message.
BAD: dict[str, tuple[bytes, dict[str, Any], tuple[str, ...]]] = {
    "empty file": (b"", {}, ("no workbook",)),
    "text": (b"Weg [mm];Kraft [N]\n1;2\n2;3\n3;4\n", {}, ("no workbook", ".csv")),
    "web page": (b"<html><table><tr><td>1</td></tr></table></html>", {}, ("no workbook",)),
    "encrypted": (OLE + "EncryptedPackage".encode("utf-16-le"), {}, ("encrypted", "password")),
    "old workbook": (OLE, {}, ("XLS", "XLSX or CSV")),
    "encrypted archive": (with_flag(WHOLE), {}, ("encrypted", "password")),
    "cut": (WHOLE[: len(WHOLE) // 2], {}, ("no whole workbook",)),
    "bytes lost": (WHOLE[:900] + WHOLE[1000:], {}, ("damaged",)),
    "another archive": (archive("a.txt"), {}, ("another archive",)),
    "open document": (archive("mimetype", "content.xml"), {}, ("ODS", "XLSX")),
    "binary workbook": (archive("xl/workbook.bin"), {}, ("XLSB",)),
    "text document": (archive("word/document.xml"), {}, ("DOCX",)),
    "only a part": (archive("xl/workbook.xml"), {}, ("damaged",)),
    "too much packed": (
        archive("xl/workbook.xml", "xl/x.xml", size=workbook.LARGEST // 2 + 1), {},
        ("too large",),
    ),
    "no list of sheets": (changed(PARTS[0], lambda _: b""), {}, ("damaged",)),
    "no sheet": (changed(SHEET, lambda _: None), {}, ("no sheet",)),
    "a sheet of nonsense": (changed(SHEET, lambda _: b"\xff\0<<<"), {}, ("damaged",)),
    "a sheet without an end": (changed(SHEET, lambda raw: raw[:-300]), {}, ("damaged",)),
    "entities of entities": (changed(SHEET, lambda _: LAUGHS), {}, ("damaged",)),
    "a false number": (
        changed(SHEET, lambda raw: raw.replace(b"</v>", b"x</v>", 1)), {}, ("damaged",),
    ),
    "rows without end": (
        changed(SHEET, lambda raw: raw.replace(b'<row r="9"', b'<row r="99999999999"')), {},
        ("more than", "rows"),
    ),
    "a false size": (
        with_size(with_sheets({"Data": [["a", "b"]]})), {}, ("no row with two numbers",),
    ),
    "nothing": (with_sheets({"Data": []}), {}, ("no row with two numbers",)),
    "words": (with_sheets({"Data": [["a", "b"], ["c", "d"]]}), {}, ("no row with two numbers",)),
    "all sheets are hidden": (
        changed(PARTS[0], lambda raw: raw.replace(b'"visible"', b'"hidden"')), {},
        ("no sheet", "--sheet"),
    ),
    "formulas without values": (with_sheets({"Data": FORMULAS}), {}, ("formulas", "save")),
    "another name of the sheet": (WHOLE, {"sheet": "Dta"}, ("'Dta'", "'Data'")),
    "dates for numbers": (
        with_sheets(
            {"Data": [["t [s]", *HEAD], *([1.0 * i, datetime(2024, 5, 1 + i % 9), 2.0 * i]
                                          for i in range(N))]}
        ),
        {}, ("displacement", "2024-05-01", ".xlsx:2"),
    ),
    "two tables": (
        with_sheets({"Data": [HEAD, *curve(), [], HEAD, ["Probe 2"], HEAD, *curve()]}), {},
        ("two tables", "rows"),
    ),
    "no unit": (with_sheets({"Data": [["Weg", "Kraft"], *curve()]}), {}, ("unit", ".xlsx:1")),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_bad_workbook_is_one_message_with_its_cause(name: str, tmp_path: Path) -> None:
    raw, more, parts = BAD[name]
    path = tmp_path / "curve.xlsx"
    path.write_bytes(raw)
    with pytest.raises(CaseError) as caught:
        read_measured(path, Layout(**more))
    (problem,) = caught.value.problems
    assert "curve.xlsx" in str(problem)
    assert [part for part in parts if part not in str(problem)] == []


def test_formulas_count_by_their_stored_values(tmp_path: Path) -> None:
    def computed(raw: bytes) -> bytes:
        return re.sub(rb'(<c r="B[0-9]+"[^>]*>)<v>', rb"\1<f>A1*2</f><v>", raw)

    (tmp_path / "curve.xlsx").write_bytes(changed(SHEET, computed))
    book = openpyxl.load_workbook(tmp_path / "curve.xlsx")
    assert book["Data"]["B5"].value == "=A1*2"
    assert np.array_equal(read_measured(tmp_path / "curve.xlsx").force, F)


def test_a_missing_reader_of_workbooks_is_told_with_what_installs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    (tmp_path / "curve.xlsx").write_bytes(WHOLE)
    with pytest.raises(LackingError, match="pip install openpyxl"):
        read_measured(tmp_path / "curve.xlsx")


def test_a_sheet_of_a_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "curve.csv").write_text("u_mm,F_N\n0,0\n1,1\n2,2\n")
    with pytest.raises(CaseError, match="no workbook"):
        read_measured(tmp_path / "curve.csv", Layout(sheet="Data"))


def test_a_workbook_is_known_by_its_content(tmp_path: Path) -> None:
    (tmp_path / "curve.csv").write_bytes(WHOLE)
    assert np.array_equal(read_measured(tmp_path / "curve.csv").force, F)
