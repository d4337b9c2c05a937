"""Elements and steps for a target accuracy, chosen by estimated errors of trials."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

from mpi4py import MPI

from wovenfab.case import Case
from wovenfab.case.objects import sheet_of
from wovenfab.model.spaces import placements_on
from wovenfab.sheet.sheet import Sheet
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.step import StepFailedError
from wovenfab.study.errors.elements import (
    FEW,
    DegreeRefinement,
    fastest_convergence,
    resolves_waves,
    response_with_degree,
)
from wovenfab.study.errors.estimate import Estimate
from wovenfab.study.errors.meshes import (
    Limits,
    Mesher,
    Trial,
    compile_ahead,
    could_stick,
    has_free_size,
    next_cells,
    out_of_reach,
    over_limits,
    shorter_side,
    with_cells,
)
from wovenfab.study.errors.step_search import ALMOST, Report, StepSearch
from wovenfab.study.response import (
    Budget,
    Response,
    TooLongError,
    depends_on_steps,
    has_fixed_steps,
    trial_of,
    with_elements,
    work,
)

logger = logging.getLogger(__name__)

#: Unknowns of any elements, for which a run takes about 5 GB. A machine that has not as much
#: refuses such elements; no machine chooses others.
MOST_UNKNOWNS = 5e5
#: Share of the accuracy that steps may use, at least: finer cells cost more than more steps.
STEPS_SHARE = 0.25
#: Scheme of the rates.
SCHEME = "bdf3"
#: Steps of a cycle where they have no error.
WITHOUT_ERROR = 20
#: Work of the tangents of all trials of elements, for an accuracy that is usual, and at most. Of
#: the random fabrics the hardest that reaches 1 % (scene 50) takes between 800 and 1000.
USUAL_ACCURACY, PATIENCE = 0.01, (1000.0, 2000.0)
#: Cells across the sheet's shorter side at first.
COARSEST = 2
#: Error of two placements with slip friction, over the target, from which the mesh is graded:
#: that takes three to four times as many unknowns, and pays where yarns stick.
MUCH = 4.0
#: Why the error of elements is not known.
WAVES = "compressed yarns may form shorter waves than these elements resolve"
#: Degrees that are tried on a mesh, one after another: each three of them give the errors of the
#: middle and the highest one.
DEGREES = (2, 3, 4, 5)


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


def plan(
    case: Case,
    comm: MPI.Comm,
    report: Report,
    limits: Limits | None = None,
    mesher: Mesher = sheet_of,
) -> Plan:
    """Return elements and steps for the accuracy of a case; collective.

    Steps are chosen first, with coarse elements, and then the elements, with few steps: the
    errors of both add up, and what one does not need is left to the other. Of several cycles the
    largest is tried. Rates are formed by BDF of third order, unless the case names a scheme.

    Args:
        case: A case with an accuracy.
        comm: The ranks.
        report: Called with a line on each trial.
        limits: Of unknowns and work; None for those that are usual, with the more work the smaller
            the accuracy.
        mesher: Returns the sheet of a case.
    """
    assert case.accuracy is not None
    base = base_case(case)
    sheet = mesher(base, comm)
    if limits is None:
        least, most = PATIENCE
        allowed = min(max(least, least * USUAL_ACCURACY / case.accuracy), most)
        limits = Limits(MOST_UNKNOWNS, allowed, allowed)
    few = 1.0 if has_fixed_steps(base) else FEW
    share, left = STEPS_SHARE * case.accuracy, case.accuracy
    search, steps, may_cut = None, None, True
    if depends_on_steps(base):
        coarse = trial_of(coarsest(base, sheet), share)
        search = StepSearch(coarse, comm, report, limits.patience, mesher)
        steps = search.steps_for(share, compile_ahead(coarse, comm, mesher, DEGREES[1:]))
        left -= min(steps.estimated_error, share) if steps else share
        may_cut = steps is not None and steps.error_of_share(few) <= share
    meshes = _MeshSearch(base, left, mesher, limits, report, sheet, few, may_cut)
    elements = meshes.run()
    if elements.reachable:
        able = f"about {100 * elements.reachable * case.accuracy / left:.2g} % can be asked for"
        elements = replace(elements, shortfall=f"{elements.shortfall}; {able}")
    if elements.estimate is None:
        return elements
    d, error = elements.case.discretisation, elements.estimate.worst
    logger.info(
        "elements: degree %d, mesh size %s m, estimated error %.2g of %.2g; %s",
        d.degree, d.mesh_size, error, left, elements.shortfall or "small enough",
    )  # fmt: skip
    if search is None or steps is None:
        return elements
    search.learn(elements.estimate, meshes.share)
    more = case.accuracy - error if error <= left else share * error / case.accuracy
    steps = search.steps_for(more) or steps
    logger.info("steps: %.3g times the usual, %s", steps.number, steps.words)
    estimate = replace(elements.estimate, time=steps.errors, missed=steps.missed)
    reached = estimate.worst <= ALMOST * case.accuracy
    shortfall = "" if reached else elements.shortfall or "shorter steps were not tried"
    return replace(elements, case=steps.of(elements.case), estimate=estimate, shortfall=shortfall)


def base_case(case: Case) -> Case:
    """Return a case without its accuracy, and with the scheme that steps for one are chosen by."""
    time = case.time
    if case.needs.rate and "scheme" not in time.model_fields_set:
        time = time.model_copy(update={"scheme": SCHEME})
    if not depends_on_steps(case):
        time = time.model_copy(update={"steps_per_cycle": WITHOUT_ERROR})
    return case.model_copy(update={"accuracy": None, "time": time})


def coarsest(case: Case, sheet: Sheet) -> Case:
    """Return a case with the elements on which steps are tried."""
    return with_cells(case, shorter_side(sheet) / COARSEST, degree=DEGREES[0])


@dataclass
class _MeshSearch:
    """The search for the coarsest cells and the lowest degree that are accurate enough.

    Attributes:
        case: The case without an accuracy.
        target: Relative error of the elements.
        mesher: Returns the sheet of a case.
        limits: Of unknowns and work.
        report: Called with a line on each trial.
        sheet: The sheet with any mesh.
        share: Share of the usual steps, which is enough for all degrees.
        may_cut: Whether the few steps of trials may be cut in some of those that are compared:
            their error is small enough.
        graded: Whether the mesh is graded, or None for as usual.
        best: The best elements so far.
        work: Of the trials of the last mesh.
        last: Of the last trial.
    """

    case: Case
    target: float
    mesher: Mesher
    limits: Limits
    report: Report
    sheet: Sheet
    share: float
    may_cut: bool = False
    graded: bool | None = None
    best: Plan | None = None
    work: float = 0.0
    last: float = 0.0

    def run(self) -> Plan:
        """Return the elements that are accurate enough, or the best; collective."""
        cells, reachable, failure = COARSEST, 0.0, ""
        trials: list[Trial] = []
        while True:
            size = shorter_side(self.sheet) / cells
            trial = with_cells(self.case, size, graded=self.graded)
            sheet = self.mesher(trial, self.sheet.mesh.comm)
            unknowns = _unknowns(trial, sheet, DEGREES[2])
            if need := over_limits(unknowns, trials, self.limits):
                reason = f"the next finer elements have {need}, more than allowed"
                break
            error = None
            try:
                error = self._error(trial, sheet, self._left(trials))
            except (StepFailedError, StabilityLostError) as problem:
                failure = f"no trial got to its end: {problem}"
            except TooLongError:
                reason = f"trials of {unknowns} unknowns take more work than allowed"
                break
            if error is not None and error <= self.target:
                assert self.best is not None
                return self.best
            if not has_free_size(self.case):
                reason = failure or "the mesh is given, so that only degrees could be tried"
                break
            trials.append(Trial(cells, unknowns, self.work, error))
            if self._should_grade(error):
                self._grade(sum(t.work for t in trials))
                trials = []
                continue
            need, reachable = out_of_reach(trials, self.target, self.limits)
            if need:
                reason = f"it needs elements with about {need}, more than allowed"
                break
            cells = next_cells(trials, self.target)
        logger.info("elements: accuracy not reached: %s", reason)
        if self.best is None:
            case = with_elements(self.case, degree=DEGREES[1])
            return Plan(case, self.sheet, None, failure or reason)
        if self.best.estimate and not self.best.estimate.resolved:
            reason = f"{WAVES}, and {reason}"
        return replace(self.best, shortfall=reason, reachable=reachable)

    def _grade(self, spent: float) -> None:
        """Go on with graded meshes, after some work."""
        self.report("the mesh is graded, for the error is large where yarns stick")
        self.graded = True
        left, patience = self.limits.work - spent, self.limits.patience - spent
        self.limits = replace(self.limits, work=left, patience=patience)

    def _left(self, trials: Sequence[Trial]) -> float:
        """Return the work that is left for trials."""
        return self.limits.patience - sum(t.work for t in trials)

    def _error(self, trial: Case, sheet: Sheet, left: float) -> float | None:
        """Return the error on a mesh by the lowest degree that is good enough, or by the best.

        Args:
            trial: The case with that mesh.
            sheet: Its sheet.
            left: Work that the steps may take.
        """
        responses: list[Response] = []
        error, degree, self.work = None, DEGREES[0], 0.0
        while degree <= DEGREES[-1]:
            unknowns = _unknowns(trial, sheet, degree)
            if unknowns > self.limits.unknowns:
                break
            if len(responses) >= 3 and self._expected(responses[-1], unknowns) > left:
                break
            self.report(f"elements: degree {degree}, {unknowns} unknowns")
            response = self._response(trial, sheet, degree, responses, left)
            if response is None:
                self.share *= 2
                self.report("once more with twice the steps, for they cannot be made")
                degree, responses = DEGREES[0], []
                continue
            responses.append(response)
            degree += 1
            if len(responses) < 3:
                continue
            degrees = tuple(range(degree - len(responses), degree))
            fastest = fastest_convergence(trial)
            refinement = DegreeRefinement(degrees, tuple(responses), fastest)
            resolved = resolves_waves(response.model)
            for judged in degrees[-2:]:
                case = with_elements(trial, degree=judged)
                estimate = Estimate(refinement, judged, resolved=resolved)
                error = self._add(case, sheet, estimate)
                if error is not None and error <= self.target:
                    return error
            if self._should_grade(error):
                break
        return error

    def _should_grade(self, error: float | None) -> bool:
        """Return whether the mesh should be graded, for the error of one that may not be."""
        much = error is not None and error >= MUCH * self.target
        return much and not self.graded and could_stick(self.case)

    def _expected(self, lower: Response, unknowns: int) -> float:
        """Return about the work that the trials of a mesh will have taken with one more.

        Args:
            lower: The last response.
            unknowns: Of the next one.
        """
        return self.work + self.last * work(unknowns) / work(lower.model.unknowns)

    def _response(
        self, trial: Case, sheet: Sheet, degree: int, lower: Sequence[Response], left: float
    ) -> Response | None:
        """Return the response with a degree; None where its few steps cannot be made.

        Degrees are compared with equal steps, so that few ones are not cut if that matters.

        Args:
            trial: The case with a mesh.
            sheet: Its sheet.
            degree: Of the elements.
            lower: Responses of lower degrees.
            left: Work that all steps of the mesh may take.
        """
        short, must_be_equal = trial_of(trial, self.target), self.share < 1 and not self.may_cut
        if must_be_equal:
            whole = short.time.model_copy(update={"smallest_step": 1.0})
            short = short.model_copy(update={"time": whole})
        before, budget = lower[-1] if lower else None, Budget(left - self.work)
        try:
            response = response_with_degree(short, sheet, degree, self.share, before, budget)
        except StepFailedError:
            if must_be_equal:
                return None
            raise
        finally:
            self.work += budget.spent
            self.last = budget.spent
        return None if must_be_equal and response.outcome.cutbacks else response

    def _add(self, case: Case, sheet: Sheet, estimate: Estimate) -> float | None:
        """Keep the best; return the error, or None where it is not known.

        Of one mesh the last judgement counts: it is of a higher degree, or knows more.
        """
        error, size = estimate.worst, case.discretisation.mesh_size
        words = f"error {100 * error:.2g} %" if estimate.resolved else WAVES
        self.report(f"degree {estimate.degree}: {words}")
        logger.info(
            "trial: mesh size %s m, degree %d: error %.2g of %.2g%s",
            size, estimate.degree, error, self.target, "" if estimate.resolved else f"; {WAVES}",
        )  # fmt: skip
        best = self.best.estimate if self.best else None
        rank = (not estimate.resolved, error)
        same = self.best is not None and self.best.sheet is sheet
        if best is None or same or rank < (not best.resolved, best.worst):
            self.best = Plan(case, sheet, estimate)
        return error if estimate.resolved else None


def _unknowns(case: Case, sheet: Sheet, degree: int) -> int:
    return placements_on(sheet.mesh, degree, case.needs.placements, sheet.jumps).unknowns
