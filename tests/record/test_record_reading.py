"""Files of a results directory that are damaged or foreign are refused with file and line."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from wovenfab.record.field_file import (
    CHECKPOINT,
    Checkpoint,
    FieldFile,
    newest_checkpoint,
    triangles,
    write_checkpoint,
)
from wovenfab.record.fields import read_fields
from wovenfab.record.history import ESSENTIAL, HISTORY, read_history
from wovenfab.record.reading import UnreadableResultsError
from wovenfab.record.results import EARLIER_CHECKPOINT, NothingToResumeError
from wovenfab.record.summary import SUMMARY, read_cycles, read_summary

HEAD = ",".join(ESSENTIAL)


def rows(count: int) -> str:
    return "".join(f"{i},{0.5 * i},1,1,1,1,1,1,1\n" for i in range(count))


@pytest.mark.parametrize(
    ("content", "line"),
    [
        ("", 1),
        ("\n", 1),
        ("step,time_s\n0,0\n", 1),
        (f"{HEAD},step\n", 1),
        (f"{HEAD}\n{rows(2)}1,1\n", 4),
        (f"{HEAD}\n{rows(2)}2,1,1,1,1,one,1,1,1\n", 4),
        (f"{HEAD}\n{rows(2)}2,1,1,1,1,nan,1,1,1\n", 4),
        (f"{HEAD}\n{rows(2)}2,0.5,1,1,1,1,1,1,1\n", 4),
        (f"{HEAD}\n{rows(2)}".encode() + b"\xff\n", 4),
        (b"\x89HDF\r\n\x1a\n", 1),
        ("<html>\n<body>\n", 1),
    ],
)
def test_a_history_that_is_no_table_of_a_run_is_refused_with_its_line(
    content: str | bytes, line: int, tmp_path: Path
) -> None:
    data = content if isinstance(content, bytes) else content.encode()
    (tmp_path / HISTORY).write_bytes(data)
    with pytest.raises(UnreadableResultsError) as caught:
        read_history(tmp_path)
    assert f"{HISTORY}:{line}: " in str(caught.value)


def test_a_history_is_read_up_to_its_last_whole_row(tmp_path: Path) -> None:
    (tmp_path / HISTORY).write_text(f"{HEAD}\n{rows(3)}3,1.")
    assert read_history(tmp_path)["step"].tolist() == [0, 1, 2]
    assert read_history(tmp_path, rows=2)["step"].tolist() == [0, 1]
    (tmp_path / HISTORY).write_text(f"{HEAD}\n")
    assert read_history(tmp_path)["step"].shape == (0,)


@pytest.mark.parametrize(
    "content", [b"", b"[]", b"null", b"{", b"\xff", b'{"a": NaN}', b'{"a": 1e999}', b"[" * 9999]
)
def test_a_summary_that_is_no_object_of_finite_numbers_is_refused(
    content: bytes, tmp_path: Path
) -> None:
    assert read_summary(tmp_path) == {}
    (tmp_path / SUMMARY).write_bytes(content)
    with pytest.raises(UnreadableResultsError, match=SUMMARY):
        read_summary(tmp_path)


@pytest.mark.parametrize("content", [b"", b"a,b\n", b"cycle,complete\n1\n", b"\xff"])
def test_a_table_of_cycles_that_is_none_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "cycles.csv").write_bytes(content)
    with pytest.raises(UnreadableResultsError, match=r"cycles\.csv"):
        read_cycles(tmp_path)


def fields(directory: Path, count: int = 2) -> FieldFile:
    mesh, points = triangles(np.array([[0, 1, 2]])), np.array([[0.0, 0], [1, 0], [0, 1]])
    series = FieldFile(directory, "fields", mesh, points, {"f": "1"})
    for step in range(count):
        series.add(step, float(step), {"f": np.full(3, float(step))})
    return series


def changed(where: str, value: object) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            del file[where]
            if value is not None:
                file[where] = value

    return change


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-200])


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("fields.h5", cut),
        ("fields.h5", lambda path: path.write_bytes(b"no HDF5")),
        ("fields.h5", changed("numbers", None)),
        ("fields.h5", changed("times", np.array([0.0, np.nan]))),
        ("fields.h5", changed("times", np.array([1.0, 0.0]))),
        ("fields.h5", changed("numbers", "text")),
        ("fields/mesh.h5", changed("mesh/triangles", np.array([[0, 1, 7]]))),
        ("fields/mesh.h5", changed("mesh/points", np.zeros(3))),
        ("fields/mesh.h5", cut),
        ("fields/000001.h5", changed("f", np.zeros(2))),
        ("fields/000001.h5", changed("f", np.full(3, np.nan))),
        ("fields/000001.h5", changed("f", None)),
        ("fields/000001.h5", changed("f", h5py.SoftLink("/f"))),
        ("fields/000001.h5", cut),
        ("fields/000001.h5", Path.unlink),
        ("fields/mesh.h5", Path.unlink),
    ],
)
def test_fields_that_are_damaged_are_refused_with_their_file(
    name: str, change: Callable[[Path], None], tmp_path: Path
) -> None:
    fields(tmp_path)
    assert read_fields(tmp_path).field("f", 1).tolist() == [1, 1, 1]
    change(tmp_path / name)
    with pytest.raises(UnreadableResultsError, match=Path(name).name):
        read_fields(tmp_path).field("f", 1)


def raw(file: h5py.File, other: Path) -> None:
    file.create_dataset("f", (3,), "f8", external=[(other, 0, h5py.h5f.UNLIMITED)])


def virtual(file: h5py.File, other: Path) -> None:
    layout = h5py.VirtualLayout((3,), "f8")
    layout[:] = h5py.VirtualSource(other, "secret", (3,))
    file.create_virtual_dataset("f", layout)


def linked(file: h5py.File, other: Path) -> None:
    file["f"] = h5py.ExternalLink(other, "secret")


def linked_upwards(file: h5py.File, other: Path) -> None:
    file["f"] = h5py.ExternalLink(f"../../{other.name}", "secret")


@pytest.mark.parametrize("take", [raw, virtual, linked, linked_upwards])
def test_numbers_of_other_files_of_the_machine_are_not_read(
    take: Callable[[h5py.File, Path], None], tmp_path: Path
) -> None:
    """They would go into an export, which is passed on."""
    (tmp_path / "run").mkdir()
    fields(tmp_path / "run")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["secret"] = np.arange(3.0)
    with h5py.File(tmp_path / "run" / "fields" / "000001.h5", "r+") as file:
        unit = file["f"].attrs["unit"]
        del file["f"]
        take(file, tmp_path / "other.h5")
        if take in (raw, virtual):
            file["f"].attrs["unit"] = unit
    with h5py.File(tmp_path / "other.h5", "r+") as file:
        file["secret"].attrs["unit"] = unit
    with pytest.raises(UnreadableResultsError, match="is in a file elsewhere"):
        read_fields(tmp_path / "run").field("f", 1)


def test_a_head_that_claims_more_than_there_is_costs_no_memory(tmp_path: Path) -> None:
    fields(tmp_path)
    with h5py.File(tmp_path / "fields" / "000001.h5", "r+") as file:
        del file["f"]
        file.create_dataset("f", (10**12,), "f8", chunks=(1000,), compression="gzip")
    with pytest.raises(UnreadableResultsError, match="not whole"):
        read_fields(tmp_path).field("f", 1)


def test_times_that_are_not_joined_yet_are_found(tmp_path: Path) -> None:
    joined = tmp_path / "fields.h5"
    series = fields(tmp_path, 100)
    with h5py.File(joined) as file:
        assert len(file["times"]) < 100
    stored = read_fields(tmp_path)
    assert stored.steps.tolist() == list(range(100)) == stored.times.tolist()
    assert stored.field("f", -1).tolist() == [99, 99, 99]
    series.finish()
    with h5py.File(joined) as file:
        assert file["times"][()].tolist() == list(range(100))
        assert file["steps/000099/f"][()].tolist() == [99, 99, 99]


def test_what_is_written_grows_with_the_number_of_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = 0

    def count(path: Path, content: str | bytes) -> None:
        nonlocal written
        if path.name == "fields.h5":
            written += len(content)
        path.write_bytes(content.encode() if isinstance(content, str) else content)

    monkeypatch.setattr("wovenfab.record.field_file.write_whole", count)
    sizes = []
    for times in (400, 800):
        written = 0
        (tmp_path / str(times)).mkdir()
        fields(tmp_path / str(times), times)
        sizes.append(written)
    assert sizes[1] < 2.5 * sizes[0]  # 4 if all times were joined at each


def checkpoint(step: int) -> Checkpoint:
    run = {"parts": [], "outcome": {}, "losses": [], "errors": None}
    values = {"stepper": {}, "case": {}, "chosen": {}, "run": run}
    arrays = {"00": np.arange(6.0).reshape(2, 3), "program": np.zeros((4, 2))}
    return Checkpoint(step, float(step), values, arrays)


def test_a_checkpoint_of_which_one_bit_is_wrong_counts_as_missing(tmp_path: Path) -> None:
    for step in (1, 2):
        write_checkpoint(tmp_path, checkpoint(step))
    assert newest_checkpoint(tmp_path).step == 2
    path = tmp_path / CHECKPOINT
    with h5py.File(path, "r+") as file:
        file["00"][1, 2] = np.nextafter(5.0, 6.0)
    assert newest_checkpoint(tmp_path).step == 1
    shutil.copy(path, tmp_path / EARLIER_CHECKPOINT)
    with pytest.raises(NothingToResumeError, match="damaged"):
        newest_checkpoint(tmp_path)


def test_a_checkpoint_that_lacks_something_counts_as_missing(tmp_path: Path) -> None:
    write_checkpoint(tmp_path, checkpoint(1))
    with h5py.File(tmp_path / CHECKPOINT, "r+") as file:
        state = json.loads(file["state"][()])
        del state["values"]["run"]["losses"], file["state"], file.attrs["digest"]
        file["state"] = json.dumps(state)
    with pytest.raises(NothingToResumeError, match="damaged"):
        newest_checkpoint(tmp_path)


def test_a_file_that_never_ends_is_no_file_of_results(tmp_path: Path) -> None:
    for name, read in ((SUMMARY, read_summary), ("cycles.csv", read_cycles)):
        (tmp_path / name).symlink_to("/dev/zero")
        with pytest.raises(UnreadableResultsError, match=name):
            read(tmp_path)
        (tmp_path / name).unlink()
        os.mkfifo(tmp_path / name)
        with pytest.raises(UnreadableResultsError, match=name):
            read(tmp_path)
