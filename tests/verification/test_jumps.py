"""Placements that may jump across special fibres: where, on which shapes, on all ranks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from tests import scenes
from tests.outlines import SHAPES, Angles, aligned, tee, with_hole
from tests.verification.test_few_unknowns import SAMPLES
from wovenfab.model.model import Numerics
from wovenfab.model.spaces import placements_on
from wovenfab.sheet.fibre_mesh import across
from wovenfab.sheet.sheet import Outline

#: Its yarns run at 45 degrees.
SHEET = SAMPLES["1:3"]


def test_a_placement_jumps_on_its_own_special_fibres_and_nowhere_else() -> None:
    on = SHEET.sheet(0.1)
    model = scenes.model(on, scenes.COUPLED, Numerics(3))
    scenes.force(model, scenes.PULL, 0.02)
    values, positions = model.field.x.array.reshape(-1, 2), np.round(model.placements.positions, 7)
    gaps = []
    for family in (0, 1):
        blocks = np.unique(model.placements.blocks[:, :, family])
        places, copy, counts = np.unique(
            positions[blocks], axis=0, return_inverse=True, return_counts=True
        )
        ends = on.jumps[family][:, 0]
        away = np.abs((places[:, None] - ends) @ across(on.fibres[family])).min(axis=1)
        assert np.array_equal(counts, np.where(away < 1e-6, 2, 1))
        copies = (values[blocks[copy == place]] for place in np.flatnonzero(counts == 2))
        gaps.append(max(np.linalg.norm(one - other) for one, other in copies))
    print(f"largest jumps: {gaps[0]:.2e} m and {gaps[1]:.2e} m")
    assert min(gaps) > 2e-4  # of the order of the slip, about a millimetre


@pytest.mark.parametrize("angles", [(45, -45), (30, -60), (0, 90)], ids=str)
@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES.keys())
def test_cells_that_share_a_value_share_yarns(shape: Outline, angles: Angles) -> None:
    """They are joined through edges of cells: none touch at a corner or a hole alone."""
    on = aligned(shape, angles, 0.1)
    placements = placements_on(on.mesh, 2, 2, on.jumps)
    assert np.array_equal(np.unique(placements.blocks), np.arange(len(placements.positions)))
    topology = on.mesh.topology
    topology.create_connectivity(1, 2)
    facets = topology.connectivity(1, 2)
    pairs = [p for f in range(topology.index_map(1).size_local) if len(p := facets.links(f)) == 2]
    for blocks in np.moveaxis(placements.blocks, 2, 0):
        shared = [len(np.intersect1d(blocks[one], blocks[other])) for one, other in pairs]
        one, other = np.array(pairs)[np.array(shared) == 3].T
        joined = sparse.csr_array((np.ones(len(one)), (one, other)), (len(blocks), len(blocks)))
        for block in np.unique(blocks):
            cells = np.flatnonzero((blocks == block).any(axis=1))
            assert connected_components(joined[cells][:, cells], directed=False)[0] == 1


@pytest.mark.parametrize(
    ("shape", "angles"),
    [
        (with_hole(), (45, -45)),
        pytest.param(tee(), (45, -45), marks=pytest.mark.slow),
        pytest.param(tee(), (30, -60), marks=pytest.mark.slow),
    ],
)
def test_notched_and_pierced_sheets_converge(shape: Outline, angles: Angles) -> None:
    sheets = (aligned(shape, angles, mesh_size) for mesh_size in (0.1, 0.05))
    (_, coarse), (_, fine) = (SHEET.pull(scenes.COUPLED, 0.02, 4, on) for on in sheets)
    assert coarse == pytest.approx(fine, rel=5e-4)


def test_without_lines_the_space_is_the_usual_one() -> None:
    on = SHEET.sheet(0.15)
    bare = replace(on, jumps=(np.zeros((0, 2, 2)), np.zeros((0, 2, 2))))
    free, tied = (scenes.model(s, scenes.COUPLED, Numerics(2)) for s in (on, bare))
    assert tied.placements.doubled == 0
    assert free.unknowns == tied.unknowns + 2 * free.placements.doubled
    bonded = scenes.model(on, scenes.BONDED, Numerics(2))
    assert 2 * bonded.unknowns == tied.unknowns


@pytest.mark.mpi
@pytest.mark.mpi4
@pytest.mark.parametrize(
    "shape",
    [
        with_hole(),
        pytest.param(SHAPES["rectangle"], marks=pytest.mark.slow),
        pytest.param(tee(), marks=pytest.mark.slow),
    ],
)
def test_jumps_are_the_same_on_all_ranks(shape: Outline) -> None:
    results = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        model = scenes.model(aligned(shape, (45, -45), 0.1, comm), scenes.COUPLED, Numerics(3))
        results.append((model.unknowns, model.placements.doubled, scenes.pull(model, 0.02)))
    assert results[0][:2] == results[1][:2]
    assert results[0][2] == pytest.approx(results[1][2], rel=1e-8)
