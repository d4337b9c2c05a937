"""Elements that reach a wanted accuracy: the coarsest cells and the lowest degree that do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

from mpi4py import MPI

from wovenfab.case import Case
from wovenfab.model.spaces import placements_on
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.progress import memory
from wovenfab.simulation.response import Response, brief, discretised
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.step import StepFailedError
from wovenfab.study.target_accuracy.cost_model import (
    Limits,
    Tried,
    beyond,
    next_cells,
    out_of_reach,
)
from wovenfab.study.target_accuracy.estimate import FEW, Estimate, Ladder, rung
from wovenfab.study.target_accuracy.time_steps import Tell

Mesher = Callable[[Case], Sheet]
#: Cells across the sheet's shorter side at first.
COARSEST = 2
#: Degrees that are tried on a mesh, one after another; one lower and one higher tell the
#: errors of each.
DEGREES = (2, 3, 4, 5)


@dataclass(frozen=True)
class Plan:
    """What the pilot found.

    Attributes:
        case: The case with elements and steps, without a wanted accuracy.
        sheet: Its sheet.
        estimate: Its errors; None where no trial got to its end.
        shortfall: Why the accuracy is not reached, or empty.
        reachable: About the least error of elements that limits allow, if known, otherwise 0.
    """

    case: Case
    sheet: Sheet
    estimate: Estimate | None
    shortfall: str = ""
    reachable: float = 0.0


@dataclass
class _Search:
    """What is sought, and the best so far.

    Attributes:
        wanted: Relative error of the elements.
        limits: Of memory and time.
        tell: Called with what is being done.
        best: The best found.
        share: Share of the usual steps, which is enough for all degrees.
        seconds: Wall time of the steps of the last mesh, without compiling.
    """

    wanted: float
    limits: Limits
    tell: Tell
    best: Plan | None = None
    share: float = FEW
    seconds: float = 0.0

    def add(self, found: Plan) -> float:
        """Keep the best; return the error."""
        assert found.estimate is not None
        error = found.estimate.worst
        self.tell(f"degree {found.estimate.degree}: error {100 * error:.2g} %")
        if self.best is None or self.best.estimate is None or error < self.best.estimate.worst:
            self.best = found
        return error


def mesh_for(
    case: Case, wanted: float, mesher: Mesher, limits: Limits, tell: Tell, whole: Sheet
) -> Plan:
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
    cells, reachable, failure = COARSEST, 0.0, ""
    tried: list[Tried] = []
    while True:
        begun = perf_counter()
        trial, sheet = meshed(discretised(case, mesh_size=side(whole) / cells), mesher, whole)
        unknowns = _unknowns(trial, sheet, DEGREES[2])
        if need := beyond(unknowns, tried, limits):
            reason = f"the next finer elements have {need}, more than allowed"
            break
        error = None
        try:
            error = _try(search, trial, sheet)
        except (StepFailedError, StabilityLostError) as problem:
            search.seconds = perf_counter() - begun
            failure = f"no trial got to its end: {problem}"
        if error is not None and error <= wanted:
            assert search.best is not None
            return search.best
        if not is_sized(case):
            reason = failure or "the mesh is given, so that only degrees could be tried"
            break
        tried.append(Tried(cells, unknowns, _slowest(sheet, search.seconds), error))
        need, reachable = out_of_reach(tried, wanted, limits)
        if need:
            reason = f"it needs elements with about {need}, more than allowed"
            break
        cells = next_cells(tried, wanted)
    if search.best is None:
        return Plan(discretised(case, degree=DEGREES[1]), mesher(case), None, failure or reason)
    return replace(search.best, shortfall=reason, reachable=reachable)


def _try(search: _Search, trial: Case, sheet: Sheet) -> float | None:
    """Return the error with a mesh by the lowest degree that is good enough, or by the best."""
    traces: list[Response] = []
    error, search.seconds = None, 0.0
    for degree in DEGREES:
        unknowns = _unknowns(trial, sheet, degree)
        if memory(unknowns) > search.limits.memory:
            break
        search.tell(f"elements: degree {degree}, {unknowns} unknowns")
        below = traces[-1] if traces else None
        traces.append(rung(brief(trial, search.wanted), sheet, degree, search.share, below))
        search.seconds += traces[-1].seconds
        if traces[-1].cutbacks and search.share < 1:  # degrees are compared with equal steps
            search.share *= 2
            search.tell("once more with twice the steps, for some had to be cut")
            return _try(search, trial, sheet)
        if len(traces) < 3:
            continue
        ladder = Ladder((degree - 2, degree - 1, degree), tuple(traces[-3:]))
        case = discretised(trial, degree=degree - 1)
        error = search.add(Plan(case, sheet, Estimate(ladder, degree - 1)))
        if error <= search.wanted:
            break
    return error


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
