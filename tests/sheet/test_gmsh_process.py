"""A geometry is a program: whatever it does to its process becomes a message."""

from __future__ import annotations

import stat
import time
from contextlib import suppress
from pathlib import Path

import pytest

from wovenfab.sheet.errors import GeometryError
from wovenfab.sheet.geometry_file import GeometryFile, read_geometry
from wovenfab.sheet.gmsh_process import Request, meshed

POINTS = "Point(1)={0,0,0}; Point(2)={0.9,0,0}; Point(3)={0.9,0.3,0}; Point(4)={0,0.3,0};\n"
LINES = "Line(1)={1,2}; Line(2)={2,3}; Line(3)={3,4}; Line(4)={4,1};\n"
LOOP = "Curve Loop(1)={1:4}; Plane Surface(1)={1};"
GROUPS = 'Physical Surface("s")={1}; Physical Curve("left")={4}; Physical Curve("right")={2};'
PLATE = POINTS + LINES + LOOP + "\n" + GROUPS


def plate(folder: Path, text: str, name: str = "plate.geo") -> GeometryFile:
    (folder / name).write_text(text)
    return GeometryFile(folder / name)


@pytest.mark.parametrize(
    "text",
    [
        (PLATE + "\n").replace("\n", "\r\n") + "x=1;y=2;",
        *(
            pytest.param(text, marks=pytest.mark.slow)
            for text in (
                PLATE,
                POINTS + LINES + LOOP + GROUPS,
                PLATE + " // the end",
                PLATE.replace("\n", " "),
                POINTS + LINES + "If (1) " + LOOP + GROUPS + " EndIf",
            )
        ),
    ],
)
def test_statements_of_a_last_line_without_an_end_count(text: str, tmp_path: Path) -> None:
    names = {c.name for c in read_geometry(plate(tmp_path, text)).curves}
    assert names == {None, "left", "right"}
    whole = read_geometry(plate(tmp_path, text + "\n"))
    assert {c.name for c in whole.curves} == names


def test_an_included_geometry_without_a_last_line_end_counts(tmp_path: Path) -> None:
    plate(tmp_path, POINTS + LINES + LOOP, "part.geo")
    file = plate(tmp_path, f'Include "part.geo";\n{GROUPS}')
    assert {c.name for c in read_geometry(file).curves} == {None, "left", "right"}


def test_what_cannot_run_in_a_last_line_without_an_end_says_so(tmp_path: Path) -> None:
    plate(tmp_path, LINES + LOOP + "\n", "part.geo")
    with pytest.raises(GeometryError, match="last line has no line end"):
        read_geometry(plate(tmp_path, POINTS + 'x = 1; Include "part.geo"; ' + GROUPS))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("Exit;\n", "ended gmsh before there was a mesh"),
        ("Error('by hand');\n", "by hand"),
        ('SystemCall "kill -SEGV $PPID";\nSleep 5;\n', "by SIGSEGV"),
        ('SystemCall "kill -9 $PPID";\nSleep 5;\n', "by SIGKILL"),
        ('Include "nowhere.geo";\n', "nowhere.geo"),
    ],
)
def test_the_death_of_a_geometry_is_a_message(text: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(GeometryError, match=f"plate.geo: .*{says}"):
        read_geometry(plate(tmp_path, text + PLATE + "\n"))


def test_a_loop_without_an_end_is_ended_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr("tempfile.tempdir", None)
    text = 'NonBlockingSystemCall "sleep 300 & echo $! > pid; wait";\n' + POINTS
    file = plate(tmp_path, text + "For i In {1:2}\n  i = 1;\nEndFor\n" + LINES)
    monkeypatch.chdir(tmp_path)
    started = time.monotonic()
    with pytest.raises(GeometryError, match=r"ended after 3 s: .*loop without an end"):
        read_geometry(file, seconds=3)
    assert time.monotonic() - started < 60
    assert list((tmp_path / "tmp").iterdir()) == []
    if (pid := tmp_path / "pid").exists():  # else gmsh had not come to it
        assert not is_alive(int(pid.read_text()))


def is_alive(number: int) -> bool:
    """Return whether a process goes on within a second; one that nobody waits for does not."""
    for _ in range(20):
        with suppress(OSError):
            if "\nState:\tZ" in Path(f"/proc/{number}/status").read_text():
                return False
        if not Path(f"/proc/{number}").exists():
            return False
        time.sleep(0.05)
    return True


def test_a_mesh_without_an_end_is_ended(tmp_path: Path) -> None:
    text = PLATE + "\nMesh.MeshSizeMax = 1e-7;\n"
    (tmp_path / "plate.geo").write_text(text)
    request = Request(str(tmp_path / "plate.geo"), memory=800_000_000)
    with pytest.raises(GeometryError, match="too many cells"):
        meshed(request, seconds=20)


@pytest.mark.parametrize(
    ("error", "says"),
    [
        ("OSError('libGL.so.1: cannot open shared object file')", "libGL.so.1.*apt-get install"),
        ("ModuleNotFoundError('No module named gmsh', name='gmsh')", "pip install gmsh"),
    ],
)
def test_gmsh_that_cannot_be_loaded_is_named_with_what_to_install(
    error: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gmsh.py").write_text(f"raise {error}\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(GeometryError, match=says):
        read_geometry(plate(tmp_path, PLATE))


def test_a_geometry_in_a_folder_with_odd_names_is_read(tmp_path: Path) -> None:
    folder = tmp_path / "o'dd $(touch ran) ; é"
    folder.mkdir()
    plate(folder, LINES + LOOP + "\n", "part.geo")
    file = plate(folder, POINTS + f'Include "part.geo";\n{GROUPS}', "pla te;.geo")
    assert len(read_geometry(file).curves) == 4


def test_a_folder_that_cannot_be_written_stays_as_it_is(tmp_path: Path) -> None:
    file = plate(tmp_path, PLATE)
    before = sorted(tmp_path.iterdir())
    tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    try:
        assert len(read_geometry(file).curves) == 4
    finally:
        tmp_path.chmod(stat.S_IRWXU)
    assert sorted(tmp_path.iterdir()) == before
