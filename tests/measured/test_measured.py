"""Measured files of many machines, and what is wrong with others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from wovenfab.case import CaseError
from wovenfab.measured.curve import Measured, read_measured
from wovenfab.measured.layout import Layout

ROOT = Path(__file__).parents[2]
PLAIN = "u [mm],F [N]\n0,0\n1.5,2\n2.5,3\n"
#: The same curve as machines and spreadsheets write it.
SAME = {
    "comma": (PLAIN, {}),
    "semicolon and decimal comma": ("Weg (mm);Kraft (N)\n0;0\n1,5;2,0\n2,5;3,0\n", {}),
    "tabs": ("Extension (mm)\tLoad (N)\n0\t0\n1.5\t2\n2.5\t3\n", {}),
    "blanks": ("displacement_mm force_N\n 0  0\n 1.5  2\n 2.5  3\n", {}),
    "quoted decimal comma": ('"u [mm]","F [N]"\n"0,0","0,0"\n"1,5","2,0"\n"2,5","3,0"\n', {}),
    "units below": ("Time;Travel;Force\ns;mm;kN\n0;0;0\n1;1,5;0,002\n2;2,5;0,003\n", {}),
    "lines above": (
        "Machine 7\nDate: 3.4.2020\n\nStroke (m),Load (kN)\n0,0\n.0015,.002\n2.5e-3,3e-3\n",
        {},
    ),
    "byte order mark": ("\ufeff" + PLAIN, {}),
    "Windows": (PLAIN.replace("\n", "\r\n"), {}),
    "no header": (
        "0 0\n1.5 2\n2.5 3\n",
        {"units": {"displacement": "mm", "force": "N"}},
    ),
    "columns by number": (
        "a,b,c\n9,0,0\n9,2,1.5\n9,3,2.5\n",
        {
            "columns": {"displacement": 3, "force": 2},
            "units": {"displacement": "mm", "force": "N"},
        },
    ),
    "columns by name": (
        "load A (N),load B (N),travel (mm)\n0,0,0\n9,2,1.5\n9,3,2.5\n",
        {"columns": {"force": "load B"}},
    ),
}  # fmt: skip


def written(text: str, folder: Path) -> Path:
    path = folder / "curve.csv"
    path.write_bytes(text.encode("utf-8"))
    return path


@pytest.mark.parametrize("name", SAME)
def test_a_curve_is_read_as_machines_write_it(name: str, tmp_path: Path) -> None:
    text, more = SAME[name]
    curve = read_measured(written(text, tmp_path), Layout(**more))
    np.testing.assert_allclose(curve.displacement, [0, 1.5e-3, 2.5e-3], atol=1e-15)
    np.testing.assert_allclose(curve.force, [0, 2, 3], atol=1e-15)


BAD: dict[str, tuple[str, dict[str, Any], str]] = {
    "empty": ("", {}, "the file is empty"),
    "no numbers": ("a,b\nc,d\n", {}, "no row with two numbers"),
    "a word": (PLAIN + "x,4\n", {}, ":5: displacement (column 1) must be a finite number, got 'x'"),
    "nothing": (PLAIN + "4,\n", {}, ":5: force (column 2) must be a finite number, got nothing"),
    "nan": (PLAIN + "4,nan\n", {}, ":5: force (column 2) must be a finite number, got 'nan'"),
    "infinite": (PLAIN + "4,inf\n", {}, ":5: force (column 2) must be a finite number"),
    "short row": (PLAIN + "4\n", {}, ":5: force (column 2) must be a finite number, got nothing"),
    "few rows": ("u (mm),F (N)\n0,0\n1,1\n", {}, "only 2 rows of numbers"),
    "no units": (
        "1,2\n2,3\n3,4\n", {},
        "the header has no unit of the displacement",
    ),
    "wrong unit": (
        "1,2\n2,3\n3,4\n",
        {"units": {"displacement": "kg", "force": "N"}},
        "the unit of the displacement must be a length such as '40 mm', got 'kg'",
    ),
    "unknown unit": (
        "1,2\n2,3\n3,4\n",
        {"units": {"displacement": "parsnip", "force": "N"}},
        "unknown unit 'parsnip'",
    ),
    "unknown column": (PLAIN, {"columns": {"force": "Kraft"}}, "no column 'Kraft' for the force."),
    "column too far": (PLAIN, {"columns": {"force": 3}}, "no column 3 for the force"),
    "column zero": (PLAIN, {"columns": {"force": 0}}, "no column 0 for the force"),
    "two forces": (
        "load A (N),load B (N),travel (mm)\n0,0,0\n9,2,1.5\n9,3,2.5\n", {},
        "more than one column may be the force",
    ),
    "time back": (
        "time (s),travel (mm),load (N)\n0,0,0\n2,1,1\n1,2,2\n", {}, ":4: times must increase",
    ),
    "no travel": ("travel (mm),load (N)\n1,0\n1,1\n1,2\n", {}, "the displacement does not change"),
    "no text": ("PK\x03\x04\0\0", {}, "this is not text"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_is_wrong_is_said_with_file_and_line(name: str, tmp_path: Path) -> None:
    text, more, message = BAD[name]
    with pytest.raises(CaseError) as caught:
        read_measured(written(text, tmp_path), Layout(**more))
    assert "curve.csv" in str(caught.value)
    assert message in str(caught.value)


def test_loading_and_unloading_are_told_apart_in_spite_of_noise() -> None:
    generator = np.random.default_rng(1)
    way = np.concatenate(
        [np.linspace(0, 1, 50), np.linspace(1, 0, 50)[1:], np.linspace(0, 2, 80)[1:]]
    )
    noisy = way + 1e-3 * generator.standard_normal(way.size)
    branches = Measured(Path(), noisy, noisy).branches()
    assert len(branches) == 3
    assert [abs(b[-1] - end) <= 2 for b, end in zip(branches, (49, 98, 177), strict=True)] == [
        True
    ] * 3


def test_the_published_curve_of_the_project_is_read() -> None:
    curve = read_measured(ROOT / "configs" / "lab" / "glass-plain-115x230.csv")
    assert curve.force.size == 43
    assert curve.displacement[-1] == pytest.approx(47.421e-3)
    assert len(curve.branches()) == 1
