"""MPI is loaded first, started by its own launcher, and ended on all ranks together."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from wovenfab import mpi
from wovenfab.parallel import child_environment

#: Rank 1 fails while rank 0 waits for it, without the variables of any launcher.
FAULT = """\
import os
from wovenfab.cli.app import guarded
from wovenfab.parallel import world

def work():
    comm = world()
    for name in [n for n in os.environ if n.startswith(("OMPI", "PMI", "PRTE"))]:
        del os.environ[name]
    if comm.rank == 1:
        raise RuntimeError("only here")
    comm.barrier()

guarded(work)
"""


def python(code: str, *before: str, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = child_environment()
    if before:
        environment = {**os.environ, "PYTHONPATH": environment["PYTHONPATH"]}
    return subprocess.run(
        [*before, sys.executable, "-P", "-c", code], env=environment | variables,
        capture_output=True, text=True, timeout=30,
    )  # fmt: skip


@pytest.mark.parametrize("module", ["petsc4py", "dolfinx"])
def test_mpi_is_loaded_before_what_needs_its_library(module: str) -> None:
    seen = (
        "class Look:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == '{module}': print('mpi4py.MPI' in sys.modules)\n"
    )
    code = f"import sys\nimport wovenfab\n{seen}sys.meta_path.insert(1, Look())\nimport {module}"
    ended = python(code)
    # PyPI's wheel looks where petsc4py is before it loads MPI; the last look is that of the import
    assert ended.stdout.splitlines()[-1:] == ["True"], ended.stderr


def test_importing_the_package_loads_no_mpi() -> None:
    ended = python("import sys, wovenfab; print('mpi4py' in sys.modules)")
    assert ended.stdout == "False\n"


def test_a_fault_on_one_rank_ends_all() -> None:
    ended = python(FAULT, *mpi.on_ranks(2))
    assert ended.returncode not in (0, 2)
    assert "only here" in ended.stderr


def test_ranks_of_another_launcher_are_refused() -> None:
    """Each of them would take itself for the only one, and write what the others write."""
    code = (
        "import wovenfab\nfrom wovenfab.cli.app import guarded\nfrom wovenfab.parallel import world"
    )
    ended = python(f"{code}\nguarded(world)", PMI_SIZE="3")
    assert ended.returncode == 2
    assert "mpirun" in ended.stderr and "Traceback" not in ended.stderr


def program(path: Path) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_text("#!/bin/sh\n")
    path.chmod(0o755)
    return path


def test_the_launcher_beside_python_comes_before_that_of_the_path(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    beside = program(tmp_path / "environment" / "mpirun")
    elsewhere = program(tmp_path / "elsewhere" / "mpirun")
    monkeypatch.setenv("PATH", str(elsewhere.parent))
    monkeypatch.setattr(sys, "executable", str(tmp_path / "other" / "python3"))
    assert mpi.on_ranks(2) == ["mpirun", "-n", "2"]
    monkeypatch.setattr(sys, "executable", str(beside.with_name("python3")))
    assert mpi.on_ranks(2) == [str(beside), "-n", "2"]
    monkeypatch.setenv("PATH", str(beside.parent))
    assert mpi.on_ranks(2) == ["mpirun", "-n", "2"]
    monkeypatch.setenv("PATH", str(tmp_path))
    beside.unlink()
    assert mpi.mpirun() is None


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("Open MPI v5.0.7, package: Debian OpenMPI, ident: 5.0.7, repo", "Open MPI 5.0.7"),
        ("MPICH Version:      5.0.2\nMPICH Release date: 2026", "MPICH 5.0.2"),
        ("Intel(R) MPI Library 2021.13 for Linux* OS", "Intel(R) MPI Library 2021.13"),
    ],
)
def test_the_name_of_an_mpi(text: str, name: str) -> None:
    class Library:
        Get_library_version = staticmethod(lambda: text)

    assert mpi.version_of(Library) == name


@pytest.mark.parametrize("variable", ["OMPI_COMM_WORLD_RANK", "PMI_RANK"])
def test_on_ranks_lets_rank_0_speak_under_any_launcher(variable: str, tmp_path: Path) -> None:
    script = Path(__file__).parents[2] / "env" / "bin" / "on-ranks"
    launcher = program(tmp_path / "mpirun")
    ranks = f'for rank in 0 1; do {variable}=$rank "$@" || exit 1; done'
    launcher.write_text(f"#!/bin/sh\nshift 2\n{ranks}\n")
    own = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_COMM", "PMI"))}
    ended = subprocess.run(
        [shutil.which("bash") or "bash", script, "2", "echo", "spoken"],
        env=own | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}, capture_output=True, text=True,
    )  # fmt: skip
    assert (ended.stdout, ended.returncode) == ("spoken\n", 0), ended.stderr
