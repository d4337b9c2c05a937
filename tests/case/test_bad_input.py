"""What ended in a traceback once: each is refused in words, or works."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

import pytest

from tests.cli.test_commands import CASE
from wovenfab.case import CaseError, read_case

COMMAND = Path(__file__).parents[2] / "env" / "bin" / "wovenfab"
OWN = """\
from wovenfab.forms.effect import Effect, Parameter
from wovenfab.forms.kinematics import shear_angle
EFFECT = Effect(
    name="mine",
    summary="-",
    parameters=(Parameter("k", "N/m", "stiffness"),),
    energy=lambda point, values: values["k"] * shear_angle(point.f, point.fibres) ** -2,
)
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "case.yaml"
    file.write_text(CASE)
    return file


@pytest.mark.parametrize(
    ("title", "message"),
    [
        ("!!bool x", "title: this value cannot be read"),
        ('!!int ""', "title: this number cannot be read"),
        ('"\\U00110000"', "this is not text"),
        ('"\\ud83d"', "title: half a character"),
    ],
)
def test_text_that_is_none_is_refused(title: str, message: str, path: Path) -> None:
    path.write_text(CASE.replace("title: Small test", f"title: {title}"))
    with pytest.raises(CaseError, match=message):
        read_case(path)


def test_characters_that_json_writes_as_two_are_read_as_one(path: Path) -> None:
    path.write_text(CASE.replace("title: Small test", 'title: "\\ud83e\\uddf6"'))
    assert read_case(path).title == "\U0001f9f6"


def test_what_is_not_there_may_be_taken_out(path: Path) -> None:
    for unset in ("effects.coupling=null", "boundary.top=null", "time.tolerance=null"):
        assert read_case(path, [unset]) == read_case(path)


@pytest.mark.parametrize(
    ("shear", "message"),
    [
        ("400 N/m*(1+sqrt((x-5 mm)*(x-10 mm))/1 m)", "has no finite value at x = 0.00"),
        pytest.param(
            "400 N/m*(1-1.5*exp(-((x-0.3507 m)/2 mm)^2))", "must not be negative, but is",
            marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_formulas_are_checked_where_integrals_use_them(
    shear: str, message: str, path: Path
) -> None:
    """The 50 by 50 points of the first check are too coarse for these."""
    from mpi4py import MPI

    from wovenfab.interface import execute

    case = read_case(path, [f"effects.shear.stiffness={shear}", "discretisation.mesh_size=80 mm"])
    with pytest.raises(CaseError, match=message):
        execute(case, path.parent / "results", comm=MPI.COMM_SELF)
    assert not (path.parent / "results").exists()


def test_an_energy_that_is_no_number_at_rest_is_refused(path: Path) -> None:
    from mpi4py import MPI

    from wovenfab.interface import execute

    (path.parent / "own.py").write_text(OWN)
    own = "effects:\n  mine: {file: own.py, k: 1 N/m}"
    path.write_text(CASE.replace("effects:", own))
    with pytest.raises(CaseError, match=r"sheet at rest is not a number: .*mine"):
        execute(read_case(path), path.parent / "results", comm=MPI.COMM_SELF)


@pytest.mark.parametrize(
    "end",
    [
        "> /dev/full",
        pytest.param(">&-", marks=pytest.mark.slow),
        pytest.param("| head -0; test ${PIPESTATUS[0]} = 0", marks=pytest.mark.slow),
    ],
)
def test_output_that_nobody_reads_does_not_end_a_command(end: str, path: Path) -> None:
    script = f"{COMMAND} check {path} {end}"
    ended = subprocess.run(["bash", "-c", script], text=True, capture_output=True, check=False)
    assert ended.returncode == 0 and "Traceback" not in ended.stderr


def test_a_path_that_is_not_utf_8_is_refused(path: Path) -> None:
    name = os.fsencode(path.parent) + b"/\xff.yaml"
    ended = subprocess.run([COMMAND, b"check", name], capture_output=True, check=False)
    assert ended.returncode == 2 and b"is not UTF-8 text" in ended.stderr


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["time.steps_per_cycle=1000000", "program.amplitudes=[%s]"], "has 1e.08 steps; at most"),
        (["discretisation.mesh_size=1 mm"], "unknowns need about .* GB of memory, and there are"),
    ],
)
def test_what_no_machine_can_hold_is_refused_before_it_is_made(
    overrides: list[str], message: str, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mpi4py import MPI

    from wovenfab.case import objects
    from wovenfab.simulation import progress

    monkeypatch.setattr(progress, "memory_of_machine", lambda: 8e9)
    amplitudes = ", ".join(["1 mm"] * 100)
    case = read_case(path, [text.replace("%s", amplitudes) for text in overrides])
    start = time.monotonic()
    with pytest.raises(CaseError, match=message):
        objects.sheet_of(case, MPI.COMM_SELF)
    assert time.monotonic() - start < 5


@pytest.mark.slow
def test_a_run_that_stores_no_fields_has_the_same_history_and_goes_on(path: Path) -> None:
    from mpi4py import MPI

    from wovenfab.interface import execute

    none, some, results = (
        path.parent / "none",
        path.parent / "some",
        ("history.csv", "summary.json"),
    )
    renewed = "solver.factor=renewed"  # one that is kept differs in the last digits
    case = read_case(path, [renewed, "output.fields=[]", "output.pictures=true"])
    execute(case, none, comm=MPI.COMM_SELF, until=0.02)
    execute(case, none, comm=MPI.COMM_SELF, resume=True)
    execute(read_case(path, [renewed]), some, comm=MPI.COMM_SELF)
    assert not list(none.glob("fields*")) and list(some.glob("fields*"))
    assert (none / "history.csv").read_text() == (some / "history.csv").read_text()
    assert all((none / name).is_file() for name in (*results, "loop.png"))
