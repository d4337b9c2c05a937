"""Geometries, slivers and PETSc options as a user of the command line meets them."""

from __future__ import annotations

import re
from math import cos, pi, sin
from pathlib import Path

import pytest

from tests.cli.test_commands import CASE, wovenfab
from tests.sheet.test_attacks import MESH
from tests.sheet.test_gmsh_process import PLATE

#: One step of a sheet with one placement.
QUICK = """\
sheet: {{file: {name}, fibres: [45 deg, -45 deg]}}
effects: {{stretch: {{stiffness: 1e5 N/m}}, shear: {{stiffness: 1e3 N/m}}}}
boundary: {{left: clamp, right: {{displacement: [program, 0]}}}}
program: {{type: ramp, to: 1 mm, steps: 1, velocity: 1 mm/s}}
discretisation: {{degree: 2{size}}}
output: {{pictures: false, fields: []}}
"""


def case(folder: Path, name: str, text: str, size: str = ", mesh_size: 100 mm") -> str:
    (folder / name).write_text(text)
    (folder / "case.yaml").write_text(QUICK.format(name=name, size=size))
    return "case.yaml"


def polygon(points: list[tuple[float, float]], groups: str) -> str:
    n = len(points)
    text = "".join(f"Point({i}) = {{{x}, {y}, 0}};\n" for i, (x, y) in enumerate(points, 1))
    text += "".join(f"Line({i}) = {{{i}, {i % n + 1}}};\n" for i in range(1, n + 1))
    return text + f"Curve Loop(1) = {{1:{n}}};\nPlane Surface(1) = {{1}};\n{groups}\n"


@pytest.mark.slow
def test_check_says_what_it_runs_and_where_the_sheet_is_narrow(tmp_path: Path) -> None:
    ended = wovenfab("check", case(tmp_path, "plate.geo", PLATE), cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "runs the geometry program plate.geo" in ended.stdout
    assert "0.3 m wide (0.33 of the size of the sheet), at x = 0.45 m" in ended.stdout
    assert "may fail" not in ended.stdout
    ended = wovenfab("check", case(tmp_path, "sheet.msh", MESH, ""), cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "runs" not in ended.stdout


def test_check_lists_every_curve(tmp_path: Path) -> None:
    turns = [2 * pi * k / 40 for k in range(40)]
    points = [(cos(t), sin(t)) for t in turns]
    groups = 'Physical Surface("s") = {1};'
    ended = wovenfab("check", case(tmp_path, "wheel.geo", polygon(points, groups)), cwd=tmp_path)
    assert ended.returncode == 2
    assert all(f"curve {k} (" in ended.stderr for k in range(1, 41))
    groups += '\nPhysical Curve("left") = {20};\nPhysical Curve("right") = {40};'
    ended = wovenfab("check", case(tmp_path, "wheel.geo", polygon(points, groups)), cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    told = ended.stdout.replace("\n", " ")
    assert all(f"curve {k} (" in told for k in range(1, 40) if k != 20)


@pytest.mark.slow
def test_a_sliver_is_named_before_and_after_the_run_fails(tmp_path: Path) -> None:
    tip = [(0.45 + 5e-7, 0.3), (0.45, 0.5), (0.45 - 5e-7, 0.3)]
    points = [(0.0, 0.0), (0.9, 0.0), (0.9, 0.3), *tip, (0.0, 0.3)]
    groups = 'Physical Surface("s") = {1};\nPhysical Curve("left") = {7};\n'
    text = polygon(points, groups + 'Physical Curve("right") = {2};')
    name = case(tmp_path, "spike.geo", text)
    checked = wovenfab("check", name, cwd=tmp_path)
    assert "narrowest place is 5e-07 m wide" in checked.stdout and "may fail" in checked.stdout
    assert "at x = 0.45 m, y = 0.4 m" in checked.stdout
    run = wovenfab("run", name, "-o", "results", cwd=tmp_path)
    assert run.returncode == 3
    number = r"([\d.e-]+)"
    cell = (
        f"flattest cell, at x = {number} m, y = {number} m, is {number} m long and {number} m high"
    )
    found = re.search(cell, run.stderr)
    assert found is not None, run.stderr
    x, y, _, height = map(float, found.groups())
    assert height < 1e-6  # between the two fibres through the foot of the spike
    assert abs(abs(x - 0.45) - abs(y - 0.3)) < 1e-3
    assert "rounding errors may be the cause" in run.stderr


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        pytest.param(
            "far.geo",
            PLATE.replace("{0.9,", "{1000000000.9,").replace("{0,", "{1e9,"),
            "too rough",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "exit.geo",
            "Exit;\n" + PLATE,
            "ended gmsh before there was a mesh",
            marks=pytest.mark.slow,
        ),
        ("false.msh", 'SystemCall "touch ran";\n', "no mesh of gmsh"),
        pytest.param(
            "false.step", 'SystemCall "touch ran";\n', "Could not read", marks=pytest.mark.slow
        ),
    ],
)
def test_a_file_that_makes_no_sheet_is_one_message(
    name: str, text: str, says: str, tmp_path: Path
) -> None:
    size = "" if name.endswith("msh") else ", mesh_size: 100 mm"
    ended = wovenfab("run", case(tmp_path, name, text, size), "-o", "results", cwd=tmp_path)
    assert ended.returncode == 2
    assert says in ended.stderr and "Traceback" not in ended.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["case.yaml", name])


@pytest.mark.slow
def test_options_that_petsc_never_read_are_told_each(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(
        CASE + "solver: {petsc: {pc_factor_levels: 2, mat_mumps_icntl_14: 50}}\n"
    )
    short = "program={type: ramp, to: 1 mm, steps: 1, velocity: 0.5 m/s}"
    ended = wovenfab(
        "run", "small.yaml", "-o", "results", "--set", short,
        "--", "-snes_montor", "-mat_mumps_icntl_13", "1", "-foo", "3", "-log_vew",
        cwd=tmp_path,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    (told,) = [ln for ln in ended.stdout.splitlines() if "PETSc has not read" in ln]
    assert set(told.split("not read ")[1].split(":")[0].split(", ")) == {
        "pc_factor_levels", "snes_montor", "foo", "log_vew",
    }  # fmt: skip


@pytest.mark.parametrize(
    "options",
    [
        pytest.param("-snes_type qn", marks=pytest.mark.slow),
        "-snes_type ngmres",
        pytest.param("-snes_linesearch_type l2", marks=pytest.mark.slow),
    ],
)
def test_methods_that_do_not_work_are_refused(options: str, tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(CASE)
    ended = wovenfab("run", "small.yaml", "-o", "r", "--", *options.split(), cwd=tmp_path)
    assert ended.returncode == 2 and "does not work here" in ended.stderr
    assert "newtonls does" in ended.stderr or "basic does" in ended.stderr
    assert not (tmp_path / "r").exists()
