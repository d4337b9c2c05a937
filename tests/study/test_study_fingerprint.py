"""What makes results old: the case, the files it names, the code that computes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.structure.test_layers import LAYERS
from wovenfab.case import fingerprint as module
from wovenfab.case import read_case
from wovenfab.case.fingerprint import COMPUTING, code, fingerprint, geometry_files
from wovenfab.interface import simulate

ROOT = Path(__file__).parents[2]
BIAS = ROOT / "configs" / "bias-1x3.yaml"


def test_all_layers_that_compute_count() -> None:
    computing = LAYERS[: LAYERS.index("wovenfab.measured") + 1]
    assert {f"wovenfab.{name}" for name in COMPUTING} | {"wovenfab.forms"} == set(computing)


def test_every_value_counts_and_the_way_it_is_written_does_not() -> None:
    case = fingerprint(read_case(BIAS))
    assert fingerprint(read_case(BIAS, ["sheet.width=300 mm"])) == case
    for change in ("sheet.width=0.31 m", "effects.coupling=null", "output.every=9"):
        assert fingerprint(read_case(BIAS, [change])) != case


def test_the_contents_of_named_files_count(tmp_path: Path) -> None:
    (tmp_path / "u.csv").write_text("time_s,displacement_m\n0,0\n1,1e-3\n")
    (tmp_path / "sheet.geo").write_text("// one")
    effect = (ROOT / "docs" / "examples" / "my_effect.py").read_text()
    (tmp_path / "my_effect.py").write_text(effect)
    (tmp_path / "case.yaml").write_text(
        f"from: {BIAS}\n"
        "sheet: {shape: null, length: null, width: null, file: sheet.geo}\n"
        "effects: {my_effect: {file: my_effect.py, stiffness: 1}}\n"
        "program: {type: table, file: u.csv}\n"
    )
    known = set()
    for name in (None, "u.csv", "sheet.geo", "my_effect.py"):
        if name:
            with (tmp_path / name).open("a") as stream:
                stream.write({"u.csv": "2,2e-3\n", "sheet.geo": "// two"}.get(name, "# three"))
        known.add(fingerprint(read_case(tmp_path / "case.yaml")))
    assert len(known) == 4


GEOMETRIES = {
    "Include": ('Include "b.geo";', '// Merge\nMerge "c.msh";'),
    "single quotes": ("Merge 'b.geo';", "ShapeFromFile('c.msh')"),
    "a name in a variable": ('name = "b.geo";\nInclude Str(name);', 'x = "c.msh"; Merge Str(x);'),
    "a computed name": ('Include StrCat("b", ".geo");', 'Merge Sprintf("%s.msh", "c");'),
}


@pytest.mark.parametrize("way", GEOMETRIES)
def test_what_a_geometry_reads_counts_however_deep(way: str, tmp_path: Path) -> None:
    for name, text in zip(("a.geo", "b.geo"), GEOMETRIES[way], strict=True):
        (tmp_path / name).write_text(text)
    (tmp_path / "c.msh").write_text("1")
    (tmp_path / "notes.md").write_text("not read")
    assert [p.name for p in geometry_files(tmp_path / "a.geo")] == ["a.geo", "b.geo", "c.msh"]
    sheet = f"sheet={{file: {tmp_path}/a.geo, fibres: [45 deg, -45 deg]}}"
    case = read_case(BIAS, ["sheet=null", sheet])
    before = fingerprint(case)
    assert fingerprint(case) == before
    (tmp_path / "c.msh").write_text("2")
    assert fingerprint(case) != before


def test_geometries_that_read_each_other_end(tmp_path: Path) -> None:
    (tmp_path / "a.geo").write_text('Include "b.geo"; Include "."; Include "";')
    (tmp_path / "b.geo").write_text('Include "a.geo"; Include "missing.geo";')
    assert [p.name for p in geometry_files(tmp_path / "a.geo")] == ["a.geo", "b.geo"]


def test_the_state_that_a_case_starts_from_counts(tmp_path: Path) -> None:
    small = ("discretisation={degree: 2, mesh_size: 150 mm}", "output.pictures=false")
    elastic = ROOT / "configs" / "elastic-1x3.yaml"
    known = []
    for to in (8, 8, 9):
        ramp = f"program={{type: ramp, to: {to} mm, steps: 2}}"
        simulate(read_case(elastic, [*small, ramp]), tmp_path / "tension", overwrite=True)
        case = read_case(elastic, [*small, f"from_state={tmp_path / 'tension'}"])
        known.append(fingerprint(case))
    assert known[0] == known[1] != known[2]


@pytest.mark.slow
def test_the_code_that_chooses_elements_counts_where_they_are_chosen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plain = read_case(BIAS)
    wanted = plain.changed("discretisation=null", "time=null", "accuracy=1 %")
    before = fingerprint(plain), fingerprint(wanted)
    monkeypatch.setattr(module, "CHOOSING", "study/fit")  # as if it said something else
    assert fingerprint(plain) == before[0] and fingerprint(wanted) != before[1]


@pytest.mark.parametrize(
    ("change", "matters"),
    [
        pytest.param("", False, marks=pytest.mark.slow),
        ('"""Another docstring."""\n# a comment\n', False),
        ("SOMETHING = 1\n", True),
    ],
)
def test_code_counts_and_comments_do_not(change: str, matters: bool, tmp_path: Path) -> None:
    """A copy of the code with a change in one file."""
    for name in ("forms", "wovenfab"):
        for source in (ROOT / name).rglob("*.py"):
            copy = tmp_path / "wovenfab" / source.relative_to(ROOT / name)
            if name == "forms":
                copy = tmp_path / "wovenfab" / source.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_text(source.read_text())
    for name in ("wovenfab/solver/globalisation.py", "wovenfab/report/style.py"):
        source = tmp_path / name
        source.write_text(source.read_text() + (change if "solver" in name else "AND = 2\n"))
    (tmp_path / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text())
    script = "from wovenfab.case.fingerprint import code; print(code())"
    ended = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path, env={"PYTHONPATH": str(tmp_path), "PATH": "/usr/bin"},
        text=True, capture_output=True, check=True,
    )  # fmt: skip
    assert (ended.stdout.strip() != code()) is matters
