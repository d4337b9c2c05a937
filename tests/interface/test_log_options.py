"""The log: quiet unless asked for, decisions with -v, iterations with -vv, all of it in a file."""

from __future__ import annotations

import logging
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.test_commands import wovenfab
from wovenfab.parallel import child_environment

ROOT = Path(__file__).parents[2]
#: Locks on the way, so that steps are cut.
HARD = ["program={type: ramp, to: 150 mm, steps: 1}", "discretisation.mesh_size=150 mm"]


def run(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    case = ROOT / "configs" / "elastic-1x3.yaml"
    changes = [word for text in (*HARD, "output.pictures=false") for word in ("--set", text)]
    return wovenfab("run", case, *changes, "-o", "run", "--overwrite", *options, cwd=folder)


def test_nothing_is_logged_unless_asked_for(tmp_path: Path) -> None:
    assert "residual" not in run(tmp_path).stderr


def test_cut_steps_are_told_with_their_reason_once_each(tmp_path: Path) -> None:
    ended = run(tmp_path, "-v", "--set", "solver.max_iterations=4")
    cut = [line for line in ended.stderr.splitlines() if "rejected: DIVERGED_" in line]
    assert cut and all("residual" in line for line in cut)


def test_iterations_are_told_with_vv_and_in_a_file(tmp_path: Path) -> None:
    file = tmp_path / "run.log"
    ended = run(tmp_path, "-vv", "--log", str(file))
    assert "|r|" in ended.stderr
    assert "|r|" in file.read_text() and "DEBUG" in file.read_text()


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
