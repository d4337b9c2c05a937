"""Steps in time for a target accuracy: equal or adaptive ones, whichever cost less."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import chain
from math import inf

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from wovenfab.case import Case
from wovenfab.case.objects import scheme_of, sheet_of
from wovenfab.case.program import program_of_case
from wovenfab.model.model import Model
from wovenfab.parallel import compute_on_root
from wovenfab.sheet.sheet import Sheet
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.step import StepFailedError
from wovenfab.study.errors.estimate import SAFETY, Estimate, worst
from wovenfab.study.errors.meshes import Mesher, has_free_size
from wovenfab.study.errors.steps import PEAKS, StepRefinement
from wovenfab.study.force_curve import ForceCurve
from wovenfab.study.response import (
    Budget,
    Response,
    TooLongError,
    has_fixed_steps,
    response_of,
    trial_of,
    with_extra_times,
    with_steps,
)

log = logging.getLogger(__name__)

#: Called with a line on each trial.
Report = Callable[[str], None]
#: Returns a case with a share of the usual number of steps.
Kind = Callable[[Case, float], Case]
#: Share of the peak that is counted as missed over what is expected from trials: with the elements
#: of the run it lies elsewhere between the steps.
UNSURE = 2.0
#: Shares of the usual number of steps in the first trial and, at most, in the last one.
FIRST, MOST = 0.125, 32.0
#: Error of a step beyond which equal ones are cut, too.
COARSE = 0.5
#: Tolerance by which adaptive steps of a scheme of third order are about as many as usual.
TOLERANCE = 3e-4
#: Growth of the number of steps from trial to trial, and up to which one is extrapolated; numbers
#: up to there of which the least is taken that is enough.
FAR, OPTIONS = 2.0, 48
#: Least ratio of two numbers of steps that are compared.
APART = 1.4
#: Distance of an extra step from the others, over the shortest of these, that is none.
NEAR = 0.25
#: Round-off of an error that just reaches the target.
ALMOST = 1 + 1e-9


@dataclass(frozen=True)
class TimeSteps:
    """Steps for an accuracy.

    Attributes:
        kind: Equal or adaptive ones.
        number: Of steps over the usual one.
        errors: Their signed errors over the figures.
        effort: Tangents in the trial.
        orders: In which the errors fall with the number.
        missed: Share of the peak of the force that is missed between steps, besides.
        extra: Times of the trial at which steps end, too, s.
    """

    kind: Kind
    number: float
    errors: dict[str, float]
    effort: float
    orders: dict[str, float]
    missed: float = 0.0
    extra: tuple[float, ...] = ()

    @property
    def estimated_error(self) -> float:
        """The largest error, on the safe side."""
        peak = SAFETY * worst({n: self.errors.get(n, 0.0) for n in PEAKS}) + UNSURE * self.missed
        return max(peak, SAFETY * worst(self.errors))

    @property
    def words(self) -> str:
        """The kind in words."""
        return _words(self.kind)

    def of(self, case: Case) -> Case:
        """Return a case with these steps."""
        program = program_of_case(with_extra_times(case, ()))  # the user's own cut its stretches
        trial = program_of_case(trial_of(case, 1.0))
        times = chain.from_iterable(program.same_times(trial, time) for time in self.extra)
        return with_extra_times(self.kind(case, self.number), (*case.time.extra_times, *times))

    def error_of_share(self, share: float) -> float:
        """Return about the largest error of a share of the usual number of equal steps."""
        if self.kind is not equal_steps:
            return inf
        growth = share / self.number
        return max((abs(e) / growth ** self.orders[n] for n, e in self.errors.items()), default=0.0)


def equal_steps(case: Case, number: float) -> Case:
    """Return a case with ``number`` times the usual equal steps, cut where too coarse."""
    return with_steps(case, number, COARSE if _measured(case) else None)


def adaptive_steps(case: Case, number: float) -> Case:
    """Return a case with about ``number`` times the usual steps, adaptive ones."""
    return with_steps(case, FIRST, TOLERANCE / number ** scheme_of(case).order)


class StepSearch:
    """The search for steps by trials on coarse elements; no trial is made twice.

    Trials on the coarsest mesh gain nothing from many ranks: the first one makes them alone.
    """

    def __init__(
        self,
        trial: Case,
        comm: MPI.Comm,
        report: Report,
        work: float = inf,
        mesher: Mesher = sheet_of,
    ) -> None:
        """Start without any trial.

        Args:
            trial: What is tried: a case with history, shorter, on coarse elements.
            comm: The ranks.
            report: Called with a line on each trial.
            work: That all trials may take together; see :class:`Budget`.
            mesher: Returns the sheet of a case.
        """
        self._budget = Budget(work)
        # How much later the force is largest with the elements of the run (s), and the figures of
        # trials over those of the run: errors of steps are as large, but over smaller figures.
        self._delay, self._larger = 0.0, dict[str, float]()
        self._trial, self._report, self._mesher = trial, report, mesher
        self._comm, self._alone = comm, has_free_size(trial)
        self._tried: dict[tuple[Kind, float], Response | None] = {}
        self._given_up = set[Kind]()  # of which more steps take too long
        self._model: Model | None = None  # of all trials

    def learn(self, estimate: Estimate, share: float) -> None:
        """Learn how the response of the elements of the run differs from trials; collective.

        Args:
            estimate: Errors of these elements, from responses with a share of the usual steps.
            share: That share.
        """
        self._made(partial(self._learn, estimate.response, estimate.refinement.responses[0], share))

    def _learn(self, other: Response, own: Response, share: float) -> None:
        with suppress(StepFailedError, StabilityLostError, TooLongError):
            if self._model is None or own.model.unknowns != self._model.unknowns:
                own = self._run(with_steps(self._trial, share))
            late, early = (r.curve.peak_of_spline()[0] for r in (other, own))
            self._delay = late - early
            self._larger = {
                name: max(1.0, abs(own.figures[name] / value))
                for name, value in other.figures.items()
                if value and name in own.figures
            }

    def steps_for(self, target: float, meanwhile: Iterable[object] = ()) -> TimeSteps | None:
        """Return the steps that cost least, or None where none can be chosen; collective.

        Args:
            target: Error of the steps over the figures, on the safe side.
            meanwhile: What ranks go through that make no trials.
        """
        return self._made(partial(self._cheapest, target), meanwhile)

    def _made[T](self, make: Callable[[], T], meanwhile: Iterable[object] = ()) -> T:
        return compute_on_root(self._comm, make, meanwhile) if self._alone else make()

    @cached_property
    def _sheet(self) -> Sheet:
        return self._mesher(self._trial, MPI.COMM_SELF if self._alone else self._comm)

    def _cheapest(self, target: float) -> TimeSteps | None:
        kinds: list[Kind] = [] if has_fixed_steps(self._trial) else [equal_steps]
        if _measured(self._trial):
            kinds.append(adaptive_steps)
        options: list[TimeSteps] = []
        for kind in kinds:
            least = min((o.effort for o in options if _reaches(o, target)), default=inf)
            if (option := self._enough(kind, target, least)) is None:
                continue
            options.append(option)
            log.info(
                "%s: %.3g times the usual, error %.2g of %.2g, %.0f tangents",
                option.words, option.number, option.estimated_error, target, option.effort,
            )  # fmt: skip
            if option.number <= 1 and _reaches(option, target):
                break  # no more than usual: no other kind is tried
        if not options:
            return None
        return min(options, key=lambda o: (not _reaches(o, target), o.effort))

    def _enough(
        self, kind: Kind, target: float, least: float, number: float = FIRST
    ) -> TimeSteps | None:
        """Return how many steps of a kind are enough.

        None where none can be made, or where they would take more tangents than ``least``: a trial
        that takes too many for that is given up. The first trial has ``number`` times the usual
        steps.
        """
        best = None
        tried = {n: r for (k, n), r in self._tried.items() if k is kind and r}
        known = {n: tried[n] for n in sorted(tried)}
        if known:
            number = max(tried)
        while number <= MOST:
            # The third trial may be judged, and be a multiple of what is enough.
            most = least * FAR if len(known) >= 2 else least
            if (response := self._response(kind, number, most)) is None:
                if kind in self._given_up:
                    break
                known, number = {}, FAR * number
                continue
            fewer = {n: r for n, r in known.items() if APART * r.count <= response.count}
            known = {n: r for n, r in fewer.items() if response.figures.keys() <= r.figures.keys()}
            known[number] = response
            if len(known) >= 3:
                best = self._least(kind, known, target)
                if _reaches(best, target):
                    break
            if response.outcome.iterations > least:
                break
            number *= FAR
        return best

    def _least(self, kind: Kind, known: Mapping[float, Response], target: float) -> TimeSteps:
        """Return the fewest steps that reach a target, or else as many as may be judged.

        They are those of an earlier trial, whose distance from the limit is known, or about as many
        as those of the last one. Equal steps meet the peak of the force or not by chance, which
        hardly depends on elements.

        Args:
            kind: Of the steps.
            known: Three responses at least, one after another, by what was tried.
            target: Error of the steps.
        """
        *earlier, number = known
        response, highest = known[number], scheme_of(self._trial).order
        refinement = StepRefinement(list(known.values()), highest)
        figures = refinement.errors_and_orders()
        options = [
            (fewer / number, refinement.errors_from(index))
            for index, fewer in enumerate(earlier)
            if index > 1  # the first two were not judged: a curve of so few steps has corners
        ]
        for growth in map(float, np.geomspace(1 / FAR, FAR, OPTIONS)):
            errors = {
                n: e / growth ** (order if growth > 1 else highest)
                for n, (e, order) in figures.items()
            }
            options.append((growth, errors))
        for growth, errors in options:
            missed, extra = response.curve.missed_peak(), tuple[float, ...]()
            if kind is equal_steps:
                missed, extra = self._missed(equal_steps(self._trial, growth * number), response)
            orders = {n: order if growth > 1 else highest for n, (_, order) in figures.items()}
            larger = {n: e * self._larger.get(n, 1.0) for n, e in errors.items()}
            effort = growth * response.outcome.iterations
            option = TimeSteps(kind, growth * number, larger, effort, orders, missed, extra)
            if _reaches(option, target):
                break
        return option

    def _missed(self, case: Case, response: Response) -> tuple[float, tuple[float, ...]]:
        """Return what steps miss of the peak with extra ones there, and the times of these (s).

        Where friction reverses nearly by a kink, the spline is largest too early: there is one
        more where the curve may be largest. There is none close to planned ones.

        Args:
            case: With equal steps.
            response: That of other steps.
        """
        own = response.curve
        late = (own.times + self._delay, own.forces, [b + self._delay for b in own.breaks])
        curve, extra = ForceCurve(*late), list[float]()
        times = _planned_times(case)
        near = NEAR * np.diff(times).min()
        for time, _ in (curve.peak_of_spline(), curve.peak_bound()):
            if np.abs(times - time).min() > near and 0 < time < times[-1]:
                extra.append(time)
                times = _planned_times(with_extra_times(case, extra))
        return ForceCurve(times, curve.spline(times), curve.breaks).missed_peak(), tuple(extra)

    def _response(self, kind: Kind, number: float, most: float) -> Response | None:
        """Return the response with so many times the usual steps; None where it has no end.

        It is given up after so many tangents, ``most``.
        """
        if (kind, number) not in self._tried and kind not in self._given_up:
            response = None
            try:
                response = self._run(kind(self._trial, number), most)
                tangents = response.outcome.iterations
                self._report(f"{_words(kind)}: {response.count}, {tangents} tangents")
            except TooLongError:
                self._given_up.add(kind)
            except (StepFailedError, StabilityLostError):
                pass  # with more steps it may get to its end
            self._tried[kind, number] = response
        return self._tried.get((kind, number))

    def _run(self, case: Case, most: float = inf) -> Response:
        """Return the response of a case with the elements of trials; collective."""
        response = response_of(
            case, self._sheet, budget=self._budget, tangents=most, model=self._model
        )
        self._model = response.model
        return response


def _planned_times(case: Case) -> NDArray[np.float64]:
    return np.array([milestone.time for milestone in program_of_case(case).milestones])


def _reaches(steps: TimeSteps, target: float) -> bool:
    return steps.estimated_error <= ALMOST * target


def _measured(case: Case) -> bool:
    """Return whether the error of a step is measured, so that steps can adapt."""
    return case.needs.rate and scheme_of(case).measures_error


def _words(kind: Kind) -> str:
    return kind.__name__.replace("_", " ")
