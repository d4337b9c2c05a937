"""Meshes of trials, and what trials tell of finer ones: which to try next, and what is too much."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from math import ceil, inf, log

from mpi4py import MPI

from wovenfab.case import Case
from wovenfab.case.objects import follows_fibres, simulation_of
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.progress import memory
from wovenfab.study.response import GROWTH, with_elements

#: Returns the sheet of a case; collective over the communicator.
Mesher = Callable[[Case, MPI.Comm], Sheet]

#: Least, usual and largest order of an error in the size of cells; where it is judged whether
#: an accuracy is out of reach, the usual one is the least.
SLOW, USUAL, FAST = 2.0, 3.0, 4.0
#: Growth of unknowns with the number of cells across, least and largest.
LINE, AREA = 1.0, 2.0
#: Share of the target that finer cells aim at, so that they do not just miss it.
MARGIN = 0.8
#: Largest growth of the number of cells, and that where a trial did not reach its end.
MOST_GROWTH, RETRY_GROWTH = 2.0, 4 / 3
#: Growth of the number of cells in the search for the finest that limits allow.
SEARCH_GROWTH = 1.05


@dataclass(frozen=True)
class Limits:
    """Limits of the trials; times are those that their tangents usually take.

    Attributes:
        memory: Of the run, bytes.
        time: For all trials of elements, s.
        patience: After which a trial is given up on its way, s.
    """

    memory: float
    time: float = 150.0
    patience: float = inf


@dataclass(frozen=True)
class Trial:
    """Trials on one mesh.

    Attributes:
        cells: Across the shorter side of the sheet.
        unknowns: Of the elements by which meshes are compared.
        seconds: Time that their tangents usually take.
        error: Of the best elements; None where none reached the end.
    """

    cells: int
    unknowns: int
    seconds: float
    error: float | None


def next_cells(trials: Sequence[Trial], target: float) -> int:
    """Return the number of cells to try next for a target error, after one trial or more."""
    last = trials[-1]
    if last.error is None:
        return max(last.cells + 1, int(RETRY_GROWTH * last.cells))
    needed = _needed(last, MARGIN * target, _order(trials, SLOW))
    return max(last.cells + 1, min(ceil(needed), ceil(MOST_GROWTH * last.cells)))


def over_limits(unknowns: float, trials: Sequence[Trial], limits: Limits) -> str:
    """Return what elements would need in words, if that is more than the limits allow."""
    if (need := memory(ceil(unknowns))) > limits.memory:
        return f"{_rounded(unknowns)} unknowns and {need / 1e9:.2g} GB of memory"
    if trials:
        spent = sum(t.seconds for t in trials)
        takes = spent + trials[-1].seconds * (unknowns / trials[-1].unknowns) ** GROWTH
        if takes > limits.time:
            return f"{_rounded(unknowns)} unknowns, whose trials take {takes / 60:.2g} min"
    return ""


def out_of_reach(trials: Sequence[Trial], target: float, limits: Limits) -> tuple[str, float]:
    """Return what a target error would need if that is too much, and the least error possible.

    It is judged by the last two meshes; before there are two, nothing is out of reach.

    Args:
        trials: The trials so far.
        target: The error.
        limits: Of memory and time.

    Returns:
        The need in words, or nothing; about the error that the limits allow.
    """
    known = [t for t in trials if t.error is not None]
    if len(known) < 2:
        return "", 0.0
    last, growth = known[-1], _growth(known)

    def needs(cells: float) -> str:
        return over_limits(last.unknowns * (cells / last.cells) ** growth, trials, limits)

    if not (reason := needs(_needed(last, target, _order(known, USUAL)))):
        return "", 0.0
    finest = next(c for n in count() if needs((c := last.cells * SEARCH_GROWTH**n) * SEARCH_GROWTH))
    assert last.error is not None
    return reason, last.error * (last.cells / finest) ** _order(known, SLOW)


def _needed(last: Trial, target: float, order: float) -> float:
    assert last.error is not None
    return float(last.cells * (last.error / target) ** (1 / order))


def _order(trials: Sequence[Trial], least: float) -> float:
    """Return the order in the size of cells that the last two meshes show."""
    known = [t for t in trials if t.error]
    if len(known) < 2:
        return FAST
    coarse, fine = known[-2:]
    assert coarse.error and fine.error
    seen = log(coarse.error / fine.error) / log(fine.cells / coarse.cells)
    return min(max(seen, least), FAST)


def _growth(trials: Sequence[Trial]) -> float:
    coarse, fine = trials[-2:]
    seen = log(fine.unknowns / coarse.unknowns) / log(fine.cells / coarse.cells)
    return min(max(seen, LINE), AREA)


def _rounded(unknowns: float) -> str:
    return f"{float(f'{unknowns:.2g}'):.0f}"


def has_free_size(case: Case) -> bool:
    """Return whether the size of the cells can be chosen; a mesh that is given stays as it is."""
    return not str(getattr(case.sheet, "file", "")).endswith(".msh")


def with_cells(case: Case, size: float, **changes: object) -> Case:
    """Return a case with cells of a size (m), where that can be chosen, and other elements."""
    return with_elements(case, mesh_size=size if has_free_size(case) else None, **changes)


def could_stick(case: Case) -> bool:
    """Return whether friction could make two placements one, on a mesh that can be graded."""
    effects = [entry.effect for entry in case.scene]
    sticks = any(e.dissipative and e.needs.placements == 2 for e in effects)
    return sticks and follows_fibres(case)


def shorter_side(sheet: Sheet) -> float:
    """Return the shorter side of a sheet's bounding box, m; collective."""
    x, comm = sheet.mesh.geometry.x, sheet.mesh.comm
    sides = [
        comm.allreduce(float(x[:, i].max()), op=MPI.MAX)
        - comm.allreduce(float(x[:, i].min()), op=MPI.MIN)
        for i in (0, 1)
    ]
    return float(min(sides))


def compile_ahead(
    case: Case, comm: MPI.Comm, mesher: Mesher, degrees: Sequence[int]
) -> Iterator[int]:
    """Put into the cache what trials with these degrees will need, all ranks but the first.

    What cannot be compiled is reported where it is needed.

    Yields:
        Each degree, once it is compiled.
    """
    with suppress(Exception):
        sheet = mesher(case, MPI.COMM_SELF)
        for degree in degrees[comm.rank - 1 :: comm.size - 1]:
            with simulation_of(with_elements(case, degree=degree), sheet):
                pass
            yield degree
