"""Ctrl-C in a run: one message, the exit code of interruptions, and results up to there."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from petsc4py import PETSc

from tests.cli.test_commands import CASE, rows, wovenfab
from wovenfab.simulation.progress import signal_behind


def test_an_interruption_in_a_callback_of_petsc_is_known_as_one() -> None:
    snes = PETSc.SNES().create(PETSc.COMM_SELF)
    vector = PETSc.Vec().createSeq(1)

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    snes.setFunction(interrupted, vector.duplicate())
    with pytest.raises(PETSc.Error) as caught:
        snes.solve(None, vector)
    assert signal_behind(caught.value)
    assert signal_behind(KeyboardInterrupt())
    assert not signal_behind(PETSc.Error(76))
    snes.destroy()


def signalled(number: signal.Signals, folder: Path, *options: str) -> tuple[Path, int, str]:
    """Start a long run, send it a signal after some steps; return results, exit code and errors."""
    (folder / "small.yaml").write_text(CASE.replace("cycle: 8", "cycle: 20000"))
    command = [sys.executable, "-m", "wovenfab", "run", "small.yaml", *options]
    results = folder / "results" / "small"
    history = results / "history.csv"
    with subprocess.Popen(command, cwd=folder, text=True, stderr=subprocess.PIPE) as running:
        while running.poll() is None and (not history.exists() or len(rows(results)) < 5):
            time.sleep(0.1)
        running.send_signal(number)
        _, told = running.communicate(timeout=15 if options else 10)
    return results, running.returncode, told


@pytest.mark.parametrize(
    "number",
    [
        signal.SIGTERM,
        *(
            pytest.param(number, marks=pytest.mark.slow)
            for number in (signal.SIGINT, signal.SIGUSR1, signal.SIGHUP)
        ),
    ],
)
def test_a_signal_ends_a_run_after_its_step_and_it_can_go_on(
    number: signal.Signals, tmp_path: Path
) -> None:
    results, code, told = signalled(number, tmp_path)
    last = rows(results)[-1]["step"]
    assert code == 128 + number
    assert told.startswith(f"wovenfab: {number.name} after step {last}; ") and told.count("\n") == 1
    assert "'wovenfab resume results/small' goes on" in told
    assert [int(row["step"]) for row in rows(results)] == list(range(int(last) + 1))
    again = wovenfab("run", "small.yaml", cwd=tmp_path)
    assert again.returncode == 2 and "did not come to its end" in again.stderr
    until = f"{float(rows(results)[-1]['time_s']) * 1.2} s"
    further = wovenfab("resume", "results/small", "--until", until, cwd=tmp_path)
    assert further.returncode == 0, further.stderr
    assert [int(row["step"]) for row in rows(results)] == list(range(len(rows(results))))
    assert len(rows(results)) > int(last) + 1


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_a_run_on_two_ranks_lets_both_end_their_step(
    number: signal.Signals, tmp_path: Path
) -> None:
    results, code, told = signalled(number, tmp_path, "--ranks", "2")
    last = rows(results)[-1]["step"]
    assert code == 128 + number
    assert f"wovenfab: SIGUSR1 after step {last}; 'wovenfab resume results/small' goes on" in told
    assert json.loads((results / "summary.json").read_text())["ranks"] == 2
    until = f"{float(rows(results)[-1]['time_s']) * 1.2} s"
    further = wovenfab("resume", "results/small", "--until", until, cwd=tmp_path)
    assert further.returncode == 0, further.stderr
    assert [int(row["step"]) for row in rows(results)] == list(range(len(rows(results))))


def test_what_mpirun_does_not_pass_on_any_more_is_printed_to_the_terminal() -> None:
    # Ctrl-C reaches mpirun, too, which ends soon after: the last word of a run would be lost.
    word = "from wovenfab.cli.console import Console; Console().problem('goes on', %s)"
    in_terminal = sys.executable, "-c", "import pty, sys; pty.spawn(sys.argv[1:])"
    for ends, told in ((True, "wovenfab: goes on"), (False, "")):
        command = f'{sys.executable} -c "{word % ends}" 2>/dev/null'
        ended = subprocess.run(
            [*in_terminal, "sh", "-c", command], capture_output=True, text=True, check=True
        )
        assert ended.stdout.strip() == told


@pytest.mark.slow
def test_a_place_that_cannot_be_written_is_bad_input(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(CASE)
    ended = wovenfab("run", "small.yaml", "-o", "/proc/results", cwd=tmp_path)
    assert ended.returncode == 2
    assert ended.stderr.startswith("wovenfab: /proc/results cannot be written (")
    assert ended.stderr.endswith("); choose another directory with -o\n")
