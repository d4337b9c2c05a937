"""Kernels are what FFCx would write; a compilation that was killed delays nobody for long."""

from __future__ import annotations

import fcntl
import threading
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import ufl
from cffi import VerificationError
from dolfinx import fem
from dolfinx.mesh import GhostMode, create_unit_square
from mpi4py import MPI

from wovenfab.model import assembly


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
    return assembly.assemble_scalar((assembly.compile_form(one * ufl.dx),), mesh.comm)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache of kernels that all ranks share, in which FFCx waits for one second."""
    folder = Path(MPI.COMM_WORLD.bcast(str(tmp_path)))
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    monkeypatch.setattr(assembly, "PATIENCE", 1)
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


@pytest.mark.parametrize("degree", [2, 3])
def test_kernels_of_small_products_add_up_to_what_ffcx_writes(degree: int, tmp_path: Path) -> None:
    on = create_unit_square(MPI.COMM_SELF, 2, 2, ghost_mode=GhostMode.shared_facet)
    space = fem.functionspace(on, ("Lagrange", degree, (4,)))
    w, normal, grad = fem.Function(space), ufl.FacetNormal(on), ufl.grad
    w.x.array[:] = np.random.default_rng(3).standard_normal(w.x.array.size)
    curvature, jump = grad(grad(w)), ufl.jump(grad(w), normal)
    energy = ufl.inner(grad(w), grad(w)) ** 2 * ufl.dx(degree=3)
    energy += ufl.inner(curvature, curvature) * ufl.inner(w, w) * ufl.dx(degree=5)
    energy += ufl.inner(ufl.avg(ufl.div(grad(w))), jump) ** 2 * ufl.dS
    test, trial = ufl.TestFunction(space), ufl.TrialFunction(space)
    tangent = ufl.derivative(ufl.derivative(energy, w, test), w, trial)
    elsewhere = assembly.jit_options() | {"cache_dir": str(tmp_path)}
    forms = (assembly.compile_form(tangent), fem.form(tangent, jit_options=elsewhere))
    ours, expected = (fem.assemble_matrix(form).to_dense() for form in forms)
    assert ours == pytest.approx(expected, abs=1e-13 * np.abs(expected).max())
    written = {path.name: path.stat().st_size for path in tmp_path.glob("*.c")}
    assert written and all(
        (assembly.cache_folder() / name).stat().st_size < size for name, size in written.items()
    )
