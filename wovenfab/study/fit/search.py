"""The search for parameters: least squares of all tests, by trust regions and exact derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from wovenfab.case import Case
from wovenfab.simulation.response import with_elements, with_steps
from wovenfab.study.fit.fit_file import Fit, with_values
from wovenfab.study.fit.response import Comparison, Curve, TrialError, compared, computed
from wovenfab.study.runner import Store, fingerprint

Array = NDArray[np.float64]
#: Changes of the parameters and slopes that end the search in any case.
TOLERANCES = {"xtol": 1e-4, "gtol": 1e-8}
#: Largest relative change of the sum of squares that ends it. With n points it is 1/n at most, the
#: change by which one standard error of a parameter raises it.
CHANGE = 0.02
#: Distance from the solution that ends the first stage, and the second one: the part of the
#: residuals that a linear step would remove over the rest, each by its degrees of freedom (Bates
#: and Watts, Technometrics 23 (1981) 179-183, doi:10.1080/00401706.1981.10486260). At 1 the
#: solution is as far away as the ends of a confidence region.
NEAR = 1.0, 0.3
#: First trust region of both stages, in scaled parameters: by factors of 3 and of 1.35.
REGION = 1.1, 0.3
#: Runs of the first stage: size of their cells and number of their steps over those of the case.
COARSE = 2.0, 0.5
#: Largest number of trials.
MOST_TRIALS = 40
#: Residual of a run that failed, over the largest one before.
FAILED = 10.0


@dataclass(frozen=True)
class Trial:
    """Values that were tried.

    Attributes:
        number: From 1.
        coarse: Whether it was of the first stage.
        values: Of the parameters, in SI units.
        misfit: Root mean square of the distances, over the largest measured force, of all tests.
        seconds: Wall time of its runs, one after the other.
        failure: Why it was rejected; empty if its runs came to their ends.
    """

    number: int
    coarse: bool
    values: Mapping[str, float]
    misfit: float
    seconds: float
    failure: str = ""


def _ignore(trial: Trial) -> None:
    """Do nothing."""


@dataclass(frozen=True)
class Evaluation:
    """Residuals of all tests.

    Attributes:
        residuals: Distances over the error of a force, all tests after each other.
        jacobian: Their derivatives by the scaled parameters.
        curves: Computed curve of each test.
        comparisons: What was compared, by test.
    """

    residuals: Array
    jacobian: Array
    curves: tuple[Curve, ...]
    comparisons: tuple[Comparison, ...]


@dataclass(frozen=True)
class Found:
    """What the search has found.

    Attributes:
        values: Of the parameters, in SI units.
        evaluation: There.
        trials: All that were tried.
        converged: Whether the search ended by itself.
        reason: In words.
        error: Estimated error of the curves by cells and steps, over the largest force.
    """

    values: Mapping[str, float]
    evaluation: Evaluation
    trials: tuple[Trial, ...]
    converged: bool
    reason: str
    error: float


class Objective:
    """Evaluates residuals and their derivatives; a context manager, which ends its processes.

    Scaled parameters are logarithms where the search steps by factors, else values over the width
    of their bounds.

    Attributes:
        trials: All so far.
        coarse: Whether runs have larger cells and steps than the cases say.
    """

    def __init__(
        self,
        fit: Fit,
        folder: Path,
        jobs: int = 1,
        report: Callable[[Trial], None] = _ignore,
    ) -> None:
        """Start the processes, if there are several tests.

        Args:
            fit: The fit.
            folder: For the curves that are computed: a fit that is repeated finds them there.
            jobs: Number of runs side by side.
            report: Called with each trial.
        """
        self._fit, self._report, self._stack = fit, report, ExitStack()
        self._store = Store(folder)
        jobs = min(jobs, len(fit.tests))
        self._pool: ProcessPoolExecutor | None = None
        if jobs > 1:
            pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))
            self._pool = self._stack.enter_context(pool)
        self.trials: list[Trial] = []
        self.coarse = False

    def __enter__(self) -> Objective:
        """Return the objective itself."""
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

    def slopes(self, values: Mapping[str, float]) -> Array:
        """Return the derivatives of values by scaled parameters."""
        pairs = ((u, values[u.name]) for u in self._fit.unknowns)
        return np.array([v if u.by_factors else np.ptp(u.bounds) for u, v in pairs])

    def evaluate(self, values: Mapping[str, float]) -> Evaluation:
        """Return residuals and derivatives.

        Raises:
            TrialError: A run did not come to its end.
        """
        fit = self._fit
        curves = self._curves(values)
        comparisons, residuals, rows = [], [], []
        for test, curve in zip(fit.tests, curves, strict=True):
            c = compared(test, curve, fit.unknowns, values)
            factor = np.sqrt(test.weight) / test.error
            comparisons.append(c)
            residuals.append(factor * (c.force - c.measured))
            rows.append(factor * c.slopes)
        jacobian = np.concatenate(rows) * self.slopes(values)
        return Evaluation(np.concatenate(residuals), jacobian, tuple(curves), tuple(comparisons))

    def attempt(self, values: Mapping[str, float]) -> Evaluation | None:
        """Return the same, and None where a run failed; the trial is noted."""
        number = len(self.trials) + 1
        try:
            done = self.evaluate(values)
        except TrialError as error:
            self._note(Trial(number, self.coarse, values, np.nan, 0.0, str(error)))
            return None
        seconds = sum(curve.seconds for curve in done.curves)
        self._note(Trial(number, self.coarse, values, misfit(done.comparisons), seconds))
        return done

    def _note(self, trial: Trial) -> None:
        self.trials.append(trial)
        self._report(trial)

    def _curves(self, values: Mapping[str, float]) -> list[Curve]:
        fit = self._fit
        targets = [u.target for u in fit.unknowns if u.target is not None]
        cases = [with_values(test.case, fit.unknowns, values) for test in fit.tests]
        if self.coarse:
            cases = [coarser(case) for case in cases]
        marks = [fingerprint(case) for case in cases]
        stored = [self._load(mark) for mark in marks]
        waiting = [i for i, curve in enumerate(stored) if curve is None]
        if self._pool:
            futures = {i: self._pool.submit(computed, cases[i], targets) for i in waiting}
            fresh = {i: future.result() for i, future in futures.items()}
        else:
            fresh = {i: computed(cases[i], targets) for i in waiting}
        for i, curve in fresh.items():
            as_lists = {k: np.asarray(v).tolist() for k, v in asdict(curve).items()}
            self._store.save(marks[i], marks[i], as_lists)
        return [curve if curve else fresh[i] for i, curve in enumerate(stored)]

    def _load(self, mark: str) -> Curve | None:
        data: Any = self._store.load(mark, mark)
        if data is None:
            return None
        u, f, slopes = (np.array(data[k]) for k in ("displacement", "force", "slopes"))
        return Curve(u, f, slopes, tuple(data["turns"]), data["seconds"])


def coarser(case: Case) -> Case:
    """Return a case with larger cells and steps, as runs of the first stage have."""
    size = case.discretisation.mesh_size
    larger = with_elements(case, mesh_size=COARSE[0] * size) if size else case
    return with_steps(larger, COARSE[1], case.time.tolerance)


def misfit(comparisons: Sequence[Comparison]) -> float:
    """Return the root mean square of the distances, each over its test's largest force."""
    parts = [(c.force - c.measured) / np.abs(c.measured).max() for c in comparisons]
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def start_values(objective: Objective, fit: Fit) -> dict[str, float]:
    """Return where the search starts.

    Without inertia a sheet whose strengths and stiffnesses are all multiplied by a number carries
    forces multiplied by it. Parameters without a start of their own are those of the case times
    the number that brings its forces nearest to the measured ones.
    """
    values = {u.name: u.start for u in fit.unknowns}
    free = [u for u in fit.unknowns if u.scaled and u.target is not None and "N" in u.unit]
    if not free:
        return values
    first = objective.attempt(values)
    if first is None:
        return values
    pairs = list(zip(fit.tests, first.comparisons, strict=True))
    upper = sum(float(c.force @ c.measured) / t.error**2 for t, c in pairs)
    lower = sum(float(c.force @ c.force) / t.error**2 for t, c in pairs)
    factor = max(upper / lower, 1e-6) if lower else 1.0
    return values | {u.name: float(np.clip(u.start * factor, *u.bounds)) for u in free}


