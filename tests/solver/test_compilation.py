"""Kernels are what FFCx would write; a compilation that was killed delays nobody for long."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import ufl
from cffi import VerificationError
from dolfinx import fem
from dolfinx.mesh import GhostMode, create_unit_square
from mpi4py import MPI

from wovenfab.forms.kinematics import along, twice_along
from wovenfab.model import assembly, kernels


def leave_unfinished(cache: Path) -> None:
    """Leave the kernels in a cache as a killed process does: begun, not marked as ready."""
    marks = list(cache.rglob("*.c.cached"))
    assert marks
    for mark in marks:
        mark.unlink()


def area() -> float:
    """Return the area of a unit square, by a form and by an expression, compiled anew."""
    mesh = create_unit_square(MPI.COMM_WORLD, 2, 2)
    one = fem.Constant(mesh, 1.0)
    cells = mesh.topology.index_map(2).size_local
    values = assembly.compile_expression(one + one, np.array([[0.3, 0.3]])).eval(
        mesh, np.arange(cells, dtype=np.int32)
    )
    assert (values == 2.0).all()
    return assembly.assemble_scalar({"": assembly.compile_form(one * ufl.dx)}, mesh.comm)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache of kernels that all ranks share, in which FFCx waits for one second."""
    folder = Path(MPI.COMM_WORLD.bcast(str(tmp_path)))
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    options = assembly.jit_options
    monkeypatch.setattr(assembly, "jit_options", lambda: options() | {"timeout": 1})
    return folder


