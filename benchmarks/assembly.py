"""What assembling the tangent takes beside the plain way and beside its arithmetic."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import basix
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI

from benchmarks.figure import Figure
from benchmarks.probe import CASE
from wovenfab.case import read_case
from wovenfab.case.objects import model_of, sheet_of
from wovenfab.forms.kinematics import displacements
from wovenfab.model import kernels
from wovenfab.model.assembly import assemble_matrix, create_matrix, jit_options
from wovenfab.model.kernels import own_kernels
from wovenfab.model.model import Model

SIZE = "discretisation.mesh_size=25mm"
REPEATS = 7
#: Measures of one family in a cell (f, g, placement) and on a facet (f, g on two sides).
IN_CELL, ON_FACET = 3, 4


def assembly() -> list[Figure]:
    """Measure tangents at degree 3: ours, without jumps, and differentiated plainly.

    Also the kernel in the cells as FFCx writes it.
    """
    ours, smooth = _model(SIZE), _model(SIZE, "discretisation.jumps=false")
    start = time.perf_counter()
    plain = fem.form(plain_tangent(ours))
    compiled = time.perf_counter() - start
    print(f"plain form: {compiled:.0f} s to compile (nothing if it has been before)")
    matrix = create_matrix(ours.jacobian, upper=True)
    large = fem_petsc.create_matrix(plain)
    smooth_matrix = create_matrix(smooth.jacobian, upper=True)
    # One after the other in turns, since machines change their speed.
    here, there, without = _fastest(
        partial(assemble_matrix, matrix, ours.jacobian),
        partial(_assemble_plain, large, plain),
        partial(assemble_matrix, smooth_matrix, smooth.jacobian),
    )
    operations = _multiplications(ours)
    print(
        f"{ours.unknowns} unknowns: {1e3 * here:.0f} ms, plain {1e3 * there:.0f} ms; "
        f"{operations / 1e6:.0f} million multiply-adds would do, "
        f"which is {operations / here / 1e9:.2f} billion a second"
    )
    print(f"entries: {_entries(matrix):.3g} in half a matrix, plain {_entries(large):.3g}")
    for item in (matrix, large, smooth_matrix):
        item.destroy()
    return [
        Figure(
            "assembly over the plain double-differentiated energy",
            here / there,
            0.5,
            "x",
            f"fastest of {REPEATS}, {1e3 * here:.0f} over {1e3 * there:.0f} ms, degree 3, "
            f"{ours.unknowns} unknowns, same mesh and quadrature, plain with dolfinx's defaults",
        ),
        Figure(
            "assembly with jumps over that without",
            here / without,
            1.25,
            "x",
            f"{ours.unknowns} and {smooth.unknowns} unknowns with the same kernels, so that "
            "there is nothing more to compile",
        ),
        *_kernel_over_ffcx(ours),
        _whole_lanes(_model(SIZE, "discretisation.degree=4")),
    ]


def _tangent_in_cells(model: Model) -> Any:
    arguments = ufl.TrialFunction(model.space), ufl.TestFunction(model.space)
    return model.balance.jacobian(*arguments, model.last)


def _whole_lanes(model: Model) -> Figure:
    """Compare rows of a kernel's matrices that are filled up with zeros with those that are not."""
    tangent = _tangent_in_cells(model)
    filled, _ = _compiled(tangent, own_kernels())
    with patch.object(kernels, "LANES", 1):
        short, _ = _compiled(tangent, own_kernels())
    here, there = _fastest(
        partial(fem.assemble_matrix, filled), partial(fem.assemble_matrix, short)
    )
    meaning = f"fastest of {REPEATS}, {1e3 * here:.0f} over {1e3 * there:.0f} ms, degree 4"
    return Figure("rows of kernels filled up to lanes, over short ones", here / there, 0.95, "x",
                  meaning)  # fmt: skip


def _kernel_over_ffcx(model: Model) -> list[Figure]:
    """Compare the tangent's kernel in the cells with the one that FFCx alone writes."""
    tangent = _tangent_in_cells(model)
    (ours, compiled), (theirs, usual) = (
        _compiled(tangent, way) for way in (own_kernels(), nullcontext())
    )
    here, there = _fastest(partial(fem.assemble_matrix, ours), partial(fem.assemble_matrix, theirs))
    return [
        Figure(
            "kernel over FFCx's, compiled",
            compiled / usual,
            0.5,
            "x",
            f"{compiled:.1f} over {usual:.1f} s, tangent in the cells, degree 3, the same flags",
        ),
        Figure(
            "kernel over FFCx's, assembled",
            here / there,
            0.7,
            "x",
            f"fastest of {REPEATS}, {1e3 * here:.0f} over {1e3 * there:.0f} ms with a new matrix",
        ),
    ]


def _compiled(form: Any, way: AbstractContextManager[None]) -> tuple[fem.Form, float]:
    """Return a form and the time (s) that writing and compiling it took."""
    with TemporaryDirectory() as folder, way:
        start = time.perf_counter()
        compiled = fem.form(form, jit_options=jit_options() | {"cache_dir": folder})
        return compiled, time.perf_counter() - start


def _model(*overrides: str) -> Model:
    case = read_case(CASE, overrides)
    return model_of(case, sheet_of(case, MPI.COMM_SELF))


def plain_tangent(model: Model) -> Any:
    """Return the potential differentiated twice by the field.

    It is integrated over all facets, as one form on the space of both placements.
    """
    balance = replace(model.balance, facets=(ufl.dS, ufl.dS))
    field, space = model.field, model.space
    energy = balance.potential()
    for family, u in enumerate(displacements(field)):
        for line in balance.lines(family, u):
            energy += line.potential()
    test, trial = ufl.TestFunction(space), ufl.TrialFunction(space)
    return ufl.derivative(ufl.derivative(energy, field, test), field, trial)


def _assemble_plain(matrix: Any, form: fem.Form) -> None:
    matrix.zeroEntries()
    fem_petsc.assemble_matrix(matrix, form)
    matrix.assemble()


def _fastest(*works: Callable[[], None]) -> list[float]:
    """Return the shortest time (s) of each work, which take turns."""
    best = [float("inf")] * len(works)
    for _ in range(REPEATS):
        for i, work in enumerate(works):
            start = time.perf_counter()
            work()
            best[i] = min(best[i], time.perf_counter() - start)
    return best


def _multiplications(model: Model) -> float:
    """Return the multiply-adds that contracted tables would need, counted by hand.

    At a point each pair of components of the families (4 x 4; on a facet 2 x 2) multiplies
    the matrix of second derivatives by the measures of all nodes, and these by the result.
    """
    mesh, degree = model.sheet.mesh, model.balance.degree
    nodes = (degree + 1) * (degree + 2) // 2
    points = len(basix.make_quadrature(basix.CellType.triangle, model.balance.quadrature)[1])
    on_line = len(basix.make_quadrature(basix.CellType.interval, model.balance.quadrature)[1])
    cell = 16 * points * (IN_CELL**2 * nodes + IN_CELL * nodes**2)
    facet = 4 * on_line * (ON_FACET**2 * nodes + ON_FACET * (2 * nodes) ** 2)
    cells = mesh.topology.index_map(2).size_local
    crossed = sum(len(m.subdomain_data().indices) for m in model.balance.facets)
    return float(cells * cell + crossed * facet)


def _entries(matrix: Any) -> float:
    return float(matrix.getInfo()["nz_used"])
