"""Ctrl-C in a run: one message, the exit code of interruptions, and results up to there."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from petsc4py import PETSc

from tests.cli.test_commands import CASE, rows, wovenfab
from wovenfab.cli.console import INTERRUPTED, was_interrupted


def test_an_interruption_in_a_callback_of_petsc_is_known_as_one() -> None:
    snes = PETSc.SNES().create(PETSc.COMM_SELF)
    vector = PETSc.Vec().createSeq(1)

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    snes.setFunction(interrupted, vector.duplicate())
    with pytest.raises(PETSc.Error) as caught:
        snes.solve(None, vector)
    assert was_interrupted(caught.value)
    assert was_interrupted(KeyboardInterrupt())
    assert not was_interrupted(PETSc.Error(76))
    snes.destroy()


def test_a_run_that_is_interrupted_keeps_its_results_and_says_where(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(CASE.replace("cycle: 8", "cycle: 20000"))
    command = [sys.executable, "-m", "wovenfab", "run", "small.yaml"]
    history = tmp_path / "results" / "small" / "history.csv"
    with subprocess.Popen(command, cwd=tmp_path, text=True, stderr=subprocess.PIPE) as running:
        while running.poll() is None and (not history.exists() or len(rows(history.parent)) < 5):
            time.sleep(0.1)
        running.send_signal(signal.SIGINT)
        _, told = running.communicate()
    assert running.returncode == INTERRUPTED
    assert told == "wovenfab: interrupted; the results so far are in results/small\n"
    assert [int(row["step"]) for row in rows(history.parent)][:5] == [0, 1, 2, 3, 4]
    again = wovenfab("run", "small.yaml", cwd=tmp_path)
    assert again.returncode == 2 and "already holds results" in again.stderr


def test_a_place_that_cannot_be_written_is_bad_input(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(CASE)
    ended = wovenfab("run", "small.yaml", "-o", "/proc/results", cwd=tmp_path)
    assert ended.returncode == 2
    assert ended.stderr.startswith("wovenfab: /proc/results cannot be written (")
    assert ended.stderr.endswith("); choose another directory with -o\n")
