"""The search for parameters: least squares by trust regions and exact derivatives.

Most trials are coarse: their cells and steps are twice as large. A few fine runs correct them:
residuals and derivatives of later coarse runs get what the fine ones have more at the same values,
so that both agree there to first order. The search with corrected coarse runs converges to the
solution of the fine ones (Alexandrov and Lewis, Optimization and Engineering 2 (2001) 413-430,
doi:10.1023/A:1016042505922).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from wovenfab.study.fit.fit_file import Fit
from wovenfab.study.fit.objective import Evaluation, Objective, Trial
from wovenfab.study.fit.response import TrialError

Array = NDArray[np.float64]
#: Changes of the parameters and slopes that end a search with coarse runs in any case.
TOLERANCES = {"xtol": 1e-4, "gtol": 1e-8}
#: Relative change of the sum of squares that ends a first one, and one with corrected runs.
CHANGE = 0.1, 1e-3
#: Distance from the solution that ends the search: the part of the residuals that a linear step
#: would remove over the rest, each by its degrees of freedom (Bates and Watts, Technometrics 23
#: (1981) 179-183, doi:10.1080/00401706.1981.10486260). At 1 the solution is as far away as the
#: ends of a confidence region.
NEAR = 0.3
#: The same for the first search, with coarse runs that are not corrected yet.
FIRST_NEAR = 1.0
#: Linear step, in scaled parameters, that ends it in any case: curves without noise leave no rest.
LEAST_STEP = 3e-4
#: First trust region of a search with coarse runs, in scaled parameters: by factors of 3, and of
#: 1.35 once they are corrected. Share of it after fine runs that got worse.
REGION, LESS = (1.1, 0.3), 0.3
#: Size of cells and steps of coarse runs over those of the cases, and of runs that are finer.
COARSE, FINER = 2.0, 0.7
#: Orders at which the error of cells and steps may fall: the first where friction begins between
#: two steps, the second where all is smooth.
ORDERS = 1.0, 2.0
#: Part of the misfit that the error by cells and steps may have.
SHARE = 0.1
#: Residual of a run that failed, over the largest one before.
FAILED = 10.0
#: Largest number of coarse trials of one search, and of fine trials in all.
MOST_COARSE, MOST_FINE = 40, 6


@dataclass(frozen=True)
class Found:
    """What the search has found.

    Attributes:
        values: Of the parameters, in SI units.
        evaluation: There, by fine runs.
        trials: All that were tried.
        scale: Size of cells and steps of the fine runs over those of the cases.
        converged: Whether the search ended by itself.
        error: Estimated error of the fine runs' curves by cells and steps, over the largest force;
            nan where files give them.
    """

    values: Mapping[str, float]
    evaluation: Evaluation
    trials: tuple[Trial, ...]
    scale: float
    converged: bool
    error: float


@dataclass(frozen=True)
class Correction:
    """What fine runs have more than coarse ones.

    Attributes:
        at: Scaled parameters where both were run, shape (p,).
        residuals: Fine less coarse residuals, shape (n,).
        jacobian: Fine less coarse derivatives, shape (n, p).
    """

    at: Array
    residuals: Array
    jacobian: Array


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
    first = objective.attempt(values, COARSE)
    if first is None:
        return values
    pairs = list(zip(fit.tests, first.comparisons, strict=True))
    upper = sum(float(c.force @ c.measured) / t.error**2 for t, c in pairs)
    lower = sum(float(c.force @ c.force) / t.error**2 for t, c in pairs)
    factor = max(upper / lower, 1e-6) if lower else 1.0
    return values | {u.name: float(np.clip(u.start * factor, *u.bounds)) for u in free}


def search(objective: Objective, fit: Fit) -> Found:
    """Return the values of least squares.

    Raises:
        TrialError: No run came to its end at the start.
    """
    values, coarse = _minimised(objective, fit, start_values(objective, fit), REGION[0])
    best, scale, region = _tried(objective, values, 1.0), 1.0, REGION[1]
    error = _error(best, coarse)
    for _ in range(MOST_FINE):
        correction = _correction(objective, values, best, coarse)
        if near := _is_near(objective, fit, values, best):
            if not fit.refine or scale < 1 or not error > SHARE * best.misfit:
                break
            scale, as_said, best = FINER, best, _tried(objective, values, FINER)
            error = _error(as_said, coarse, best)
            continue
        other, beside = _minimised(objective, fit, values, region, correction)
        done = objective.attempt(other, scale)
        if done is None or _square(done) > _square(best):
            region *= LESS
            continue
        values, best, coarse = other, done, beside
        if scale == 1:
            error = _error(best, coarse)
    return Found(values, best, tuple(objective.trials), scale, near, error)


def _tried(objective: Objective, values: Mapping[str, float], scale: float) -> Evaluation:
    done = objective.attempt(values, scale)
    if done is None:
        raise TrialError(f"a run of the cases failed: {objective.trials[-1].failure}")
    return done


def _square(evaluation: Evaluation) -> float:
    return float(evaluation.residuals @ evaluation.residuals)


def _is_near(objective: Objective, fit: Fit, values: Mapping[str, float], done: Evaluation) -> bool:
    """Return whether values are near to those of least squares; those at a bound do not count."""
    q = objective.scaled(values)
    low, high = (objective.scaled({u.name: u.bounds[k] for u in fit.unknowns}) for k in (0, 1))
    margin = 1e-6 * (high - low)
    return is_near(done.residuals, done.jacobian[:, (q > low + margin) & (q < high - margin)])


def _correction(
    objective: Objective, values: Mapping[str, float], fine: Evaluation, coarse: Evaluation
) -> Correction:
    return Correction(
        objective.scaled(values),
        fine.residuals - coarse.residuals,
        fine.jacobian - coarse.jacobian,
    )


def _minimised(
    objective: Objective,
    fit: Fit,
    start: Mapping[str, float],
    region: float,
    correction: Correction | None = None,
) -> tuple[dict[str, float], Evaluation]:
    """Return values of least squares by coarse runs, and what these runs give there.

    Args:
        objective: Evaluates residuals and derivatives.
        fit: The fit.
        start: Values to start from.
        region: First trust region, in scaled parameters.
        correction: Of the coarse runs.

    Raises:
        TrialError: The run at the start did not come to its end.
    """
    origin = objective.scaled(start)  # scipy's first trust region is 1 around zero

    def coarse_at(q: Array) -> Evaluation | None:
        return objective.attempt(objective.values(origin + region * q), COARSE)

    def at(q: Array) -> tuple[Array, Array] | None:
        if (done := coarse_at(q)) is None:
            return None
        if correction is None:
            return done.residuals, done.jacobian
        away = origin + region * q - correction.at
        residuals = done.residuals + correction.residuals + correction.jacobian @ away
        return residuals, done.jacobian + correction.jacobian

    known: list[Array] = []

    def residuals(q: Array) -> Array:
        if (done := at(q)) is not None:
            known.append(done[0])
            return done[0]
        if not known:
            raise TrialError(f"the run at the start failed: {objective.trials[-1].failure}")
        worst = max(float(np.abs(one).max()) for one in known)
        return np.full_like(known[0], FAILED * worst)  # a trial that is rejected

    def jacobian(q: Array) -> Array:
        done = at(q)
        assert done is not None
        near = NEAR if correction else FIRST_NEAR
        if is_near(done[0], done[1][:, (q > low) & (q < high)], near):
            raise _NearEnoughError(q)
        return region * done[1]

    low, high = (
        (objective.scaled({u.name: u.bounds[side] for u in fit.unknowns}) - origin) / region
        for side in (0, 1)
    )
    margin = 1e-9 * (high - low)
    inside = np.clip(np.zeros_like(origin), low + margin, high - margin)
    try:
        q = least_squares(
            residuals, inside, jacobian, bounds=(low, high), max_nfev=MOST_COARSE,
            ftol=CHANGE[1 if correction else 0], **TOLERANCES,
        ).x  # fmt: skip
    except _NearEnoughError as near:
        q = near.q
    done = coarse_at(q)
    assert done is not None
    return objective.values(origin + region * q), done


class _NearEnoughError(Exception):
    """Ends the search where its linear steps change nothing of weight."""

    def __init__(self, q: Array) -> None:
        super().__init__()
        self.q = q


def is_near(residuals: Array, jacobian: Array, near: float = NEAR) -> bool:
    """Return whether the solution is near: by the relative offset, or by the linear step.

    Args:
        residuals: Shape (n,).
        jacobian: Their derivatives by the scaled parameters that may move, shape (n, p).
        near: Relative offset that is near.
    """
    if offset(residuals, jacobian) <= near:
        return True
    step = np.linalg.lstsq(jacobian, residuals, rcond=1e-6)[0]
    return bool(np.abs(step).max() <= LEAST_STEP)


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


def _error(as_said: Evaluation, coarse: Evaluation, finer: Evaluation | None = None) -> float:
    """Return the estimated error by cells and steps, root mean square over the largest force.

    Three sizes tell the order at which it falls, two of them only the distance: the order is then
    taken as the lowest. Nan where files give cells and steps, so that nothing changes.

    Args:
        as_said: Runs of the cases.
        coarse: Coarse runs with the same values.
        finer: Finer ones, whose error is wanted; None for that of the runs of the cases.
    """
    larger = _distance(as_said, coarse)
    if not larger:
        return np.nan
    if finer is None:
        return larger / float(COARSE ** ORDERS[0] - 1)
    orders = np.linspace(*ORDERS, 101)
    ratios = (COARSE**orders - 1) / (1 - FINER**orders)
    order = float(np.interp(larger / _distance(finer, as_said), ratios, orders))
    return _distance(finer, as_said) / float(FINER**-order - 1)


def _distance(a: Evaluation, b: Evaluation) -> float:
    """Return the root mean square distance of two computed curves over the largest force."""
    pairs = zip(a.comparisons, b.comparisons, strict=True)
    parts = [(x.force - y.force) / np.abs(x.measured).max() for x, y in pairs]
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
