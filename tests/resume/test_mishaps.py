"""What happens to a run: kills, torn files, a full disk, a clock that is set back, two at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import wovenfab
from tests.resume.test_resume import ALONE, assert_same, run, small
from wovenfab.parallel import child_environment
from wovenfab.record.field_file import FieldFile, triangles
from wovenfab.record.fields import read_fields
from wovenfab.record.results import CHECKPOINT, ResultsExistError, open_results
from wovenfab.simulation.progress import Interruption


@pytest.mark.slow
def test_what_was_written_after_the_checkpoint_is_made_again(tmp_path: Path) -> None:
    """As after a kill: history and fields are ahead of the last checkpoint."""
    case = small("bias-1x3", "output.checkpoint=7", "output.every=1")
    whole = run(case, tmp_path / "whole")
    run(case, tmp_path / "killed", until=0.06)
    history = (tmp_path / "killed" / "history.csv").read_text()
    (tmp_path / "killed" / CHECKPOINT).unlink()
    (tmp_path / "killed" / "history.csv").write_text(history[:-20])
    (tmp_path / "killed" / "summary.json").unlink()
    assert_same(run(case, tmp_path / "killed", resume=True), whole, 0.0)


@pytest.mark.slow
def test_a_checkpoint_that_is_not_whole_is_passed_over(tmp_path: Path) -> None:
    case = small("bias-1x3", "output.checkpoint=7")
    whole = run(case, tmp_path / "whole")
    run(case, tmp_path / "hurt", until=0.06)
    newest = tmp_path / "hurt" / CHECKPOINT
    newest.write_bytes(newest.read_bytes()[:1000])
    assert_same(run(case, tmp_path / "hurt", resume=True), whole, 0.0)


def test_two_runs_do_not_write_into_one_directory(tmp_path: Path) -> None:
    from wovenfab.record.results import ResultsDirectory

    place = tmp_path / "run"
    with ResultsDirectory(place, ALONE) as mine:
        mine.open()
        (place / "history.csv").write_text("mine")
        with pytest.raises(ResultsExistError, match="another run is writing"):
            open_results(place, overwrite=True)
        assert (place / "history.csv").read_text() == "mine"
    open_results(place, overwrite=True)
    assert not (place / "history.csv").exists()


def test_a_full_disk_leaves_the_series_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import wovenfab.record.results as results

    points = np.random.default_rng(0).uniform(size=(3, 2))
    mesh = triangles(np.array([[0, 1, 2]]))
    series = FieldFile(tmp_path, "fields", mesh, points, {"f": "1"})
    series.add(0, 0.0, {"f": np.zeros(3)})
    text = (tmp_path / "fields.xdmf").read_text()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(results.os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        series.add(1, 1.0, {"f": np.ones(3)})
    monkeypatch.undo()
    assert (tmp_path / "fields.xdmf").read_text() == text
    assert list(read_fields(tmp_path).times) == [0.0]
    assert not list(tmp_path.rglob(".*part"))


#: A run whose files cannot grow beyond some bytes, as if the disk were full.
LIMITED = """
import resource, signal, sys
from mpi4py import MPI
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, 2 * (int(sys.argv[1]),))
sys.argv = ["wovenfab", *sys.argv[2:]]
from wovenfab.cli.app import main
main()
"""


def limited(room: int, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", LIMITED, str(room), *map(str, arguments)]
    return subprocess.run(command, env=child_environment(), capture_output=True, text=True)


@pytest.mark.slow
@pytest.mark.parametrize(("room", "code"), [(1500, 2), (50_000, 4)])
def test_a_run_whose_disk_is_full_goes_on_once_there_is_room(
    tmp_path: Path, room: int, code: int
) -> None:
    """Without room for the smallest files it is refused, otherwise it ends with a message."""
    case, place = small("bias-1x3", "output.every=1", "output.checkpoint=3"), tmp_path / "parts"
    whole = run(case, tmp_path / "whole")
    run(case, place, until=0.02)
    before = {name: (place / name).read_bytes() for name in (CHECKPOINT, "fields.h5")}
    ended = limited(room, "resume", place)
    assert ended.returncode == code
    assert "cannot be written: File too large" in ended.stderr
    assert "Traceback" not in ended.stderr
    assert before == {name: (place / name).read_bytes() for name in before}
    assert_same(run(case, place, resume=True), whole, 0.0)


def test_a_run_whose_disk_is_full_before_its_first_checkpoint_says_that_there_is_none(
    tmp_path: Path,
) -> None:
    path, place = tmp_path / "case.yaml", tmp_path / "out"
    path.write_text(small("bias-1x3", "output.every=1", "output.checkpoint=false").to_yaml())
    ended = limited(50_000, "run", path, "-o", place)
    assert ended.returncode == 4
    assert "there was no checkpoint yet" in ended.stderr
    assert "resume" not in ended.stderr and "Traceback" not in ended.stderr
    read = wovenfab.read_results(place)
    assert not read.finished and "killed or going on" in repr(read)
    assert np.isfinite(read.history["force"]).all()


@pytest.mark.slow
def test_a_clock_that_is_set_back_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = small("bias-1x3", "output.checkpoint=1 ms")
    whole = run(case, tmp_path / "whole")
    hours = iter(range(10**9, 0, -3600))
    monkeypatch.setattr(time, "time", lambda: float(next(hours)))
    run(case, tmp_path / "parts", until=0.02)
    os.utime(tmp_path / "parts" / CHECKPOINT, (0, 0))
    assert_same(run(case, tmp_path / "parts", resume=True), whole, 0.0)


def test_a_signal_that_comes_twice_at_once_is_one() -> None:
    """A batch system sends it to all processes, and a launcher passes it on."""
    with Interruption() as interruption:
        interruption.begin_steps()
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGUSR1)
        assert interruption.asked(ALONE) == signal.SIGUSR1
