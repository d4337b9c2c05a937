"""Fewer rows of a long record: means of neighbours, as many as the curve's shape needs.

Of each branch the rows are divided into bins, whose means are the new rows; reversals stay. A bin
is halved while straight lines between the means are too far from the record there. Noise is no
shape: it is told by averages. The mean of L neighbouring distances of rows from the lines may be
the stated error plus :data:`NOISE` times s/sqrt(L), with s the scatter of the force between rows,
for L = 1, 2, 4, ... up to a quarter of the bin. Without scatter no row is farther away than the
error. Rows that are kept singly would carry their noise, and the farthest ones would be chosen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wovenfab.measured.curve import MEDIAN, THIRD, Measured
from wovenfab.measured.replicates import Replicates

Array = NDArray[np.float64]
Rows = NDArray[np.intp]
#: Multiple of the standard deviation of a mean from which it is no noise.
NOISE = 5.0
#: Bins of a branch at least, and averages in a bin at least. A straight branch needs few, but with
#: few rows nothing tells their scatter.
FIRST, PARTS = 50, 4


@dataclass(frozen=True)
class Thinning:
    """What became of the rows of a record.

    Attributes:
        before, after: Number of rows.
        deviation: Largest distance of the straight lines between the new rows from the record,
            beyond noise, N.
        scatter: Standard deviation of the force between neighbouring rows, N.
    """

    before: int
    after: int
    deviation: float
    scatter: float

    def describe(self, name: str, size: float) -> str:
        """Return a sentence, with forces as shares of the largest one (N)."""
        return (
            f"{name}: {self.before} rows became {self.after} means; between them straight lines "
            f"are within {100 * self.deviation / size:.2g} % of the largest force, beyond a "
            f"scatter of rows of {100 * self.scatter / size:.2g} %."
        )


def thinned(curves: Replicates, error: float) -> tuple[Replicates, Thinning]:
    """Return curves with fewer rows, those of their mean, and what became of them.

    Args:
        curves: The curves.
        error: Distance (N) of the record from straight lines that is allowed, beyond noise.
    """
    whole = curves.mean
    scatter = scatter_of(whole)
    bins: list[Rows] = []
    reversals, deviation = [0], 0.0
    for number, rows in enumerate(whole.branches()):
        own, most = _bins(whole, rows, error, scatter)
        bins += own if number == 0 else own[1:]  # the reversal is the end of the branch before
        reversals.append(len(bins) - 1)
        deviation = max(deviation, most)

    def means(values: Array) -> Array:
        return np.array([values[..., rows].mean(axis=-1) for rows in bins]).T

    mean = replace(
        whole,
        displacement=means(whole.displacement),
        force=means(whole.force),
        time=None,
        reversals=tuple(reversals),
    )
    counts = np.array([float(rows.size) for rows in bins])
    result = Replicates(curves.specimens, mean, means(curves.forces), counts)
    return result, Thinning(len(whole.force), len(bins), deviation, scatter)


def scatter_of(measured: Measured) -> float:
    """Return the standard deviation of the noise of a force between neighbouring rows, N.

    By third differences, which a smooth curve hardly has, and their median, which reversals and
    kinks do not change.
    """
    third = np.diff(measured.force, 3)
    return float(np.median(np.abs(third))) / (MEDIAN * THIRD) if third.size else 0.0


def _bins(measured: Measured, rows: Rows, error: float, scatter: float) -> tuple[list[Rows], float]:
    """Return the rows of each bin of a branch, and the largest distance beyond noise, N."""
    inner = rows[1:-1]
    order = inner[np.argsort(measured.displacement[inner], kind="stable")]
    if measured.displacement[rows[0]] > measured.displacement[rows[-1]]:
        order = order[::-1]
    order = np.array([rows[0], *order, rows[-1]])
    u, force = measured.displacement[order], measured.force[order]
    count = len(order)
    # Starts of the bins; the first and the last row are bins of their own.
    starts = np.unique([0, *np.linspace(1, count - 1, min(FIRST, count - 1) + 1).astype(int)])
    while True:
        ends = np.append(starts[1:], count)
        sizes = ends - starts
        places, heights = (np.add.reduceat(v, starts) / sizes for v in (u, force))
        rising = slice(None) if places[0] <= places[-1] else slice(None, None, -1)
        distance = force - np.interp(u, places[rising], heights[rising])
        beyond = _beyond_noise(distance, starts, sizes, scatter)
        wrong = np.flatnonzero((beyond > error) & (sizes > 1))
        alone = (beyond > error) & (sizes == 1)  # the lines beside it are wrong: split those bins
        beside = np.flatnonzero(alone)
        near = np.concatenate([beside - 1, beside + 1])
        near = near[(near >= 0) & (near < len(starts))]
        wrong = np.union1d(wrong, near[sizes[near] > 1])
        if not wrong.size:
            break
        starts = np.union1d(starts, starts[wrong] + sizes[wrong] // 2)
    return [order[a:b] for a, b in zip(starts, ends, strict=True)], float(beyond.max(initial=0.0))


def _beyond_noise(distance: Array, starts: Rows, sizes: Rows, scatter: float) -> Array:
    """Return the largest mean of neighbouring distances of each bin, less that of noise, N."""
    beyond = np.zeros(len(starts))
    length, sums = 1, np.concatenate([[0.0], np.cumsum(distance)])
    while length * PARTS <= sizes.max() or length == 1:
        noise = NOISE * scatter / np.sqrt(length)
        means = np.abs(sums[length:] - sums[:-length]) / length
        for number in np.flatnonzero(sizes >= (1 if length == 1 else length * PARTS)):
            part = means[starts[number] : starts[number] + sizes[number] - length + 1]
            beyond[number] = max(beyond[number], float(part.max()) - noise)
        length *= 2
    return beyond
