"""Elements and steps for a target accuracy, chosen by estimated errors of trials."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import count
from math import ceil, inf, log
from time import perf_counter

from mpi4py import MPI

from wovenfab.case import Case
from wovenfab.model.spaces import placements_on
from wovenfab.sheet.sheet import Sheet
from wovenfab.simulation.progress import memory, memory_of_machine
from wovenfab.simulation.response import Response, TooLongError, trial_of, with_elements
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.step import StepFailedError
from wovenfab.study.target_accuracy.estimate import (
    FEW,
    DegreeRefinement,
    Estimate,
    response_with_degree,
)
from wovenfab.study.target_accuracy.time_steps import Report, steps_for

logger = logging.getLogger(__name__)

#: Share of the machine's memory that a run may take.
MEMORY_SHARE = 0.6
#: Share of the accuracy that is aimed at, for estimates are not exact; the largest share of that
#: which elements may use where steps have an error, too: finer cells cost more than more steps.
AIM, ELEMENTS_SHARE = 0.8, 0.75
#: Scheme of the rates.
SCHEME = "bdf3"
#: Steps of a cycle where they have no error.
WITHOUT_ERROR = 20
#: Time of all trials of elements without compiling (s): for an accuracy that is usual, so that the
#: answer comes within a minute, and at most.
USUAL_ACCURACY, PATIENCE = 0.01, (45.0, 150.0)
#: Cells across the sheet's shorter side at first.
COARSEST = 2
#: Degrees that are tried on a mesh, one after another; one lower and one higher give the
#: errors of each.
DEGREES = (2, 3, 4, 5)

Mesher = Callable[[Case], Sheet]


@dataclass(frozen=True)
class Plan:
    """Elements and steps for an accuracy.

    Attributes:
        case: The case with elements and steps, without an accuracy.
        sheet: Its sheet.
        estimate: Its errors; None where no trial reached its end.
        shortfall: Why the accuracy is not reached, or empty.
        reachable: About the least error of elements that limits allow, if known, otherwise 0.
    """

    case: Case
    sheet: Sheet
    estimate: Estimate | None
    shortfall: str = ""
    reachable: float = 0.0


def plan(case: Case, mesher: Mesher, report: Report, limits: Limits | None = None) -> Plan:
    """Return elements and steps for the accuracy of a case; collective.

    Elements are chosen first, with few steps, and then the steps, with coarse elements: the
    errors of both add up. Of several cycles the largest is tried. Rates are formed by BDF of
    third order, unless the case names a scheme.

    Args:
        case: A case with an accuracy.
        mesher: Returns the sheet of a case.
        report: Called with a line on each trial.
        limits: Of memory and time; a share of the machine's memory, and the longer the smaller
            the accuracy, if None.
    """
    assert case.accuracy is not None
    time = case.time
    if case.needs.rate and "scheme" not in time.model_fields_set:
        time = time.model_copy(update={"scheme": SCHEME})
    if not case.needs.history:
        time = time.model_copy(update={"steps_per_cycle": WITHOUT_ERROR})
    base = case.model_copy(update={"accuracy": None, "time": time})
    sheet = mesher(base)
    if limits is None:
        least, most = PATIENCE
        seconds = min(max(least, least * USUAL_ACCURACY / case.accuracy), most)
        limits = Limits(memory_of_machine() * MEMORY_SHARE, seconds, seconds)
    aim = AIM * case.accuracy
    share = ELEMENTS_SHARE if base.needs.history else 1.0
    elements = _MeshSearch(base, share * aim, mesher, limits, report, sheet).run()
    if elements.reachable:
        able = f"about {100 * elements.reachable / (share * AIM):.2g} % can be asked for"
        elements = replace(elements, shortfall=f"{elements.shortfall}; {able}")
    if elements.estimate is None:
        return elements
    d, error = elements.case.discretisation, elements.estimate.worst
    logger.info(
        "elements: degree %d, mesh size %s m, estimated error %.2g of %.2g; %s",
        d.degree, d.mesh_size, error, share * aim, elements.shortfall or "small enough",
    )  # fmt: skip
    coarse = with_elements(base, mesh_size=shorter_side(sheet) / COARSEST, degree=2)
    coarse, coarse_sheet = meshed(coarse, mesher, sheet)
    left = max(aim - error, (1 - ELEMENTS_SHARE) * max(aim, error))
    steps = steps_for(elements.case, trial_of(coarse, left), coarse_sheet, left, report)
    if steps is None:
        return elements
    estimate = replace(elements.estimate, time=steps.errors)
    shortfall = elements.shortfall if estimate.worst > case.accuracy else ""
    if not shortfall and estimate.worst > case.accuracy:
        shortfall = "shorter steps were not tried"
    return replace(elements, case=steps.case, estimate=estimate, shortfall=shortfall)


@dataclass
class _MeshSearch:
    """The search for the coarsest cells and the lowest degree that are accurate enough.

    Attributes:
        case: The case without an accuracy.
        target: Relative error of the elements.
        mesher: Returns the sheet of a case.
        limits: Of memory and time.
        report: Called with a line on each trial.
        sheet: The sheet with any mesh.
        best: The best elements so far.
        share: Share of the usual steps, which is enough for all degrees.
        seconds: Wall time of the steps of the last mesh, without compiling.
    """

    case: Case
    target: float
    mesher: Mesher
    limits: Limits
    report: Report
    sheet: Sheet
    best: Plan | None = None
    share: float = FEW
    seconds: float = 0.0

    def run(self) -> Plan:
        """Return the elements that are accurate enough, or the best; collective."""
        cells, reachable, failure = COARSEST, 0.0, ""
        trials: list[Trial] = []
        while True:
            start = perf_counter()
            size = shorter_side(self.sheet) / cells
            trial, sheet = meshed(with_elements(self.case, mesh_size=size), self.mesher, self.sheet)
            unknowns = _unknowns(trial, sheet, DEGREES[2])
            if need := over_limits(unknowns, trials, self.limits):
                reason = f"the next finer elements have {need}, more than allowed"
                break
            error = None
            try:
                error = self._error(trial, sheet, self._left(trials))
            except (StepFailedError, StabilityLostError) as problem:
                self.seconds = perf_counter() - start
                failure = f"no trial got to its end: {problem}"
            except TooLongError:
                reason = f"trials of {unknowns} unknowns take longer than allowed"
                break
            if error is not None and error <= self.target:
                assert self.best is not None
                return self.best
            if not has_free_size(self.case):
                reason = failure or "the mesh is given, so that only degrees could be tried"
                break
            trials.append(Trial(cells, unknowns, _slowest(sheet, self.seconds), error))
            need, reachable = out_of_reach(trials, self.target, self.limits)
            if need:
                reason = f"it needs elements with about {need}, more than allowed"
                break
            cells = next_cells(trials, self.target)
        logger.info("elements: accuracy not reached: %s", reason)
        if self.best is None:
            case = with_elements(self.case, degree=DEGREES[1])
            return Plan(case, self.mesher(self.case), None, failure or reason)
        return replace(self.best, shortfall=reason, reachable=reachable)

    def _left(self, trials: Sequence[Trial]) -> float:
        """Return the time that is left for trials, s."""
        return self.limits.patience - sum(t.seconds for t in trials)

    def _error(self, trial: Case, sheet: Sheet, left: float) -> float | None:
        """Return the error on a mesh by the lowest degree that is good enough, or by the best.

        Args:
            trial: The case with that mesh.
            sheet: Its sheet.
            left: Time that the steps may take, s.
        """
        responses: list[Response] = []
        error, self.seconds = None, 0.0
        for degree in DEGREES:
            unknowns = _unknowns(trial, sheet, degree)
            if memory(unknowns) > self.limits.memory:
                break
            self.report(f"elements: degree {degree}, {unknowns} unknowns")
            lower = responses[-1] if responses else None
            short = trial_of(trial, self.target)
            seconds = left - self.seconds
            responses.append(response_with_degree(short, sheet, degree, self.share, lower, seconds))
            self.seconds += responses[-1].seconds
            # degrees are compared with equal steps
            if responses[-1].outcome.cutbacks and self.share < 1:
                self.share *= 2
                self.report("once more with twice the steps, for some had to be cut")
                return self._error(trial, sheet, left - self.seconds)
            if len(responses) < 3:
                continue
            degrees = (degree - 2, degree - 1, degree)
            refinement = DegreeRefinement(degrees, tuple(responses[-3:]))
            case = with_elements(trial, degree=degree - 1)
            error = self._add(case, sheet, Estimate(refinement, degree - 1))
            if error <= self.target:
                break
        return error

    def _add(self, case: Case, sheet: Sheet, estimate: Estimate) -> float:
        """Keep the best; return the error."""
        error, size = estimate.worst, case.discretisation.mesh_size
        self.report(f"degree {estimate.degree}: error {100 * error:.2g} %")
        logger.info(
            "trial: mesh size %s m, degree %d: error %.2g of %.2g",
            size, estimate.degree, error, self.target,
        )  # fmt: skip
        best = self.best
        if best is None or best.estimate is None or error < best.estimate.worst:
            self.best = Plan(case, sheet, estimate)
        return error


def meshed(case: Case, mesher: Mesher, sheet: Sheet) -> tuple[Case, Sheet]:
    """Return a case and its sheet; a mesh that was given stays as it is."""
    if not has_free_size(case):
        return with_elements(case, mesh_size=None), sheet
    return case, mesher(case)


def has_free_size(case: Case) -> bool:
    """Return whether the size of the cells can be chosen."""
    return not str(getattr(case.sheet, "file", "")).endswith(".msh")


def shorter_side(sheet: Sheet) -> float:
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


#: Least, usual and largest order of an error in the size of cells; where it is judged whether
#: an accuracy is out of reach, the usual one is the least.
SLOW, USUAL, FAST = 2.0, 3.0, 4.0
#: Growth of unknowns with the number of cells across, least and largest; of time with unknowns.
LINE, AREA, GROWTH = 1.0, 2.0, 1.2
#: Share of the target that finer cells aim at, so that they do not just miss it.
MARGIN = 0.8
#: Largest growth of the number of cells, and that where a trial did not reach its end.
MOST_GROWTH, RETRY_GROWTH = 2.0, 4 / 3
#: Growth of the number of cells in the search for the finest that limits allow.
SEARCH_GROWTH = 1.05


@dataclass(frozen=True)
class Limits:
    """Limits of the trials.

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
        seconds: Their wall time.
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
