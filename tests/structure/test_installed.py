"""The installed package: one version, all of its data, and every command works from elsewhere."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from wovenfab.parallel import child_environment

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
CASE = """\
sheet: {length: 0.9 m, width: 0.3 m, fibres: [45 deg, -45 deg]}
effects: {stretch: {stiffness: 1.27e8 N/m}, shear: {stiffness: 400 N/m}}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 40 mm, steps: 2}
discretisation: {degree: 2, mesh_size: 150 mm}
"""
#: A tiny use of each command; what one writes, a later one may read.
USES = {
    "schema": ["--effects"],
    "check": ["case.yaml"],
    "run": ["case.yaml"],
    "report": ["results/case"],
    "export": ["results/case", "--last"],
    "resume": ["results/case", "--set", "program.steps=4", "--set", "output.pictures=false"],
    "sweep": ["case.yaml", "--over", "program.to=10 mm,20 mm", "--set", "output.pictures=false"],
    "effects": ["case.yaml", "--set", "output.pictures=false"],
    "sensitivities": ["case.yaml", "--by", "shear.stiffness"],
    "measured": ["curve.csv"],
    "fit": ["fit.yaml"],
    "accuracy": ["case.yaml", "--levels", "1"],
}
FIT = """\
tests: [{case: case.yaml, measured: curve.csv}]
parameters: {shear.stiffness: }
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built without network from a copy of the project."""
    folder = tmp_path_factory.mktemp("wheel")
    left = (".*", "results", "build", "dist", "docs", "*.egg-info", "__pycache__")
    shutil.copytree(ROOT, folder / "project", ignore=shutil.ignore_patterns(*left))
    pip("wheel", "--no-build-isolation", "--wheel-dir", folder, folder / "project")
    (built,) = folder.glob("*.whl")
    return built


def pip(command: str, *arguments: str | Path) -> None:
    subprocess.run(
        [sys.executable, "-m", "pip", command, "--quiet", "--no-deps", "--no-index", *arguments],
        check=True,
    )


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with nothing but the installed wheel in it."""
    folder = tmp_path_factory.mktemp("installed")
    pip("install", "--root-user-action=ignore", "--target", folder, wheel)
    return folder


def wovenfab(installed: Path, folder: Path, *arguments: str) -> str:
    """Return what the installed command prints; it must succeed."""
    run = subprocess.run(
        [sys.executable, installed / "bin" / "wovenfab", *arguments],
        env={**os.environ, "PYTHONPATH": str(installed), "COLUMNS": "100", "NO_COLOR": "1"},
        cwd=folder, capture_output=True, text=True,
    )  # fmt: skip
    assert run.returncode == 0, f"{arguments}\n{run.stdout}\n{run.stderr}"
    return run.stdout


def test_the_wheel_has_the_package_with_its_data_and_nothing_else(wheel: Path) -> None:
    names = [Path(name) for name in zipfile.ZipFile(wheel).namelist()]
    tops = {name.parts[0] for name in names}
    assert tops == {"wovenfab", f"wovenfab-{VERSION}.dist-info"}
    package = {name for name in names if name.parts[0] == "wovenfab"}
    places = ((ROOT, ROOT / "wovenfab"), (ROOT / "forms", ROOT / "forms"))
    assert package == {
        ("wovenfab/forms" if base.name == "forms" else Path()) / p.relative_to(base)
        for base, top in places
        for p in top.rglob("*")
        if p.is_file() and p.suffix != ".pyc"
    }


def test_every_command_works_from_another_folder(installed: Path, tmp_path: Path) -> None:
    commands = re.search(r"Commands (.*)", wovenfab(installed, tmp_path, "--help"), re.S)
    assert commands, "no commands in the help"
    assert set(re.findall(r"^│ (\S+) ", commands[1], re.M)) == USES.keys()
    (tmp_path / "case.yaml").write_text(CASE)
    (tmp_path / "fit.yaml").write_text(FIT)
    (tmp_path / "curve.csv").write_text("u_mm,F_N\n10,9\n20,19\n40,60\n")
    for command, arguments in USES.items():
        wovenfab(installed, tmp_path, command, *arguments)
    assert (tmp_path / "results" / "case" / "report.html").is_file()
    assert (tmp_path / "results" / "case" / "open_in_paraview.py").is_file()


def test_the_version_is_stated_once_and_the_same_installed_or_not(
    installed: Path, tmp_path: Path
) -> None:
    for place in (installed, ROOT):
        line = [sys.executable, "-m", "wovenfab", "--version"]
        settings = {**os.environ, "PYTHONPATH": str(place)}
        run = subprocess.run(line, env=settings, cwd=tmp_path, capture_output=True, text=True)
        assert run.stdout.splitlines()[0] == f"wovenfab {VERSION}"
    others = [ROOT / name for name in ("Dockerfile", "wovenfab/__init__.py")]
    assert [path.name for path in others if VERSION in path.read_text()] == []


def test_the_version_is_told_with_those_of_what_computes() -> None:
    line = [sys.executable, "-P", "-m", "wovenfab", "--version"]
    told = subprocess.run(line, env=child_environment(), capture_output=True, text=True).stdout
    names = (
        rf"wovenfab {VERSION}",
        r"dolfinx \d+\.\d+\.\d+",
        r"PETSc \d+\.\d+ .*",
        r"MPI: \w+.* \d\S*",
    )
    for line_, name in zip(told.splitlines(), names, strict=False):
        assert re.match(name, line_), told


def test_the_changelog_and_the_citation_are_of_this_version() -> None:
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    stated, date = (
        re.findall(rf"^{key}: (\S+)$", citation, re.M) for key in ("version", "date-released")
    )
    assert stated == [VERSION] and len(date) == 1
    assert f"## [{VERSION}] - {date[0]}\n" in changelog
