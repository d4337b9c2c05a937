"""The log: quiet unless asked for, decisions with -v, iterations with -vv, all of it in a file."""

from __future__ import annotations

import logging
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.test_commands import wovenfab
from wovenfab.case import CaseError
from wovenfab.cli.console import require_log
from wovenfab.parallel import child_environment

ROOT = Path(__file__).parents[2]
#: Locks on the way, so that steps are cut.
HARD = ["program={type: ramp, to: 150 mm, steps: 1}", "discretisation.mesh_size=150 mm"]


def run(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    case = ROOT / "configs" / "bonded-1x3.yaml"
    changes = [word for text in (*HARD, "output.pictures=false") for word in ("--set", text)]
    return wovenfab("run", case, *changes, "-o", "run", "--overwrite", *options, cwd=folder)


@pytest.mark.slow
def test_cut_steps_are_told_with_their_reason_once_each(tmp_path: Path) -> None:
    few = "--set", "solver.max_iterations=4"
    assert "residual" not in run(tmp_path, *few).stderr  # nothing is logged unless asked for
    ended = run(tmp_path, "-v", *few)
    cut = [line for line in ended.stderr.splitlines() if "rejected: DIVERGED_" in line]
    assert cut and all("residual" in line for line in cut)


def test_iterations_are_told_with_vv_and_in_a_file(tmp_path: Path) -> None:
    file = tmp_path / "run.log"
    ended = run(tmp_path, "-vv", "--log", str(file))
    assert "|r|" in ended.stderr
    assert "|r|" in file.read_text() and "DEBUG" in file.read_text()


@pytest.mark.slow
def test_a_file_that_cannot_be_written_is_one_message_before_anything_is_done(
    tmp_path: Path,
) -> None:
    ended = run(tmp_path, "--log", str(tmp_path / "no" / "run.log"))
    assert ended.returncode == 2 and "Traceback" not in ended.stderr
    assert "run.log" in ended.stderr and not (tmp_path / "run").exists()


def test_the_package_has_no_handler_until_one_is_configured() -> None:
    code = "import logging, wovenfab.cli.console; print(logging.getLogger('wovenfab').handlers)"
    ended = subprocess.run(
        [sys.executable, "-c", code], env=child_environment(), capture_output=True, text=True
    )
    assert ended.stdout.strip() == "[]", pytest.fail(ended.stderr)
    assert logging.getLogger("wovenfab").getEffectiveLevel() >= logging.WARNING


CASE = """\
sheet: {length: 0.3 m, width: 0.1 m, fibres: [45 deg, -45 deg]}
effects: {stretch: {stiffness: 100 kN/m}, shear: {stiffness: 50 N/m}}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 1 mm, steps: 1}
discretisation: {degree: 2, mesh_size: 0.1 m}
output: {pictures: false}
"""
ENTRY = "2026-01-02 03:04:05,678 INFO    wovenfab.solver.newton: an earlier run\n"


@pytest.mark.parametrize(
    ("log", "content"),
    [
        ("case.yaml", CASE),
        ("own.py", "EFFECT = 1\n"),
        ("data.csv", "0,1\n"),
        ("notes.log", "2026-01-02 my own notes\n"),
        ("run/history.csv", None),
        ("run/fields/run.log", None),
        ("run/.wovenfab", None),
        ("run/.history.csv.part", None),
        ("run", None),
        ("no/run.log", None),
        (".", None),
    ],
)
def test_a_log_replaces_nothing_but_a_log(log: str, content: str | None, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / log).write_text(content)
    with pytest.raises(CaseError, match="--log: "):
        require_log(tmp_path / log, tmp_path / "run")


def test_a_log_that_is_refused_leaves_all_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text(CASE)
    ended = wovenfab("run", "case.yaml", "-o", "run", "--log", "case.yaml", cwd=tmp_path)
    assert ended.returncode == 2 and "--log: " in ended.stderr
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"case.yaml": CASE}


@pytest.mark.slow
def test_a_log_is_written_only_when_the_run_is_accepted(tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text(CASE)
    (tmp_path / "run.log").write_text(ENTRY)
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "mine.txt").touch()
    for arguments in (("-o", "taken"), ("-o", "run", "--set", "effects.shear.stiffness=x")):
        for log in ("run.log", "new.log"):
            ended = wovenfab("run", "case.yaml", *arguments, "--log", log, cwd=tmp_path)
            assert ended.returncode == 2
    assert (tmp_path / "run.log").read_text() == ENTRY
    assert not (tmp_path / "new.log").exists() and not (tmp_path / "run").exists()
    ended = wovenfab("run", "case.yaml", "-o", "run", "--log", "run.log", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert ENTRY not in (text := (tmp_path / "run.log").read_text()) and "|r|" in text
    inside = ("--overwrite", "--log", "run/run.log")
    for _ in range(2):  # the log of a run may lie in its results
        ended = wovenfab("run", "case.yaml", "-o", "run", *inside, cwd=tmp_path)
        assert ended.returncode == 0, ended.stderr
