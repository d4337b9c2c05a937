"""What finer cells would take and bring, from the trials made so far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from math import ceil, log

from wovenfab.simulation.progress import memory

#: Least, usual and largest order of an error in the size of cells; where it is judged whether
#: an accuracy is out of reach, the usual one is the least.
SLOW, USUAL, FAST = 2.0, 3.0, 4.0
#: Growth of unknowns with the number of cells across, least and largest; of time with unknowns.
LINE, AREA, GROWTH = 1.0, 2.0, 1.2
#: Share of the wanted error that finer cells aim at, so that they do not just miss it.
SURE = 0.8
#: How many times more cells are tried at most, and where a trial came to no end.
FURTHER, ONWARD = 2.0, 4 / 3
#: Step in cells in looking for the finest that is possible.
FINER = 1.05


@dataclass(frozen=True)
class Limits:
    """What finding out may take.

    Attributes:
        memory: Of the run, bytes.
        time: For all trials of elements, s.
    """

    memory: float
    time: float = 150.0


@dataclass(frozen=True)
class Tried:
    """The trials with one mesh.

    Attributes:
        cells: Across the shorter side of the sheet.
        unknowns: Of the elements by which meshes are compared.
        seconds: That they took.
        error: Of the best answer; None where there is none.
    """

    cells: int
    unknowns: int
    seconds: float
    error: float | None


def next_cells(tried: Sequence[Tried], wanted: float) -> int:
    """Return the number of cells to try next for a wanted error, after one trial or more."""
    last = tried[-1]
    if last.error is None:
        return max(last.cells + 1, int(ONWARD * last.cells))
    needed = _needed(last, SURE * wanted, _order(tried, SLOW))
    return max(last.cells + 1, min(ceil(needed), ceil(FURTHER * last.cells)))


def beyond(unknowns: float, tried: Sequence[Tried], limits: Limits) -> str:
    """Return what elements would need in words, if that is more than the limits allow."""
    if (need := memory(ceil(unknowns))) > limits.memory:
        return f"{_rounded(unknowns)} unknowns and {need / 1e9:.2g} GB of memory"
    if tried:
        spent = sum(t.seconds for t in tried)
        takes = spent + tried[-1].seconds * (unknowns / tried[-1].unknowns) ** GROWTH
        if takes > limits.time:
            return f"{_rounded(unknowns)} unknowns, whose trials take {takes / 60:.2g} min"
    return ""


def out_of_reach(tried: Sequence[Tried], wanted: float, limits: Limits) -> tuple[str, float]:
    """Return what a wanted error would need if that is too much, and the least error possible.

    It is judged by the last two meshes; before there are two, nothing is out of reach.

    Args:
        tried: The trials so far.
        wanted: The error.
        limits: Of memory and time.

    Returns:
        The need in words, or nothing; about the error that the limits allow.
    """
    known = [t for t in tried if t.error is not None]
    if len(known) < 2:
        return "", 0.0
    last, growth = known[-1], _growth(known)

    def needs(cells: float) -> str:
        return beyond(last.unknowns * (cells / last.cells) ** growth, tried, limits)

    if not (reason := needs(_needed(last, wanted, _order(known, USUAL)))):
        return "", 0.0
    finest = next(c for n in count() if needs((c := last.cells * FINER**n) * FINER))
    assert last.error is not None
    return reason, last.error * (last.cells / finest) ** _order(known, SLOW)


def _needed(last: Tried, wanted: float, order: float) -> float:
    assert last.error is not None
    return float(last.cells * (last.error / wanted) ** (1 / order))


def _order(tried: Sequence[Tried], least: float) -> float:
    """Return the order in the size of cells that the last two meshes show."""
    known = [t for t in tried if t.error]
    if len(known) < 2:
        return FAST
    coarse, fine = known[-2:]
    assert coarse.error and fine.error
    seen = log(coarse.error / fine.error) / log(fine.cells / coarse.cells)
    return min(max(seen, least), FAST)


def _growth(tried: Sequence[Tried]) -> float:
    coarse, fine = tried[-2:]
    seen = log(fine.unknowns / coarse.unknowns) / log(fine.cells / coarse.cells)
    return min(max(seen, LINE), AREA)


def _rounded(unknowns: float) -> str:
    return f"{float(f'{unknowns:.2g}'):.0f}"
