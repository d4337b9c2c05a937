"""Sweeps as a user meets them: side by side, resumed, with failures, interrupted."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli.test_commands import rows, wovenfab
from wovenfab.record.history import read_history
from wovenfab.record.summary import read_summary

CASE = """\
sheet: {length: 0.9 m, width: 0.3 m, fibres: [45 deg, -45 deg]}
effects:
  stretch: {stiffness: 1.27e8 N/m}
  shear: {stiffness: 400 N/m}
  bending: {stiffness: 254.1 N*m}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 10 mm, steps: 2}
discretisation: {degree: 2, mesh_size: 300 mm}
time: {smallest_step: 0.5}
output: {pictures: false}
"""
#: The middle one cannot be done: the sheet is shorter than that.
AMPLITUDES = "program.to=5 mm,-2 m,10 mm"


def sweep(folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    return wovenfab("sweep", "case.yaml", "-o", "out", *arguments, cwd=folder)


def table(folder: Path) -> list[dict[str, str]]:
    return rows(folder / "out", "sweep")


def written(folder: Path) -> dict[str, int]:
    """Return when the history of each member was written."""
    return {p.parent.name: p.stat().st_mtime_ns for p in folder.glob("out/*/history.csv")}


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, str]:
    """Return a folder with a sweep of which one member fails, and what it output."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "case.yaml").write_text(CASE)
    ended = sweep(folder, "--over", AMPLITUDES)
    assert ended.returncode == 3, ended.stderr
    return folder, ended.stdout, ended.stderr


def test_a_failed_member_is_reported_and_the_others_go_on(first: tuple[Path, str, str]) -> None:
    folder, output, errors = first
    assert "to=-2m failed: wovenfab: no equilibrium at t = " in errors
    assert "Traceback" not in errors
    outcomes = [row["outcome"] for row in table(folder)]
    assert [outcome.split(":")[0] for outcome in outcomes] == ["finished", "failed", "finished"]
    assert "3 of 3: " in output
    assert "| to=10mm | finished |" in output


def test_the_table_has_what_was_varied_and_the_figures_of_each_run(
    first: tuple[Path, str, str],
) -> None:
    folder, _, _ = first
    of_runs = table(folder)
    assert [row["program.to"] for row in of_runs] == ["5 mm", "-2 m", "10 mm"]
    for row in (of_runs[0], of_runs[2]):
        summary = read_summary(folder / "out" / row["run"])
        assert float(row["peak_force_N"]) == summary["peak_force_N"]
        assert (
            read_history(folder / "out" / row["run"])["displacement_m"][-1]
            == summary["peak_force_at_m"]
        )
    assert of_runs[1]["peak_force_N"] == ""


def test_all_loops_are_in_one_picture(first: tuple[Path, str, str]) -> None:
    folder, _, _ = first
    assert (folder / "out" / "overlay.png").read_bytes()[1:4] == b"PNG"
    drawn = (folder / "out" / "overlay.svg").read_text()
    assert "to=5 mm" in drawn
    assert "to=-2 m" not in drawn


def test_only_what_changed_or_failed_is_computed_again(first: tuple[Path, str, str]) -> None:
    folder, _, _ = first
    before = written(folder)
    ended = sweep(folder, "--over", "program.to=5 mm,10 mm")
    assert ended.returncode == 0, ended.stderr
    assert "2 of 2 runs were there already" in ended.stdout
    assert written(folder) == before
    (folder / "case.yaml").write_text(CASE.replace("400", "500"))
    ended = sweep(folder, "--over", "program.to=5 mm")
    assert "were there already" not in ended.stdout
    after = written(folder)
    assert {name for name in after if after[name] != before[name]} == {"to=5mm"}


def test_nothing_is_run_if_one_member_is_not_valid(tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text(CASE)
    ended = sweep(tmp_path, "--over", "discretisation.degree=2,7")
    assert ended.returncode == 2
    assert ended.stderr.startswith("wovenfab: --over discretisation.degree: must be at most 5")
    assert [p.name for p in tmp_path.iterdir()] == ["case.yaml"]


def processes(folder: Path) -> list[str]:
    """Return the command lines of processes that have to do with a folder."""
    lines = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            if folder.samefile(path / "cwd"):
                lines.append((path / "cmdline").read_bytes().replace(b"\0", b" ").decode())
        except OSError:
            continue
    return lines


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_sweep_ends_its_processes_and_takes_none_for_finished(
    number: signal.Signals, tmp_path: Path
) -> None:
    long = CASE.replace("to: 10 mm, steps: 2", "to: 10 mm, steps: 400")
    (tmp_path / "case.yaml").write_text(long)
    arguments = ("-j", "1", "--over", "program.steps=1,400")
    command = [sys.executable, "-m", "wovenfab", "sweep", "case.yaml", "-o", "out", *arguments]
    with subprocess.Popen(
        command, cwd=tmp_path, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        history = tmp_path / "out" / "steps=400" / "history.csv"
        until = time.monotonic() + 120
        while time.monotonic() < until and not (history.exists() and history.stat().st_size > 2000):
            time.sleep(0.02)
        assert len(processes(tmp_path)) == 2
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors.startswith("wovenfab: interrupted; to go on, repeat the command")
    assert not processes(tmp_path)
    made = len(read_history(history.parent)["step"])
    assert 0 < made < 401
    again = sweep(tmp_path, *arguments)
    assert again.returncode == 0, again.stderr
    assert list(read_history(history.parent)["step"]) == list(range(401))
    parts = read_summary(history.parent)["parts"]
    assert len(parts) == 2 and parts[1]["first_step"] == made - 1  # it went on where it was
