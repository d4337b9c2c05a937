"""What differs between versions of dolfinx acts alike: make test and make test-next run this."""

from __future__ import annotations

import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import exterior_facet_indices
from mpi4py import MPI

from wovenfab import compat
from wovenfab.case import read_case
from wovenfab.case.objects import sheet_of
from wovenfab.record.history import read_history
from wovenfab.sheet.gmsh_io import graded_rectangle

CASE = Path(__file__).parent / "case.yaml"
WORLD = MPI.COMM_WORLD
on_ranks = pytest.mark.parametrize(
    "ranks", [pytest.param(1), pytest.param(2, marks=pytest.mark.mpi)]
)


@on_ranks
def test_a_gmsh_mesh_has_its_named_edge_and_both_cells_of_each_facet(ranks: int) -> None:
    mesh, facets, names = graded_rectangle(WORLD, 1.0, 1.0, 0.2, None)
    left = ufl.ds(domain=mesh, subdomain_data=facets, subdomain_id=names["left"])
    length = fem.assemble_scalar(fem.form(fem.Constant(mesh, 1.0) * left))
    assert WORLD.allreduce(length) == pytest.approx(1)
    mesh.topology.create_connectivity(1, 2)
    own = mesh.topology.index_map(1).size_local
    cells = np.diff(mesh.topology.connectivity(1, 2).offsets)[:own]
    assert np.flatnonzero(cells == 1).tolist() == exterior_facet_indices(mesh.topology).tolist()


@on_ranks
def test_an_index_map_numbers_over_the_ranks(ranks: int) -> None:
    other = (WORLD.rank + 1) % WORLD.size
    ghosts = np.array([3 * other] if WORLD.size > 1 else [], dtype=np.int64)
    owners = np.full(len(ghosts), other, dtype=np.int32)
    numbers = compat.index_map_of(WORLD, 3, ghosts, owners)
    assert numbers.size_global == 3 * WORLD.size
    mine = np.arange(3 + len(ghosts), dtype=np.int32)
    own = range(3 * WORLD.rank, 3 * WORLD.rank + 3)
    assert numbers.local_to_global(mine).tolist() == [*own, *ghosts]


@on_ranks
def test_the_columns_of_a_pattern_reach_all_that_cells_couple(ranks: int) -> None:
    mesh, _, _ = graded_rectangle(WORLD, 1.0, 1.0, 0.2, None)
    space = fem.functionspace(mesh, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    pattern = fem.create_sparsity_pattern(fem.form(u * v * ufl.dx))
    pattern.finalize()
    entries, offsets = pattern.graph
    numbers = compat.column_map(pattern)
    own, mine = space.dofmap.index_map, space.dofmap.index_map.size_local
    columns = numbers.local_to_global(np.asarray(entries[: offsets[mine]]))
    rows = np.repeat(np.arange(mine) + own.local_range[0], np.diff(offsets)[:mine])
    parts = WORLD.allgather(set(zip(rows.tolist(), columns.tolist(), strict=True)))
    pairs = set().union(*parts)
    assert pairs == {(column, row) for row, column in pairs}
    cells = [own.local_to_global(np.asarray(cell)).tolist() for cell in space.dofmap.list]
    local = {(a, b) for cell in cells for a in cell for b in cell}
    assert pairs == set().union(*WORLD.allgather(local))


@on_ranks
def test_a_space_takes_a_dof_map_of_ones_own(ranks: int) -> None:
    mesh, _, _ = graded_rectangle(WORLD, 1.0, 1.0, 0.2, None)
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    usual = fem.functionspace(mesh, element)
    numbers, cells = usual.dofmap.index_map, np.ascontiguousarray(usual.dofmap.list)
    own = compat.space_with(mesh, element, numbers, cells)
    one, other = fem.Function(own), fem.Function(usual)
    for field in (one, other):
        field.interpolate(lambda x: np.array([x[0], x[0] * x[1]]))
    assert np.array_equal(one.x.array, other.x.array)
    assert own.value_shape == (2,)
    area = fem.assemble_scalar(fem.form(one[0] * ufl.dx))
    assert WORLD.allreduce(area) == pytest.approx(1 / 2)


def columns(directory: Path) -> dict[str, np.ndarray]:
    """Return the values of a history by unit: all columns of one share their scale."""
    units = defaultdict(list)
    for name, values in read_history(directory).items():
        units[name.rpartition("_")[2]].append(values)
    return {unit: np.array(values) for unit, values in units.items()}


def test_the_history_of_a_case_is_that_of_dolfinx_0_9(tmp_path: Path) -> None:
    """To 1e-8 of the largest force, energy and so on."""
    sheet = sheet_of(read_case(CASE), MPI.COMM_SELF)
    assert all(len(lines) for lines in sheet.jumps)
    run = [sys.executable, "-m", "wovenfab", "run", CASE, "-o", tmp_path / "run"]
    subprocess.run(run, check=True, capture_output=True)
    stored, now = columns(CASE.parent), columns(tmp_path / "run")
    assert now.keys() == stored.keys() >= {"N", "J", "m", "s", "iterations"}
    for unit, values in stored.items():
        assert now[unit] == pytest.approx(values, rel=0, abs=1e-8 * np.abs(values).max()), unit
