import errno
import fcntl
import os
from pathlib import Path

import pytest
from mpi4py import MPI

from wovenfab.model.assembly import _compiled, cache_folder
from wovenfab.record.results import (
    FILES,
    FOLDERS,
    MARKER,
    ResultsDirectory,
    ResultsExistError,
    is_in_use,
    open_results,
    require_free,
    write_whole,
)


def test_a_directory_is_made_with_its_parents_or_taken_if_empty(tmp_path: Path) -> None:
    assert open_results(tmp_path / "results" / "a").is_dir()
    (tmp_path / "empty").mkdir()
    assert open_results(tmp_path / "empty") == tmp_path / "empty"


def test_results_are_refused_a_second_time_with_both_remedies(tmp_path: Path) -> None:
    require_free(tmp_path / "results")
    assert not (tmp_path / "results").exists()
    used = open_results(tmp_path / "results")
    (used / FILES[0]).write_text("old")
    for refusing in (open_results, require_free):
        with pytest.raises(ResultsExistError, match=r"-o.*--overwrite"):
            refusing(used)
    require_free(used, overwrite=True)
    assert (used / FILES[0]).read_text() == "old"


def test_overwriting_removes_our_files_and_keeps_the_users(tmp_path: Path) -> None:
    open_results(tmp_path)
    for name in FILES:
        (tmp_path / name).write_text("old")
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "history.csv").write_text("mine")
    open_results(tmp_path, overwrite=True)
    assert not [name for name in FILES if (tmp_path / name).exists()]
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert (tmp_path / "folder" / "history.csv").read_text() == "mine"


def test_a_directory_that_is_not_ours_is_refused_even_with_overwrite(tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text("mine")
    with pytest.raises(ResultsExistError, match="did not write"):
        open_results(tmp_path, overwrite=True)
    assert (tmp_path / "case.yaml").read_text() == "mine"


def test_overwriting_follows_no_link_out_of_the_directory(tmp_path: Path) -> None:
    outside = tmp_path / "precious.csv"
    outside.write_text("mine")
    directory = open_results(tmp_path / "results")
    (directory / "history.csv").symlink_to(outside)
    open_results(directory, overwrite=True)
    assert outside.read_text() == "mine"


@pytest.mark.parametrize("below", ["", "new"])
def test_what_is_in_the_way_is_named(tmp_path: Path, below: str) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to("nowhere")
    with pytest.raises(ResultsExistError, match="file is a file"):
        open_results(tmp_path / "file" / below)
    with pytest.raises(ResultsExistError, match="is a link to nowhere, which is not there"):
        open_results(tmp_path / "link" / below)


def test_a_failed_write_leaves_the_old_text(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_whole(path, "old")
    with pytest.raises(UnicodeEncodeError):
        write_whole(path, "new \ud800")
    assert path.read_text() == "old"


@pytest.fixture
def no_locks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the system answer as it does on a file system without locks, such as some of Lustre."""

    def flock(*_: object) -> None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

    monkeypatch.setattr(fcntl, "flock", flock)


@pytest.mark.usefixtures("no_locks")
def test_a_file_system_without_locks_takes_results_and_kernels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    directory = ResultsDirectory(tmp_path / "results", MPI.COMM_SELF)
    with directory:
        directory.open()
        assert not is_in_use(directory.path)
    assert "without locks" in caplog.text
    with directory:
        directory.reopen()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert _compiled(lambda: 3) == 3
    waits = iter([TimeoutError, None])  # for a kernel of a process that was killed

    def compiled() -> int:
        if problem := next(waits):
            (cache_folder() / "lib.c").write_text("")
            raise problem
        assert not (cache_folder() / "lib.c").exists()
        return 4

    assert _compiled(compiled) == 4


def test_where_there_are_locks_a_directory_is_in_use(tmp_path: Path) -> None:
    with ResultsDirectory(tmp_path / "results", MPI.COMM_SELF) as directory:
        directory.open()
        assert is_in_use(directory.path)
        with pytest.raises(ResultsExistError, match="another run is writing"):
            ResultsDirectory(directory.path, MPI.COMM_SELF).reopen()
    assert not is_in_use(directory.path)


@pytest.mark.mpi
def test_every_rank_learns_that_results_exist(shared_path: Path) -> None:
    open_results(shared_path / "results")
    with pytest.raises(ResultsExistError):
        open_results(shared_path / "results")
    assert MPI.COMM_WORLD.allreduce(1) == MPI.COMM_WORLD.size


def test_a_file_is_written_whole_beside_links_to_others(tmp_path: Path) -> None:
    outside = tmp_path / "precious.csv"
    outside.write_text("mine")
    for name in ("history.csv", ".history.csv.part"):
        (tmp_path / name).symlink_to(outside)
    write_whole(tmp_path / "history.csv", "ours")
    assert outside.read_text() == "mine"
    assert (tmp_path / "history.csv").read_text() == "ours"
    assert not (tmp_path / "history.csv").is_symlink()


@pytest.mark.parametrize("name", [*FOLDERS, MARKER])
def test_a_run_does_not_go_on_where_a_link_leads_elsewhere(name: str, tmp_path: Path) -> None:
    results, outside = tmp_path / "results", tmp_path / "outside"
    results.mkdir()
    (results / MARKER).touch()
    (results / name).unlink(missing_ok=True)
    (results / name).symlink_to(outside)
    for take in (ResultsDirectory.reopen, lambda directory: directory.open(overwrite=True)):
        with pytest.raises(ResultsExistError):
            take(ResultsDirectory(results, MPI.COMM_SELF))
    assert not outside.exists() and (results / name).is_symlink()
