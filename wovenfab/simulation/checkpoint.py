"""Checkpoints of a simulation: when they are written, and how a run goes on from one.

Values at nodes and points are stored cell by cell, in the order of the mesh as it was made, so
that neither the partition nor doubled nodes need numbers of their own.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.compat import corners_of
from wovenfab.model.memory import PointValues
from wovenfab.model.model import Model
from wovenfab.parallel import agree, compute_on_root, from_root, on_root
from wovenfab.plain_text import in_brief
from wovenfab.record.field_file import PROGRAM, Checkpoint, newest_checkpoint, write_checkpoint
from wovenfab.record.fields import Blocks
from wovenfab.record.results import NothingToResumeError
from wovenfab.sheet.sheet import Sheet
from wovenfab.sheet.tolerance import SAME_PLACE
from wovenfab.stepping.program import Program
from wovenfab.stepping.step import Step

if TYPE_CHECKING:
    from wovenfab.simulation.simulation import Simulation

logger = logging.getLogger(__name__)
Array = NDArray[np.float64]
#: Keys that stand for arrays in the tree of plain values.
ARRAY, POINTS = "array", "points"
#: Array of the mesh: corners of each cell (m), then tags of the edges opposite to them; shape
#: (cells, 9). And key of the tags by edge.
MESH, EDGES = "mesh", "edges"


class SnapshotFormat:
    """Turns snapshots of a model into plain values and arrays by cell, and back."""

    def __init__(self, model: Model) -> None:
        """Exchange the numbers of the cells; collective."""
        mesh = model.sheet.mesh
        own = mesh.topology.index_map(2).size_local
        self._comm, self._cells = mesh.comm, model.sheet.original_cells
        self._blocks = Blocks(mesh.comm, self._cells[:own])
        self._placements, self._own = model.placements, own
        self._work = fem.Function(model.space)

    def gather(self, snapshot: Any) -> tuple[Any, dict[str, Array]]:
        """Return plain values and, on rank 0, the arrays of all cells by name; collective."""
        arrays: dict[str, Array] = {}
        return self._gathered(snapshot, arrays), arrays

    def scatter(self, values: Any, arrays: Mapping[str, Array]) -> Any:
        """Return the snapshot of this rank; collective.

        ``values`` are plain and the same on all ranks, ``arrays`` those of all cells, on rank 0.
        """
        if isinstance(values, list):
            return [self.scatter(value, arrays) for value in values]
        if not isinstance(values, dict):
            return values
        if values.keys() == {ARRAY}:
            return self._placements.from_cells(self._rows(values[ARRAY], arrays))
        if values.keys() == {POINTS}:
            parts = [self._rows(name, arrays)[: self._own] for name in values[POINTS]]
            return PointValues(tuple(parts))
        return {name: self.scatter(value, arrays) for name, value in values.items()}

    def _gathered(self, item: Any, arrays: dict[str, Array]) -> Any:
        if isinstance(item, np.ndarray):
            return {ARRAY: self._stored(self._by_cell(item), arrays)}
        if isinstance(item, PointValues):
            return {POINTS: [self._stored(part, arrays) for part in item.parts]}
        if isinstance(item, Mapping):
            return {name: self._gathered(value, arrays) for name, value in item.items()}
        if isinstance(item, list | tuple):
            return [self._gathered(value, arrays) for value in item]
        return item.item() if isinstance(item, np.generic) else item

    def _stored(self, rows: Array, arrays: dict[str, Array]) -> str:
        """Gather rows, one a cell, under the next name, which is returned."""
        name = f"{len(arrays):02d}"
        everything = self._blocks.gather(rows)
        arrays[name] = np.empty(0) if everything is None else everything
        return name

    def _by_cell(self, values: Array) -> Array:
        """Return the values at each own cell's nodes; ghosts may be left out of ``values``."""
        self._work.x.array[: values.size] = values
        if values.size < self._work.x.array.size:
            self._work.x.scatter_forward()
        nodes = self._placements.blocks[: self._own]
        rows: Array = self._work.x.array.reshape(-1, 2)[nodes].reshape(self._own, -1)
        return rows

    def _rows(self, name: str, arrays: Mapping[str, Array]) -> Array:
        """Return the rows of this rank's cells, ghosts included; collective.

        Raises:
            ValueError: There are no such rows, or of another number of cells; on every rank.
        """

        def shape_of() -> tuple[int, ...]:
            if name not in arrays or len(arrays[name]) != self._blocks.total:
                raise ValueError(f"{name} has not one row a cell")
            return arrays[name].shape

        shape = compute_on_root(self._comm, shape_of)
        is_first = self._comm.rank == 0
        received = np.array(arrays[name], dtype=np.float64) if is_first else np.empty(shape)
        self._comm.Bcast([received, MPI.DOUBLE])
        return np.asarray(received[self._cells])