def test_ranks_share_different_kernels_by_their_work() -> None:
    """Equal kernels are compiled once: FFCx makes the second rank wait in steps of a second."""
    mesh = create_unit_square(MPI.COMM_SELF, 2, 2)
    space = fem.functionspace(mesh, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    fields = [fem.Function(space) for _ in "12"]
    line = [u("+") * v("-") * f("+") * ufl.dS for f in fields]
    inside, load, area = u * v * ufl.dx, v * ufl.dx, fields[0] * ufl.dx
    first, second = assembly._shares([load, inside, *line, area], 2)
    assert first == [line[1]]
    assert second == [inside, load, area]


@pytest.mark.mpi
def test_kernels_that_a_killed_process_left_are_compiled_anew(cache: Path) -> None:
    assert area() == pytest.approx(1.0)
    MPI.COMM_WORLD.Barrier()
    if MPI.COMM_WORLD.rank == 0:
        leave_unfinished(cache)
    MPI.COMM_WORLD.Barrier()
    assert area() == pytest.approx(1.0)


def test_kernels_left_while_another_process_compiles_are_compiled_anew(cache: Path) -> None:
    area()
    leave_unfinished(cache)
    with (assembly.cache_folder() / "users.lock").open("w") as other:
        fcntl.flock(other, fcntl.LOCK_SH)
        ends = threading.Timer(2.5, fcntl.flock, (other, fcntl.LOCK_UN))
        ends.start()
        assert area() == pytest.approx(1.0)
        assert not ends.is_alive()


def test_a_compiler_that_a_signal_ended_is_started_once_more(cache: Path) -> None:
    ended = VerificationError("CompileError: command 'gcc' failed with exit code -15")
    compiler = Mock(side_effect=[ended, "kernel", ended, ended])
    assert assembly._compiled(compiler) == "kernel"
    with pytest.raises(VerificationError):
        assembly._compiled(compiler)


def test_a_form_that_does_not_compile_is_told_with_the_compilers_lines(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command, said = cache / "cc", "form.c:7:1: error: expected ';'"
    command.write_text(
        f'#!/bin/sh\ncase "$*" in *ffcx*) echo "{said}" >&2; exit 1 ;; esac\ncc "$@"'
    )
    command.chmod(0o755)
    monkeypatch.setenv("CC", str(command))
    monkeypatch.setattr(assembly, "logger", log := Mock())
    with pytest.raises(VerificationError) as told:
        area()
    assert told.value.__notes__ == [said]
    assert log.info.call_args.args[-1] == said


@pytest.mark.usefixtures("own_kernels")
def test_equal_expressions_have_one_kernel(cache: Path) -> None:
    mesh = create_unit_square(MPI.COMM_WORLD, 1, 1)
    for value in (1.0, 2.0):
        both = [ufl.variable(fem.Constant(mesh, value)) for _ in "12"]
        slope = ufl.diff(both[0] ** 3 * both[1], both[0])
        compiled = assembly.compile_expression(slope, np.array([[0.3, 0.3]]))
        assert compiled.eval(mesh, np.array([0], dtype=np.int32)) == pytest.approx(3 * value**3)
    assert len(list(cache.rglob("*.c.cached"))) == 1


def square(degree: int, *shape: int) -> tuple[Any, fem.Function, Any, Any]:
    """Return a mesh and a random field of a shape with a test and a trial function."""
    on = create_unit_square(MPI.COMM_SELF, 2, 2, ghost_mode=GhostMode.shared_facet)
    space = fem.functionspace(on, ("Lagrange", degree, shape))
    w = fem.Function(space)
    w.x.array[:] = np.random.default_rng(3).standard_normal(w.x.array.size)
    return on, w, ufl.TestFunction(space), ufl.TrialFunction(space)


def compare(form: Any, elsewhere: Path, shorter: bool = True) -> None:
    """Test that a kernel is that of FFCx, and shorter, unless that is not asked."""
    options = assembly.jit_options() | {"cache_dir": str(elsewhere)}
    both = (assembly.compile_form(form), fem.form(form, jit_options=options))
    if len(form.arguments()) == 2:
        ours, expected = (fem.assemble_matrix(compiled).to_dense() for compiled in both)
    else:
        ours, expected = (fem.assemble_vector(compiled).array for compiled in both)
    assert ours == pytest.approx(expected, abs=1e-13 * np.abs(expected).max())
    written = {path.name: path.stat().st_size for path in elsewhere.glob("*.c")}
    here = assembly.cache_folder()
    for name, size in written.items():
        assert (here / name).stat().st_size < size or not shorter
    assert written


@pytest.mark.usefixtures("own_kernels")
@pytest.mark.parametrize("degree", [1, *(pytest.param(d, marks=pytest.mark.slow) for d in (2, 3))])
def test_kernels_of_small_products_add_up_to_what_ffcx_writes(degree: int, tmp_path: Path) -> None:
    on, w, test, trial = square(degree, 2)
    normal, grad = ufl.FacetNormal(on), ufl.grad
    curvature, jump = grad(grad(w)), ufl.jump(grad(w), normal)
    energy = ufl.inner(grad(w), grad(w)) ** 2 * ufl.dx(degree=3)
    energy += ufl.inner(curvature, curvature) * ufl.inner(w, w) * ufl.dx(degree=5)
    energy += ufl.inner(ufl.avg(ufl.div(grad(w))), jump) ** 2 * ufl.dS
    assert kernels.directions_of(energy) == ()
    compare(ufl.derivative(ufl.derivative(energy, w, test), w, trial), tmp_path)


@pytest.mark.usefixtures("own_kernels")
@pytest.mark.parametrize("degree", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_kernels_of_derivatives_along_two_directions_are_those_of_ffcx(
    degree: int, tmp_path: Path
) -> None:
    on, w, test, trial = square(degree)
    one, two = (fem.Constant(on, direction) for direction in ((0.8, 0.6), (-0.3, 1.1)))
    f, g, mixed = along(one, w), along(two, w), w
    if degree > 1:
        g, mixed = twice_along(two, w), along(one, along(two, w))
    jump = ufl.jump(g) + ufl.avg(f)
    energy = (f**2 * g + mixed**2 * w) * ufl.dx(degree=5) + jump**3 * ufl.dS
    energy += (f + g) ** 3 * ufl.dot(one, ufl.FacetNormal(on)) * ufl.ds
    force = ufl.derivative(energy, w, test)
    assert kernels.directions_of(force) == (() if degree == 1 else (one, two))
    compare(force, tmp_path, degree > 1)
    compare(ufl.derivative(force, w, trial), tmp_path, degree > 1)


def test_derivatives_along_varying_or_three_directions_are_left_to_ffcx() -> None:
    on, w, *_ = square(2)
    one, two, three = (fem.Constant(on, d) for d in ((1.0, 0.0), (0.0, 1.0), (0.6, 0.8)))
    assert kernels.directions_of(along(one, w) * along(two, w) * ufl.dx) == (one, two)
    x = ufl.SpatialCoordinate(on)
    for other in (along(three, w), along(x, w), along(one, w * x[0]), ufl.grad(w)[0]):
        energy = along(one, w) * along(two, w) * other * ufl.dx
        assert kernels.directions_of(energy) == ()


@pytest.mark.parametrize(
    "text", ['{"table_atol": 0.9, "cffi_libraries": ["none-such"], "other": 1}', "no JSON", "[1]"]
)
def test_files_of_options_are_not_read(text: str, tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "ffcx", tmp_path / "dolfinx"):
        folder.mkdir(exist_ok=True)
        for name in ("ffcx_options.json", "dolfinx_jit_options.json"):
            (folder / name).write_text(text)
    code = (
        "from wovenfab.model import assembly; import ffcx, dolfinx.jit\n"
        "def compile_it():\n"
        "    print(ffcx.get_options()['table_atol'])\n"
        "    print(dolfinx.jit.get_options()['cffi_libraries'])\n"
        "assembly._compiled(compile_it)"
    )
    ended = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=tmp_path,
        env=os.environ | {"XDG_CONFIG_HOME": str(tmp_path)}, capture_output=True, text=True,
    )  # fmt: skip
    assert ended.stdout.split() == ["1e-09", "None"], ended.stderr
