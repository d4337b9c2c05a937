"""What is missing on a machine is told in one message with its remedy, on one rank and on two."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from wovenfab.lacking import GMSH_LIBRARIES
from wovenfab.mpi import on_ranks
from wovenfab.parallel import child_environment

CASE = """\
sheet: {length: 0.9 m, width: 0.3 m, fibres: [45 deg, -45 deg]}
effects: {stretch: {stiffness: 1.27e8 N/m}, shear: {stiffness: 400 N/m}}
boundary: {left: clamp, right: {displacement: [program, 0]}}
program: {type: ramp, to: 40 mm, steps: 1}
discretisation: {degree: 2, mesh_size: 150 mm}
"""
#: A user without a home folder.
NOBODY = """\
import os, pwd
os.environ.pop("HOME", None)
pwd.getpwuid = lambda user: {}[user]
"""
#: A compiler that finds no header of Python.
NO_HEADERS = """\
#!/bin/sh
for word; do case $word in *.c) file=$word ;; esac; done
if grep -q Python.h "$file"; then
  echo "$file:1:10: fatal error: Python.h: No such file or directory" >&2; exit 1
fi
exec cc "$@"
"""
#: A compiler that takes no form.
NO_FORM = """\
#!/bin/sh
for word; do case $word in *ffcx*.c) echo "$word:7:1: error: expected ';'" >&2; exit 1 ;; esac; done
exec cc "$@"
"""
#: A compiler that cannot link.
NO_LIBRARY = """\
#!/bin/sh
case " $* " in *" -c "*) exec cc "$@" ;; esac
echo "ld: cannot find crt1.o: No such file or directory" >&2; exit 1
"""


def run(
    folder: Path, *arguments: str, ranks: int = 1, **variables: str
) -> subprocess.CompletedProcess[str]:
    """Run the case in a folder with an empty cache of compiled forms."""
    (folder / "case.yaml").write_text(CASE)
    environment = child_environment()
    if ranks > 1:
        environment = {**os.environ, "PYTHONPATH": environment["PYTHONPATH"]}
    if "PYTHONPATH" in variables:
        variables["PYTHONPATH"] += os.pathsep + environment["PYTHONPATH"]
    environment |= {"XDG_CACHE_HOME": str(folder / "cache"), **variables}
    command = [*on_ranks(ranks), sys.executable, "-P", "-m", "wovenfab", "run", "case.yaml"]
    return subprocess.run(
        [*command, *arguments], cwd=folder, env=environment, capture_output=True, text=True,
        timeout=120,
    )  # fmt: skip


def told(ended: subprocess.CompletedProcess[str], folder: Path) -> str:
    """Return the only message of a run that could not begin, which wrote no results."""
    said = [line for line in ended.stderr.splitlines() if line.startswith("wovenfab: ")]
    assert ended.returncode == 2, ended.stderr
    assert len(said) == 1 and "Traceback" not in ended.stderr, ended.stderr
    assert not (folder / "results" / "case" / "history.csv").exists()
    return said[0]


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2])
def test_a_compiler_that_is_not_there(ranks: int, tmp_path: Path) -> None:
    assert "no-such-cc" in told(run(tmp_path, ranks=ranks, CC="no-such-cc"), tmp_path)


def program(folder: Path, script: str) -> str:
    """Return the path of a compiler that is a script."""
    file = folder / "half-cc"
    file.write_text(script)
    file.chmod(0o755)
    return str(file)


@pytest.mark.slow
def test_on_two_ranks_missing_headers_are_told_by_one_message_alone(tmp_path: Path) -> None:
    ended = run(tmp_path, ranks=2, CC=program(tmp_path, NO_HEADERS))
    assert "python3-dev" in told(ended, tmp_path)
    # The compiler's own lines stand in the log; mpirun may add lines of its own to ours.
    assert "fatal error" not in ended.stderr


def test_the_log_keeps_what_a_compiler_without_libraries_wrote(tmp_path: Path) -> None:
    ended = run(tmp_path, "--log", "run.log", CC=program(tmp_path, NO_LIBRARY))
    assert ended.stderr.splitlines() == [told(ended, tmp_path)] and "libc6-dev" in ended.stderr
    assert "ld: cannot find crt1.o" in (tmp_path / "run.log").read_text()


@pytest.mark.slow
def test_a_form_that_does_not_compile_is_told_with_the_compilers_lines(tmp_path: Path) -> None:
    """The compiler has all that it needs, so it is a fault of the program."""
    ended = run(tmp_path, "-v", CC=program(tmp_path, NO_FORM))
    assert ended.returncode == 1
    assert "fault of the program" in ended.stderr
    log, traceback, told = ended.stderr.partition("Traceback")
    assert traceback and all("error: expected ';'" in text for text in (log, told))


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_gmsh_without_a_library_of_the_system(ranks: int, tmp_path: Path) -> None:
    missing = "libGLU.so.1: cannot open shared object file: No such file or directory"
    modules = tmp_path / "modules"
    modules.mkdir()
    (modules / "gmsh.py").write_text(f"raise OSError({missing!r})\n")
    mesh = ("--set", "discretisation.mesh=unstructured")
    said = told(run(tmp_path, *mesh, ranks=ranks, PYTHONPATH=str(modules)), tmp_path)
    assert missing in said and GMSH_LIBRARIES in said


@pytest.mark.slow
def test_a_user_without_a_home_folder_needs_a_cache_folder(tmp_path: Path) -> None:
    modules = tmp_path / "modules"
    modules.mkdir()
    (modules / "sitecustomize.py").write_text(NOBODY)
    said = told(run(tmp_path, PYTHONPATH=str(modules), XDG_CACHE_HOME=""), tmp_path)
    assert "HOME" in said and "XDG_CACHE_HOME" in said
    ended = run(tmp_path, PYTHONPATH=str(modules))
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize(
    "module",
    [
        pytest.param("typer", marks=pytest.mark.slow),
        "ufl",
        pytest.param("mpi4py", marks=pytest.mark.slow),
        "dolfinx",
    ],
)
def test_a_module_that_is_not_installed(module: str, tmp_path: Path) -> None:
    modules = tmp_path / "modules"
    modules.mkdir()
    absent = f"raise ModuleNotFoundError(\"No module named '{module}'\", name='{module}')\n"
    (modules / f"{module}.py").write_text(absent)
    said = told(run(tmp_path, PYTHONPATH=str(modules)), tmp_path)
    assert module in said and "wovenfab[wheels]" in said
