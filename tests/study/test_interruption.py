"""Signals end fits and sweeps whenever they come, and what is done stays."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from signal import SIGINT
from time import sleep

import pytest

from tests.study.test_fit import TRUTH, curve_of, place
from wovenfab.study.fit.fit_file import read_fit
from wovenfab.study.fit.objective import Objective
from wovenfab.study.runner import Command, Ended, execute_all, here


def test_a_signal_that_comes_with_the_last_result_is_heeded() -> None:
    command = Command(["-c", "print('{}')"], 1)
    ends: list[int] = []

    def on_end(index: int, ended: Ended) -> None:
        ends.append(index)
        if len(ends) == 2:
            os.kill(os.getpid(), SIGINT)

    with pytest.raises(KeyboardInterrupt):
        execute_all([command, command], here(1), on_end)
    assert ends == [0, 1]


# The exception that is lost is what the test is about.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_fit_ends_by_a_signal_whose_exception_is_lost(tmp_path: Path) -> None:
    """Python prints one in a destructor, and goes on."""
    fit = read_fit(place(tmp_path, curve=curve_of(tmp_path)))

    class Careless:
        def __del__(self) -> None:
            os.kill(os.getpid(), SIGINT)
            sum(range(10))  # Python calls the handler between its instructions

    with pytest.raises(KeyboardInterrupt), Objective(fit, tmp_path / "runs") as objective:
        Careless()
        objective.attempt(TRUTH, 1.0)
    assert not objective.trials


@pytest.mark.slow
def test_an_interrupted_fit_goes_on_with_the_runs_that_it_has(tmp_path: Path) -> None:
    place(tmp_path, curve=curve_of(tmp_path))
    command = [sys.executable, "-m", "wovenfab", "fit", str(tmp_path / "fit.yaml")]
    command += ["-o", str(tmp_path / "out")]
    runs = tmp_path / "out" / "runs"
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as fit:
        while fit.poll() is None and (not runs.exists() or not list(runs.glob("*.json"))):
            sleep(0.01)
        fit.send_signal(SIGINT)
        _, errors = fit.communicate(timeout=60)
    assert fit.returncode == 130 and "to go on, repeat the command" in errors
    done = {path: path.stat().st_mtime_ns for path in runs.glob("*.json")}
    subprocess.run(command, capture_output=True, check=True)
    assert {path: path.stat().st_mtime_ns for path in done} == done
    assert len(list(runs.glob("*.json"))) > len(done)
    result = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert result["converged"]
