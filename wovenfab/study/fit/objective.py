"""Residuals of all tests and their derivatives, for given values of the parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wovenfab.case import Case, CaseError
from wovenfab.case.fingerprint import fingerprint
from wovenfab.forms.effect import Target
from wovenfab.parallel import end_with_parent
from wovenfab.study.cluster import Cluster
from wovenfab.study.fit.clouds import field_compared
from wovenfab.study.fit.figures import figures_compared
from wovenfab.study.fit.fit_file import FieldTest, FigureTest, Fit, FittedTest, with_values
from wovenfab.study.fit.response import (
    Comparison,
    FieldPoints,
    ResponseCurve,
    TrialError,
    command,
    compared,
    computed,
    curve_of,
)
from wovenfab.study.response import with_elements, with_steps
from wovenfab.study.runner import Store, Submit, signals_to_end

Array = NDArray[np.float64]
#: Runs one after the other in this process.
HERE = Cluster(jobs=1)


@dataclass(frozen=True)
class FitTrial:
    """Values that were tried.

    Attributes:
        number: From 1.
        scale: Size of cells and steps over those of the cases.
        values: Of the parameters, in SI units.
        misfit: Root mean square of the distances of all tests, over the largest measured force, or
            each measured figure.
        seconds: Wall time of its runs, one after the other.
        failure: Why it was rejected; empty if its runs came to their ends.
    """

    number: int
    scale: float
    values: Mapping[str, float]
    misfit: float
    seconds: float
    failure: str = ""

    @property
    def coarse(self) -> bool:
        """Whether cells and steps were larger than those of the cases."""
        return self.scale > 1


@dataclass(frozen=True)
class Evaluation:
    """Residuals of all tests.

    Attributes:
        residuals: Distances over the error of a force or figure, all tests after each other.
        jacobian: Their derivatives by the scaled parameters.
        curves: Computed curve of each test.
        comparisons: What was compared, by test.
    """

    residuals: Array
    jacobian: Array
    curves: tuple[ResponseCurve, ...]
    comparisons: tuple[Comparison, ...]

    @property
    def misfit(self) -> float:
        """Root mean square of the distances over the largest force of the test, or the figure."""
        shares = np.concatenate([c.shares for c in self.comparisons])
        return float(np.sqrt(np.mean(shares[self.counted] ** 2)))

    @property
    def counted(self) -> NDArray[np.bool_]:
        """Rows that the misfit counts: resolved ones of curves and figures; else of fields."""
        of_field = np.concatenate([np.full(c.rows.size, c.of_field) for c in self.comparisons])
        return np.asarray(self.resolved & (~of_field | of_field.all()))

    @property
    def resolved(self) -> NDArray[np.bool_]:
        """Whether the steps resolve the curve there, shape (n,)."""
        return np.concatenate([c.resolved for c in self.comparisons])

    def weights(self, fit: Fit) -> Array:
        """Return the error of a force over that with what the steps do not resolve, shape (n,)."""
        return weights(fit, self.comparisons)


@dataclass(frozen=True)
class DiscretisationCorrection:
    """What fine runs have more than coarse ones.

    Attributes:
        at: Scaled parameters where both were run, shape (p,).
        fine, coarse: What they gave.
        weights: Of the residuals, shape (n,).
    """

    at: Array
    fine: Evaluation
    coarse: Evaluation
    weights: Array

    def applied(self, coarse: Evaluation, scaled: Array, free: Array) -> tuple[Array, Array]:
        """Return corrected residuals, and their derivatives by the parameters that are free.

        Both are weighted. Where the steps of coarse runs do not resolve the curve, the residuals
        are those of the fine ones with their derivatives.
        """
        known = coarse.resolved & self.coarse.resolved
        jacobian = self.fine.jacobian.copy()
        jacobian[known] += (coarse.jacobian - self.coarse.jacobian)[known]
        more = self.fine.jacobian - np.where(known[:, None], self.coarse.jacobian, 0.0)
        residuals = self.fine.residuals + more @ (scaled - self.at)
        residuals[known] += (coarse.residuals - self.coarse.residuals)[known]
        return self.weights * residuals, (self.weights[:, None] * jacobian)[:, free]


def weights(fit: Fit, comparisons: Sequence[Comparison]) -> Array:
    """Return the error of a force over that with what steps do not resolve, by row, shape (n,).

    Points of a field whose errors are not independent weigh less.
    """
    parts = []
    for test, c in zip(fit.tests, comparisons, strict=True):
        errors = test.errors[c.rows]
        parts.append(np.sqrt(test.share) * errors / np.hypot(errors, c.unresolved))
    return np.concatenate(parts)


@dataclass(frozen=True)
class CurveRequest:
    """What is computed for one or more tests.

    Attributes:
        case: The case.
        targets: The material parameters by which it is differentiated.
        places: Where and when displacements are wanted, by the key of a field.
    """

    case: Case
    targets: Sequence[Target]
    places: Mapping[str, FieldPoints]

    @property
    def suffix(self) -> str:
        """What its result depends on beside the case and the parameters."""
        return "".join(f"-{key}" for key in sorted(self.places))


class Objective:
    """Evaluates residuals and their derivatives; a context manager, which ends its processes.

    Scaled parameters are logarithms where the search steps by factors, else values over the width
    of their bounds.

    Attributes:
        trials: All so far.
    """

    def __init__(
        self,
        fit: Fit,
        folder: Path,
        cluster: Cluster = HERE,
        report: Callable[[FitTrial], None] = lambda trial: None,
    ) -> None:
        """Start the processes, if there are several tests or ranks, or reach the cluster.

        Args:
            fit: The fit.
            folder: For the curves that are computed: a fit that is repeated finds them there.
            cluster: Where the runs are made.
            report: Called with each trial.
        """
        self._fit, self._report, self._stack = fit, report, ExitStack()
        self._received: list[int] = []  # signals to end
        self._store, self._ranks = Store(folder), cluster.ranks
        self._pool: ProcessPoolExecutor | None = None
        self._submit: Submit | None = None
        if not cluster.is_local or cluster.ranks > 1:
            self._submit = self._stack.enter_context(cluster.open(folder))
        elif (jobs := min(cluster.side_by_side, len(fit.tests))) > 1:
            pool = ProcessPoolExecutor(
                jobs, mp_context=get_context("spawn"), initializer=end_with_parent
            )
            self._pool = self._stack.enter_context(pool)
        self.trials: list[FitTrial] = []
        self._evaluated: dict[str, Evaluation | None] = {}
        self._tried: set[str] = set()
        self._reference: Mapping[str, float] = {u.name: u.start for u in fit.unknowns}

    def __enter__(self) -> Objective:
        """Heed signals to end; return the objective itself."""
        self._received = self._stack.enter_context(signals_to_end(at_once=True))
        return self

    def __exit__(self, *_: object) -> None:
        """End the processes."""
        self._stack.close()

    def scaled(self, values: Mapping[str, float]) -> Array:
        """Return scaled parameters."""
        pairs = ((u, values[u.name]) for u in self._fit.unknowns)
        return np.array([np.log(v) if u.by_factors else v / np.ptp(u.bounds) for u, v in pairs])

    def values(self, scaled: Array) -> dict[str, float]:
        """Return values in SI units."""
        pairs = zip(self._fit.unknowns, scaled, strict=True)
        raw = ((u, np.exp(q) if u.by_factors else q * np.ptp(u.bounds)) for u, q in pairs)
        return {u.name: float(np.clip(v, *u.bounds)) for u, v in raw}

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Smallest and largest scaled parameters."""
        low, high = (self.scaled({u.name: u.bounds[k] for u in self._fit.unknowns}) for k in (0, 1))
        return low, high

    def slopes(self, values: Mapping[str, float]) -> Array:
        """Return the derivatives of values by scaled parameters."""
        return np.array([u.slope(values[u.name]) for u in self._fit.unknowns])

    def evaluate(self, values: Mapping[str, float], scale: float = 1.0) -> Evaluation:
        """Return residuals and derivatives for values (SI units) of the parameters.

        ``scale`` is the size of cells and steps over those of the cases.

        Raises:
            TrialError: A run did not come to its end.
        """
        fit = self._fit
        curves = self._curves(values, scale)
        comparisons, residuals, rows = [], [], []
        targets = [(values[u.name], u.target) for u in fit.unknowns if u.target]
        factors = np.array([1 / value if t.relative else 1.0 for value, t in targets])
        for test, computed_curve in zip(fit.tests, curves, strict=True):
            curve = computed_curve.times(factors)
            if isinstance(test, FieldTest):
                c = field_compared(test, curve, fit.unknowns)
            elif isinstance(test, FigureTest):
                c = figures_compared(test, curve, fit.unknowns)
            else:
                reference = self._reference
                c = compared(
                    test.measured, curve, fit.unknowns, values, test.toe, reference, test.error
                )
            factor = test.factors[c.rows]
            comparisons.append(c)
            residuals.append(factor * (c.computed - c.measured))
            rows.append(factor[:, None] * c.slopes)
        jacobian = np.concatenate(rows) * self.slopes(values)
        return Evaluation(np.concatenate(residuals), jacobian, tuple(curves), tuple(comparisons))

    def attempt(self, values: Mapping[str, float], scale: float) -> Evaluation | None:
        """Return the same, and None where a run failed; a new trial is noted.

        Raises:
            KeyboardInterrupt: This process was told to end.
        """
        if self._received:
            raise KeyboardInterrupt
        key = f"{scale} " + " ".join(f"{value:.12e}" for value in values.values())
        if key not in self._evaluated:
            done, failure = None, ""
            try:
                done = self.evaluate(values, scale)
            except TrialError as error:
                failure = str(error)
            misfit = done.misfit if done else np.nan
            seconds = sum(curve.seconds for curve in done.curves) if done else 0.0
            if key not in self._tried:
                trial = FitTrial(len(self.trials) + 1, scale, values, misfit, seconds, failure)
                self.trials.append(trial)
                self._report(trial)
            self._tried.add(key)
            self._evaluated[key] = done
        return self._evaluated[key]

    def choose_rows(self, values: Mapping[str, float], scale: float) -> bool:
        """Compare the rows that the program reaches with these values of the machine's parameters.

        Slack takes rows away at one end of a curve and makes others comparable at the other end.

        Returns:
            Whether they are others than before: the search must then go on.

        Raises:
            TrialError: As from :meth:`evaluate`, which is called with ``scale``.
        """
        if not any(u.target is None for u in self._fit.unknowns):
            return False
        before = self.evaluate(values, scale).comparisons
        self._reference = dict(values)
        after = self.evaluate(values, scale).comparisons
        if all(np.array_equal(a.rows, b.rows) for a, b in zip(before, after, strict=True)):
            return False
        self._evaluated.clear()
        return True

    def _curves(self, values: Mapping[str, float], scale: float) -> list[ResponseCurve]:
        fit = self._fit
        targets = [u.target for u in fit.unknowns if u.target is not None]
        try:
            cases = [at_scale(with_values(t.case, fit.unknowns, values), scale) for t in fit.tests]
        except CaseError as error:  # a formula may have values that it cannot have
            raise TrialError(str(error)) from error
        by = sha256(" ".join(map(str, targets)).encode()).hexdigest()[:8]
        requests = [
            CurveRequest(case, targets, self._places(test))
            for case, test in zip(cases, fit.tests, strict=True)
        ]
        marks = [f"{fingerprint(request.case)}-{by}{request.suffix}" for request in requests]
        stored = {mark: self._load(mark) for mark in marks}
        known = {mark: curve for mark, curve in stored.items() if curve is not None}
        waiting = {
            mark: request
            for mark, request in zip(marks, requests, strict=True)
            if mark not in known
        }
        fresh = self._fresh([*waiting.values()])
        for mark, curve in zip(waiting, fresh, strict=True):
            self._store.save(mark, mark, curve.as_lists())
            known[mark] = curve
        return [known[mark] for mark in marks]

    def _places(self, test: FittedTest) -> dict[str, FieldPoints]:
        """Return where displacements of the case of a test are wanted, by any test of it."""
        same = (t for t in self._fit.tests if isinstance(t, FieldTest) and t.case is test.case)
        return {one.key: FieldPoints(one.time, one.points) for one in same}

    def _fresh(self, requests: Sequence[CurveRequest]) -> Iterable[ResponseCurve]:
        """Return curves that are asked for, computed now."""
        if self._submit:  # a process each, on any machine
            commands = [
                command(request.case, request.targets, request.places, self._ranks)
                for request in requests
            ]
            return [curve_of(f.result()) for f in [*map(self._submit, commands)]]
        if not self._pool:
            return map(_computed, requests)
        try:  # processes that stay: most of the time of a short run would be its start
            return [*self._pool.map(_computed, requests)]
        except BrokenProcessPool:
            raise TrialError("the process of a run was killed, maybe for its memory") from None

    def _load(self, mark: str) -> ResponseCurve | None:
        data: Any = self._store.load(mark, mark)
        return None if data is None else ResponseCurve.of(data)


def _computed(request: CurveRequest) -> ResponseCurve:
    return computed(request.case, request.targets, request.places)


def at_scale(case: Case, scale: float) -> Case:
    """Return a case with larger or smaller cells and steps; those given by files stay."""
    if scale == 1:
        return case
    size = case.discretisation.mesh_size
    other = with_elements(case, mesh_size=scale * size) if size else case
    return with_steps(other, 1 / scale, case.time.tolerance)