class Checkpoints:
    """Writes checkpoints of a run: every so often, and when asked; called after each step."""

    def __init__(
        self,
        simulation: Simulation,
        directory: Path,
        more: Callable[[], Mapping[str, Any]],
        sync: Callable[[], None],
    ) -> None:
        """Write nothing yet; collective.

        ``more`` returns plain values to be kept besides; ``sync`` puts the rows of the history on
        the disk, and is called on rank 0.
        """
        self._simulation, self._directory = simulation, directory
        self._more, self._sync = more, sync
        self._every = simulation.output.checkpoint
        self._format = SnapshotFormat(simulation.model)
        program = simulation.program
        self._program = values_at(program, [m.time for m in program.milestones])
        self._mesh, self._edges = (
            mesh_of_cells(simulation.model.sheet),
            simulation.model.sheet.edges,
        )
        self._steps, self._clock = 0, time.monotonic()

    def __call__(self, step: Step) -> None:
        """Write one if its turn has come; collective."""
        self._steps += 1
        if self._every is False:
            return
        if isinstance(self._every, int):
            due = self._steps >= self._every
        else:
            due = bool(self._simulation.comm.bcast(time.monotonic() - self._clock >= self._every))
        if due:
            self.write()

    def write(self) -> None:
        """Write one of the last accepted state, unless that was done; collective."""
        if self._every is False or not self._steps:
            return
        stepper = self._simulation.stepper
        values, arrays = self._format.gather(stepper.snapshot())
        arrays[PROGRAM] = self._program[:, self._program[0] <= stepper.time]
        if self._mesh is not None:
            arrays[MESH] = self._mesh
        kept = Checkpoint(
            stepper.number,
            stepper.time,
            {
                "stepper": values,
                **self._simulation.output.identity,
                EDGES: self._edges,
                **self._more(),
            },
            arrays,
        )

        def write() -> None:
            self._sync()
            write_checkpoint(self._directory, kept)

        on_root(self._simulation.comm, write)
        self._steps, self._clock = 0, time.monotonic()


def load_checkpoint(directory: Path, comm: MPI.Comm) -> Checkpoint:
    """Return the newest checkpoint of a results directory; collective.

    Its arrays by cell are on rank 0 alone.

    Raises:
        NothingToResumeError: There is none.
    """
    newest = from_root(comm, lambda: newest_checkpoint(directory), None)
    plain = comm.bcast(newest and replace(newest, arrays={PROGRAM: newest.arrays[PROGRAM]}))
    return newest or plain


def go_on(simulation: Simulation, checkpoint: Checkpoint, directory: Path) -> None:
    """Let a simulation go on from a checkpoint; collective.

    Raises:
        NothingToResumeError: The checkpoint is not of such a simulation; on every rank.
    """
    problem: Exception | None = None
    try:
        with fitting(directory):
            simulation.resume(checkpoint)
    except NothingToResumeError as error:
        problem = error
    agree(simulation.comm, problem)


@contextmanager
def fitting(directory: Path) -> Iterator[None]:
    """Say of a checkpoint that lacks what is taken from it that it does not fit.

    Its digest tells damage, not what another program wrote.

    Raises:
        NothingToResumeError: In place of what Python says.
    """
    try:
        yield
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        logger.debug("the checkpoint does not fit", exc_info=True)
        raise NothingToResumeError(
            f"the checkpoint in {directory} does not fit this case ({in_brief(error)}): it is of "
            "another run; run the case from its beginning, into another directory or with "
            "--overwrite"
        ) from None


def require_same_mesh(sheet: Sheet, checkpoint: Checkpoint, directory: Path) -> None:
    """Raise if a sheet has not the mesh of a checkpoint; collective.

    Raises:
        NothingToResumeError: It has other cells or edges, on every rank.
    """
    with fitting(directory):
        same = has_mesh(sheet, checkpoint)
    if not same:
        raise NothingToResumeError(
            f"the run in {directory} cannot go on: its geometry, or a file that this reads, now "
            "gives another mesh. Go on with the geometry as it was, or run this case into another "
            "directory with -o"
        )


def has_mesh(sheet: Sheet, checkpoint: Checkpoint) -> bool:
    """Return whether a sheet has the cells and the edges of a checkpoint; collective."""
    now = mesh_of_cells(sheet)

    def same() -> bool:
        assert now is not None
        before = checkpoint.arrays[MESH]
        size = float(np.ptp(now[:, :6].reshape(-1, 2), axis=0).max())
        return (
            sheet.edges == checkpoint.values[EDGES]
            and before.shape == now.shape
            and bool(np.abs(now[:, :6] - before[:, :6]).max() <= SAME_PLACE * size)
            and bool((now[:, 6:] == before[:, 6:]).all())
        )

    return compute_on_root(sheet.mesh.comm, same)


def mesh_of_cells(sheet: Sheet) -> Array | None:
    """Return the array of a mesh on rank 0, and None elsewhere; collective."""
    mesh = sheet.mesh
    own = mesh.topology.index_map(2).size_local
    mesh.topology.create_connectivity(2, 1)
    facets = np.asarray(mesh.topology.connectivity(2, 1).array).reshape(-1, 3)[:own]
    facet_map = mesh.topology.index_map(1)
    tags = np.zeros(facet_map.size_local + facet_map.num_ghosts)
    tags[sheet.facets.indices] = sheet.facets.values
    corners = mesh.geometry.x[corners_of(mesh)[:own], :2].reshape(own, 6)
    return Blocks(mesh.comm, sheet.original_cells[:own]).gather(
        np.column_stack([corners, tags[facets]])
    )


def values_at(program: Program, times: Sequence[float] | Array) -> Array:
    """Return the array of a program at times (s)."""
    rows = [(t, program.value(t), program.prescribes_force(t), program.second(t)) for t in times]
    return np.array(rows).T
