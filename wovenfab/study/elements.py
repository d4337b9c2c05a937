"""Elements that reach a wanted accuracy, by ever finer cells and two degrees."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from math import cbrt, ceil
from time import perf_counter

from mpi4py import MPI

from wovenfab.case import Case
from wovenfab.model.placements import placements_on
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.size import memory
from wovenfab.simulation.trace import Trace, brief, discretised
from wovenfab.stepping.failure import StepFailedError
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.study.estimate import FEW, Estimate, Ladder, rung, worst
from wovenfab.study.steps import Tell

Mesher = Callable[[Case], Sheet]
#: Cells across the sheet's shorter side, first and last; how many more are tried at most.
COARSEST, FINEST, FURTHER = 2, 32, 1.5
#: Degree of the elements, and a higher one that is tried for an accuracy below; one lower and
#: one higher tell the errors of each.
DEGREE, HIGHER, FINE = 3, 4, 0.005
#: Times the wanted error at which the higher degree, which is dear to compile, is not tried.
HOPELESS = 2.0
#: Share of the wanted error that finer cells aim at, so that they do not just miss it.
SURE = 0.8
#: An error is at least this share of the change from the degree below, as was seen so far.
LEFT = 0.04
#: Time that may be spent on trials of one mesh, s; growth of time with unknowns.
PATIENCE, GROWTH = 1200.0, 1.3


@dataclass(frozen=True)
class Found:
    """What the pilot found.

    Attributes:
        case: The case with elements and steps, without a wanted accuracy.
        sheet: Its sheet.
        estimate: Its errors; None where no trial got to its end.
        shortfall: Why the accuracy is not reached, or empty.
    """

    case: Case
    sheet: Sheet
    estimate: Estimate | None
    shortfall: str = ""


@dataclass(frozen=True)
class Limits:
    """What finding out may take.

    Attributes:
        memory: Of the run, bytes.
        time: For the trials of one mesh, s.
    """

    memory: float
    time: float = PATIENCE


@dataclass
class _Search:
    """What is sought, and the best so far.

    Attributes:
        wanted: Relative error of the elements.
        limits: Of memory and time.
        tell: Called with what is being done.
        best: The best found.
        reason: Why nothing better is found.
        share: Share of the usual steps, which is enough for all degrees.
    """

    wanted: float
    limits: Limits
    tell: Tell
    best: Found | None = None
    reason: str = "finer cells were not tried"
    share: float = FEW
    _before: int = 0
    _taken: float = 0.0

    def allows(self, unknowns: int, highest: int) -> bool:
        """Return whether memory and time allow a mesh; says why if not.

        Args:
            unknowns: Of the elements.
            highest: With the highest degree that is tried.
        """
        need = memory(highest)
        if need > self.limits.memory:
            self.reason = f"the next finer elements need {need / 1e9:.2g} GB of memory"
            return False
        expected = self._taken * (unknowns / max(self._before, 1)) ** GROWTH
        if expected > self.limits.time:
            self.reason = f"trials of the next finer elements would take {expected / 60:.2g} min"
            return False
        return True

    def took(self, unknowns: int, seconds: float) -> None:
        """Note the time of a mesh."""
        self._before, self._taken = unknowns, seconds

    def add(self, found: Found) -> float:
        """Keep the best; return the error."""
        assert found.estimate is not None
        error = found.estimate.worst
        self.tell(f"degree {found.estimate.degree}: error {error:.2%}")
        if self.best is None or self.best.estimate is None or error < self.best.estimate.worst:
            self.best = found
        return error


def elements_for(
    case: Case, wanted: float, mesher: Mesher, limits: Limits, tell: Tell, whole: Sheet
) -> Found:
    """Return a case with elements whose error is small enough, or the best; collective.

    Args:
        case: The case without a wanted accuracy.
        wanted: Relative error of the elements.
        mesher: Returns the sheet of a case.
        limits: Of memory and time.
        tell: Called with what is being done.
        whole: The sheet with any mesh.
    """
    search = _Search(wanted, limits, tell)
    cells = COARSEST
    skipped: tuple[Case, Sheet] | None = None
    while cells <= FINEST:
        trial, sheet = meshed(discretised(case, mesh_size=side(whole) / cells), mesher, whole)
        unknowns, begun = _unknowns(trial, sheet, DEGREE), perf_counter()
        if not search.allows(unknowns, _unknowns(trial, sheet, DEGREE + 1)):
            break
        try:
            error = _try(search, trial, sheet)
            skipped = (trial, sheet) if error is None else None
        except (StepFailedError, StabilityLostError) as failure:
            error, skipped = None, None
            search.reason = f"no trial got to its end: {failure}" if not search.best else ""
        if error is not None and error <= wanted:
            assert search.best is not None
            return search.best
        if not is_sized(case):
            if search.best is not None:
                search.reason = "the mesh is given, so that only degrees could be tried"
            break
        search.took(unknowns, _slowest(sheet, perf_counter() - begun))
        cells = _finer(cells, error, wanted)
    if skipped is not None:  # nothing finer is possible
        with suppress(StepFailedError, StabilityLostError):
            _try(search, *skipped, skips=False)
    reason = search.reason or "finer cells were not tried"
    if search.best is None:
        return Found(discretised(case, degree=DEGREE), mesher(case), None, reason)
    return replace(search.best, shortfall=reason)


def _try(search: _Search, trial: Case, sheet: Sheet, skips: bool = True) -> float | None:
    """Return the error with a mesh by the best degree.

    None, if ``skips``, where it must be too large, so that the highest degree is not tried.
    """
    traces: dict[int, Trace] = {}
    error = None
    sized = is_sized(trial)
    for degree in (DEGREE, HIGHER) if search.wanted < FINE or not sized else (DEGREE,):
        degrees = degree - 1, degree, degree + 1
        if memory(_unknowns(trial, sheet, degrees[-1])) > search.limits.memory:
            break
        for p in degrees:
            if p in traces:
                continue
            changes = _changes(traces, degree)
            if sized and skips and p > degree and LEFT * worst(changes) > search.wanted:
                search.tell("far too coarse")
                return None
            search.tell(f"elements: degree {p}, {_unknowns(trial, sheet, p)} unknowns")
            traces[p] = rung(brief(trial), sheet, p, search.share, traces.get(p - 1))
            if traces[p].cutbacks and search.share < 1:  # degrees are compared with equal steps
                search.share *= 2
                search.tell("once more with twice the steps, for some had to be cut")
                return _try(search, trial, sheet, skips)
        ladder = Ladder(degrees, tuple(traces[p] for p in degrees))
        found = Found(discretised(trial, degree=degree), sheet, Estimate(ladder, degree))
        error = search.add(found)
        hopeless = worst(ladder.errors(degrees[-1])) > HOPELESS * search.wanted
        if error <= search.wanted or (sized and hopeless):
            break
    return error


def _changes(traces: dict[int, Trace], degree: int) -> dict[str, float]:
    """Return the relative changes of the figures from the degree below, if both are known."""
    if degree not in traces or degree - 1 not in traces:
        return {}
    below, now = traces[degree - 1].figures, traces[degree].figures
    return {name: (below[name] - value) / value for name, value in now.items() if value}


def _finer(cells: int, error: float | None, wanted: float) -> int:
    """Return the number of cells to try next; errors fall like the cube of their size."""
    if error is None:
        return cells + max(1, cells // 3)
    needed = ceil(cells * cbrt(error / (SURE * wanted)))
    return max(cells + 1, min(needed, ceil(FURTHER * cells)))


def meshed(case: Case, mesher: Mesher, whole: Sheet) -> tuple[Case, Sheet]:
    """Return a case and its sheet; a mesh that was given stays as it is."""
    if not is_sized(case):
        return discretised(case, mesh_size=None), whole
    return case, mesher(case)


def is_sized(case: Case) -> bool:
    """Return whether the size of the cells can be chosen."""
    return not str(getattr(case.sheet, "file", "")).endswith(".msh")


def side(sheet: Sheet) -> float:
    """Return the shorter side of a sheet's bounding box, m; collective."""
    x, comm = sheet.mesh.geometry.x, sheet.mesh.comm
    sides = [
        comm.allreduce(float(x[:, i].max()), op=MPI.MAX)
        - comm.allreduce(float(x[:, i].min()), op=MPI.MIN)
        for i in (0, 1)
    ]
    return float(min(sides))


def _slowest(sheet: Sheet, seconds: float) -> float:
    """Return the longest time of all ranks, so that all decide alike; collective."""
    return float(sheet.mesh.comm.allreduce(seconds, op=MPI.MAX))


def _unknowns(case: Case, sheet: Sheet, degree: int) -> int:
    return placements_on(sheet.mesh, degree, case.needs.placements, sheet.jumps).unknowns