def search(objective: Objective, fit: Fit) -> Found:
    """Return the values of least squares: first with coarse runs, then with those of the cases.

    Raises:
        TrialError: No run came to its end at the start.
    """
    objective.coarse = True
    near, coarse, _, _ = _minimised(objective, fit, start_values(objective, fit), 0)
    objective.coarse = False
    first: list[Evaluation] = []
    values, done, converged, reason = _minimised(objective, fit, near, 1, first)
    error = _error(first[0], coarse)
    return Found(values, done, tuple(objective.trials), converged, reason, error)


def _minimised(
    objective: Objective,
    fit: Fit,
    start: Mapping[str, float],
    stage: int,
    first: list[Evaluation] | None = None,
) -> tuple[dict[str, float], Evaluation, bool, str]:
    """Return values of least squares, what they give, and whether and why the search ended.

    Args:
        objective: Evaluates residuals and derivatives.
        fit: The fit.
        start: Values to start from.
        stage: 0 for the first one, 1 for the second.
        first: Gets what the start gives.
    """
    region = REGION[stage]
    evaluated: dict[bytes, Evaluation | None] = {}
    first = [] if first is None else first
    origin = objective.scaled(start)  # scipy's first trust region is 1 around zero

    def values_at(q: Array) -> dict[str, float]:
        return objective.values(origin + region * q)

    def at(q: Array) -> Evaluation | None:
        key = q.tobytes()
        if key not in evaluated:
            evaluated[key] = done = objective.attempt(values_at(q))
            if done is not None:
                first.append(done)
        return evaluated[key]

    def residuals(q: Array) -> Array:
        if (done := at(q)) is not None:
            return done.residuals
        known = [one.residuals for one in evaluated.values() if one is not None]
        if not known:
            raise TrialError(f"the run at the start failed: {objective.trials[-1].failure}")
        worst = max(float(np.abs(one).max()) for one in known)
        return np.full_like(known[0], FAILED * worst)  # a trial that is rejected

    def jacobian(q: Array) -> Array:
        done = at(q)
        assert done is not None
        if offset(done.residuals, done.jacobian[:, (q > low) & (q < high)]) <= NEAR[stage]:
            raise _NearEnoughError(q)
        return region * done.jacobian

    low, high = (
        (objective.scaled({u.name: u.bounds[side] for u in fit.unknowns}) - origin) / region
        for side in (0, 1)
    )
    margin = 1e-9 * (high - low)
    inside = np.clip(np.zeros_like(origin), low + margin, high - margin)
    points = sum(test.measured.force.size for test in fit.tests)
    try:
        result = least_squares(
            residuals, inside, jacobian, bounds=(low, high), max_nfev=MOST_TRIALS,
            ftol=min(CHANGE, 1 / points), **TOLERANCES,
        )  # fmt: skip
        q, converged, reason = result.x, result.status > 0, str(result.message)
    except _NearEnoughError as near:
        q, converged, reason = near.q, True, "the residuals are near to their smallest"
    done = at(q)
    assert done is not None
    return values_at(q), done, converged, reason


class _NearEnoughError(Exception):
    """Ends the search where its linear steps change nothing of weight."""

    def __init__(self, q: Array) -> None:
        super().__init__()
        self.q = q


def offset(residuals: Array, jacobian: Array) -> float:
    """Return the relative offset of Bates and Watts; zero without parameters that may move.

    Args:
        residuals: Shape (n,).
        jacobian: Their derivatives, shape (n, p).
    """
    n, p = jacobian.shape
    if not p or n <= p:
        return 0.0
    basis, _ = np.linalg.qr(jacobian)
    along = basis.T @ residuals
    rest = residuals @ residuals - along @ along
    return float(np.sqrt((along @ along / p) / max(float(rest) / (n - p), 1e-300)))


def _error(full: Evaluation, coarse: Evaluation) -> float:
    """Return the estimated error of the full runs by cells and steps, over the largest force.

    Root mean square. An error falls at least with the square of the size of cells and steps, so
    that it is at most a third of the distance from runs with both twice as large.
    """
    pairs = zip(full.comparisons, coarse.comparisons, strict=True)
    parts = [(a.force - b.force) / np.abs(a.measured).max() for a, b in pairs]
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)) / (COARSE[0] ** 2 - 1))
