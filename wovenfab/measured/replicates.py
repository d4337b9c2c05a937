"""Replicates: curves of several specimens of one fabric in the same test, and their mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wovenfab.case.errors import case_error
from wovenfab.measured.curve import FEWEST, Measured

Array = NDArray[np.float64]
#: Most names of curves in that of their mean.
SHOWN = 4


@dataclass(frozen=True)
class Replicates:
    """Curves at common displacements.

    Attributes:
        specimens: The curves as they were measured, k of them.
        mean: The mean curve, of n rows.
        forces: Forces of each specimen at the displacements of the mean, N, shape (k, n).
        counts: Number of rows of the record that each row is the mean of, shape (n,); None for one.
    """

    specimens: tuple[Measured, ...]
    mean: Measured
    forces: Array
    counts: Array | None = None

    @property
    def shares(self) -> Array:
        """Rows of the record that each row stands for over their mean number, shape (n,)."""
        if self.counts is None:
            return np.ones(self.forces.shape[1])
        return np.asarray(self.counts / self.counts.mean())

    @property
    def error(self) -> Array:
        """Standard deviation of the mean force, N, shape (n,): s/sqrt(k), zero for one curve."""
        count = len(self.specimens)
        if count == 1:
            return np.zeros(self.forces.shape[1])
        return np.asarray(self.forces.std(axis=0, ddof=1) / np.sqrt(count))


def replicates_of(curves: Sequence[Measured]) -> Replicates:
    """Return curves with their mean; one curve is its own mean.

    They are interpolated branch by branch, within the displacements that all of them have in that
    branch. The common displacements are those of the curve with the fewest rows there: there are
    no more of them than were measured.

    Raises:
        CaseError: The curves do not have the same branches, or no displacements in common.
    """
    first = curves[0]
    if len(curves) == 1:
        return Replicates((first,), first, first.force[None])
    branches = [curve.branches() for curve in curves]
    for curve, own in zip(curves, branches, strict=True):
        if len(own) != len(branches[0]):
            raise case_error(
                str(curve.file),
                f"the replicate has {len(own)} branches of loading and unloading, "
                f"{first.file.name} has {len(branches[0])}",
                "Replicates are of the same test: choose the same cycle, or the rows.",
            )
    at, forces = [], []
    for number in range(len(branches[0])):
        parts = []
        for curve, own in zip(curves, branches, strict=True):
            rows = own[number]
            order = rows[np.argsort(curve.displacement[rows], kind="stable")]
            parts.append((curve.displacement[order], curve.force[order]))
        low, high = max(u[0] for u, _ in parts), min(u[-1] for u, _ in parts)
        fewest = min(parts, key=lambda part: len(part[0]))[0]
        inside = fewest[(fewest >= low) & (fewest <= high)]
        if len(inside) < FEWEST:
            message = f"the replicates have less than {FEWEST} displacements in common"
            remedy = f"That is in branch {number + 1}, from {1e3 * low:.4g} to {1e3 * high:.4g} mm."
            raise case_error(str(first.file), message, remedy)
        u = first.displacement[branches[0][number]]
        common = inside if u[-1] > u[0] else inside[::-1]
        common = common[1:] if number else common  # the reversal is the end of the branch before
        at.append(common)
        forces.append(np.array([np.interp(common, *part) for part in parts]))
    every = np.concatenate(forces, axis=1)
    names = [curve.file.stem for curve in curves]
    shown = names if len(names) <= SHOWN else [names[0], "...", names[-1]]
    mean = Measured(
        Path(f"mean of {', '.join(shown)}"),
        np.concatenate(at),
        every.mean(axis=0),
        cycle=first.cycle,
    )
    return Replicates(tuple(curves), mean, every)
