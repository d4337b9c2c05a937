"""Blocks of rows, one a cell, gathered from all ranks in an order that is not the ranks'."""

from __future__ import annotations

from itertools import accumulate
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from mpi4py import MPI


class Blocks:
    """Gathers rows to rank 0, sorted by cell, so that files do not depend on the ranks.

    Attributes:
        total: Number of blocks on all ranks.
    """

    def __init__(self, comm: MPI.Comm, cells: NDArray[Any]) -> None:
        """Learn the order; collective.

        Args:
            comm: The ranks that hold the blocks.
            cells: Number of each local block's cell in the whole mesh, shape (blocks,).

        Raises:
            ValueError: Two blocks have the same cell (a ghost, say); on every rank.
        """
        self._comm = comm
        parts = comm.allgather(np.asarray(cells, dtype=np.int64))
        together = np.concatenate(parts)
        if len(np.unique(together)) < len(together):
            raise ValueError("a cell is given twice: hand over owned cells only")
        self.total = len(together)
        self._counts = [len(part) for part in parts]
        self._order = np.argsort(together)

    def gather(self, rows: NDArray[Any]) -> NDArray[Any] | None:
        """Return all rows on rank 0, ordered by cell, None elsewhere; collective.

        Args:
            rows: Local rows, shape (rows,) or (rows, columns): the same number for each
                block, and of one type and number of columns on all ranks.

        Raises:
            ValueError: The ranks have blocks of different sizes; on every rank.
        """
        from mpi4py.util.dtlib import from_numpy_dtype

        count = self._counts[self._comm.rank]
        widths = set(self._comm.allgather(rows.size // count if count else None)) - {None}
        if len(widths) > 1:
            raise ValueError("the ranks hand over blocks of different sizes")
        width = widths.pop() if widths else 0
        # counting whole blocks keeps MPI's 32-bit counts from overflowing
        block = from_numpy_dtype(rows.dtype).Create_contiguous(width).Commit()
        received = np.empty((self.total if self._comm.rank == 0 else 0, width), rows.dtype)
        starts = list(accumulate(self._counts, initial=0))[:-1]
        try:
            self._comm.Gatherv(
                [np.ascontiguousarray(rows), count, block],
                [received, self._counts, starts, block],
                root=0,
            )
        finally:
            block.Free()
        if self._comm.rank != 0:
            return None
        return received[self._order].reshape(-1, *rows.shape[1:])
