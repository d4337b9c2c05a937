"""The search for parameters: least squares by trust regions and exact derivatives.

Most trials are coarse: their cells and steps are twice as large. A few fine runs correct them:
residuals and derivatives of later coarse runs get what the fine ones have more at the same values,
so that both agree there to first order. The search with corrected coarse runs converges to the
solution of the fine ones (Alexandrov and Lewis, Optimization and Engineering 2 (2001) 413-430,
doi:10.1023/A:1016042505922).

Rows that the steps of the runs do not resolve weigh less. Their weights are taken from a run and
kept until the next fine one, so that the sum of squares is smooth in between.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, isinf

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import least_squares

from wovenfab.study.errors.refinement import exponent
from wovenfab.study.fit.fit_file import Fit
from wovenfab.study.fit.identifiability import LEVEL
from wovenfab.study.fit.objective import DiscretisationCorrection, Evaluation, FitTrial, Objective
from wovenfab.study.fit.response import TrialError

Array = NDArray[np.float64]
#: Distance from the solution that ends the search: the part of the residuals that a linear step
#: would remove over the rest, each by its degrees of freedom (Bates and Watts, Technometrics 23
#: (1981) 179-183, doi:10.1080/00401706.1981.10486260). At 1 the solution is as far away as the
#: ends of a confidence region.
NEAR = 0.3
#: Linear step, in scaled parameters, that ends it in any case: curves without noise leave no rest.
LEAST_STEP = 3e-4
#: Relative change of the sum of squares that does, too: where parameters are known only together,
#: there is a valley of nearly the same sum.
CHANGE = 1e-3
#: Size of cells and steps of coarse runs over those of the cases, and of runs that are finer.
COARSE, FINER = 2.0, 0.7
#: Numbers of cells and steps of such runs over those of the cases.
COUNTS = 1 / COARSE, 1.0, 1 / FINER
#: Orders at which the error of cells and steps may fall: the first where friction begins between
#: two steps, the second where all is smooth.
ORDERS = 1.0, 2.0
#: Part of the misfit that the error by cells and steps may have.
SHARE = 0.1
#: Usual number of coarse and of fine trials.
USUAL = 10, 2
#: Places of a profile, over half of the interval by the covariance.
PROFILE = (0.5, 1.0, 1.5)
#: Largest number of fine trials; share of the trust region after one that got worse.
MOST_FINE, LESS = 6, 0.3
#: How often other rows may become comparable by the machine's parameters that were found.
MOST_ROWS = 3


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
        shift: By how much the scaled parameters would move without it, shape (p,).
        correction: Of coarse runs, there.
    """

    values: Mapping[str, float]
    evaluation: Evaluation
    trials: tuple[FitTrial, ...]
    scale: float
    converged: bool
    error: float
    shift: Array
    correction: DiscretisationCorrection


@dataclass(frozen=True)
class Profile:
    """The least sum of squares for fixed values of one parameter, all others found anew.

    Attributes:
        name: Of the parameter.
        values: In SI units, increasing.
        rise: Of the sum of squares over its least value, over that at the ends of an interval of
            95 %.
        low, high: These ends, wider by what cells and steps move the parameter by; infinite where
            the profile does not reach them.
    """

    name: str
    values: tuple[float, ...]
    rise: tuple[float, ...]
    low: float
    high: float

    def __str__(self) -> str:
        """Return in a sentence which values the profile allows."""
        if isinf(self.low) and isinf(self.high):
            return f"By its profile {self.name} may have any value."
        ends = [f"at least {self.low:.4g}"] * isfinite(self.low)
        ends += [f"at most {self.high:.4g}"] * isfinite(self.high)
        return f"By its profile {self.name} is {' and '.join(ends)} (95 %)."


def start_values(objective: Objective, fit: Fit) -> dict[str, float]:
    """Return where the search starts.

    Without inertia a sheet whose strengths and stiffnesses are all multiplied by a number carries
    forces multiplied by it. Parameters without a start of their own are those of the case times
    the number that brings its forces nearest to the measured ones.
    """
    values = {u.name: u.start for u in fit.unknowns}
    free = [u for u in fit.unknowns if u.scaled and "N" in u.unit]
    if not free:
        return values
    first = objective.attempt(values, COARSE)
    if first is None:
        return values
    upper = lower = 0.0
    for test, c in zip(fit.tests, first.comparisons, strict=True):
        if c.of_field:  # a field does not depend on the common size
            continue
        weighted = np.where(c.resolved, c.computed / test.errors[c.rows] ** 2, 0.0)
        upper += float(weighted @ c.measured)
        lower += float(weighted @ c.computed)
    factor = max(upper / lower, 1e-6) if lower else 1.0
    return values | {u.name: float(np.clip(u.start * factor, *u.bounds)) for u in free}


def search(objective: Objective, fit: Fit, near: Mapping[str, float] | None = None) -> Found:
    """Return the values of least squares; ``near`` are some that a search has found before.

    Raises:
        TrialError: No run came to its end at the start.
    """
    if near is None:
        values, coarse = _minimised(objective, fit, start_values(objective, fit))
    else:
        values, coarse = dict(near), _tried(objective, near, COARSE)
    best, scale, region = _tried(objective, values, 1.0), 1.0, 1.0
    error, shift = discretisation_error(fit, best, coarse)
    for _ in range(MOST_FINE):
        weights = best.weights(fit)
        correction = DiscretisationCorrection(objective.scaled(values), best, coarse, weights)
        if converged := _is_near(objective, values, best, weights):
            if not fit.refine or scale < 1 or not error > SHARE * best.misfit:
                break
            scale, as_said, best = FINER, best, _tried(objective, values, FINER)
            error, shift = discretisation_error(fit, as_said, coarse, best)
            continue
        other, beside = _minimised(objective, fit, values, correction, region=region)
        done = objective.attempt(other, scale)
        if done is None or _square(done, weights) > _square(best, weights):
            region *= LESS  # the correction does not hold so far away
            continue
        values, best, coarse = other, done, beside
        if scale == 1:
            error, shift = discretisation_error(fit, best, coarse)
    return Found(values, best, tuple(objective.trials), scale, converged, error, shift, correction)


def search_with_slack(objective: Objective, fit: Fit) -> Found:
    """Return the values of least squares for the rows that the program reaches with them.

    Raises:
        TrialError: No run came to its end at the start.
    """
    found = search(objective, fit)
    for _ in range(MOST_ROWS):
        if not objective.choose_rows(found.values, found.scale):
            break
        found = search(objective, fit, found.values)
    return found


def share_done(trials: Sequence[FitTrial], refine: bool) -> float:
    """Return the share of a search's time that is over, with the usual number of trials."""
    coarse, fine = ([t.seconds for t in trials if t.coarse == kind] for kind in (True, False))
    of_one = sum(coarse) / len(coarse) if coarse else 0.0
    of_fine = max(fine, default=COARSE**2 * of_one)  # by the number of cells
    usual = USUAL[1] + refine
    left = max(USUAL[0] - len(coarse), 1) * of_one + max(usual - len(fine), 0) * of_fine
    spent = sum(coarse) + sum(fine)
    return spent / (spent + left) if spent else 0.0


def _tried(objective: Objective, values: Mapping[str, float], scale: float) -> Evaluation:
    done = objective.attempt(values, scale)
    if done is None:
        raise TrialError(f"a run of the cases failed: {objective.trials[-1].failure}")
    return done


def _square(evaluation: Evaluation, weights: Array) -> float:
    return float(((weights * evaluation.residuals) ** 2).sum())


def _is_near(
    objective: Objective, values: Mapping[str, float], done: Evaluation, weights: Array
) -> bool:
    """Return whether values are near to those of least squares; those at a bound do not count."""
    q, (low, high) = objective.scaled(values), objective.bounds
    margin = 1e-6 * (high - low)
    jacobian = weights[:, None] * done.jacobian
    free = (q > low + margin) & (q < high - margin)
    return is_near(weights * done.residuals, jacobian[:, free])


def _minimised(
    objective: Objective,
    fit: Fit,
    start: Mapping[str, float],
    correction: DiscretisationCorrection | None = None,
    fixed: str = "",
    region: float = 1.0,
) -> tuple[dict[str, float], Evaluation]:
    """Return values of least squares by (corrected) coarse runs, and what these runs give there.

    ``fixed`` keeps its value; ``region`` is the first trust region, in scaled parameters.

    Raises:
        TrialError: The run at the start did not come to its end.
    """
    free = np.array([u.name != fixed for u in fit.unknowns])
    origin = objective.scaled(start)  # scipy's first trust region is 1 around zero

    def scaled_at(q: Array) -> Array:
        scaled = origin.copy()
        scaled[free] += q
        return scaled

    def coarse_at(q: Array) -> Evaluation | None:
        return objective.attempt(objective.values(scaled_at(q)), COARSE)

    low, high = ((bound - origin)[free] for bound in objective.bounds)
    margin = 1e-9 * (high - low)
    q = np.clip(np.zeros_like(low), low + margin, high - margin)
    if (first := coarse_at(q)) is None:
        raise TrialError(f"the run at the start failed: {objective.trials[-1].failure}")
    weights = first.weights(fit)
    known: list[Array] = []

    def at(q: Array) -> tuple[Array, Array] | None:
        if (done := coarse_at(q)) is None:
            return None
        if correction is not None:
            return correction.applied(done, scaled_at(q), free)
        return weights * done.residuals, (weights[:, None] * done.jacobian)[:, free]

    def residuals(q: Array) -> Array:
        if (done := at(q)) is not None:
            known.append(done[0])
            return done[0]
        return np.full_like(weights, np.abs(known).max())  # worse than any run: it is rejected

    def jacobian(q: Array) -> Array:
        done = at(q)
        assert done is not None
        if is_near(done[0], done[1][:, (q > low) & (q < high)]):
            raise _NearEnoughError(q)
        return done[1]

    try:
        if free.any():
            q = least_squares(
                residuals, q, jacobian, bounds=(low, high), x_scale=region,
                xtol=LEAST_STEP, ftol=CHANGE,
            ).x  # fmt: skip
    except _NearEnoughError as near:
        q = near.q
    done = coarse_at(q)
    if done is None:
        raise TrialError(objective.trials[-1].failure)
    return objective.values(scaled_at(q)), done


class _NearEnoughError(Exception):
    """Ends the search where its linear steps change nothing of weight."""

    def __init__(self, q: Array) -> None:
        super().__init__()
        self.q = q


def profile(objective: Objective, fit: Fit, found: Found, name: str, half: float) -> Profile:
    """Return the profile of the sum of squares over one parameter, by corrected coarse runs.

    ``half`` is half of the parameter's interval by the covariance, scaled.
    """
    place = next(k for k, u in enumerate(fit.unknowns) if u.name == name)
    unknown, all_free = fit.unknowns[place], np.ones(len(fit.unknowns), dtype=bool)
    low, high = objective.bounds
    middle = float(objective.scaled(found.values)[place])
    weights = found.correction.weights
    squares = {middle: _square(found.evaluation, weights)}
    for side in (-1, 1):
        values = dict(found.values)
        for share in PROFILE:
            at = float(np.clip(middle + side * share * half, low[place], high[place]))
            if at in squares:
                break
            scaled = objective.scaled(values)
            scaled[place] = at
            try:
                start = objective.values(scaled)
                values, done = _minimised(objective, fit, start, found.correction, name)
            except TrialError:
                break
            scaled = objective.scaled(values)
            residuals, _ = found.correction.applied(done, scaled, all_free)
            squares[at] = float(residuals @ residuals)
    order = sorted(squares)

    def value(scaled: float) -> float:
        return float(np.exp(scaled) if unknown.by_factors else scaled * np.ptp(unknown.bounds))

    points = [value(at) for at in order]
    rise = np.array([squares[at] for at in order]) - squares[middle]
    n, p = float((weights**2).sum()), len(fit.unknowns)
    variance = max(squares[middle] / max(n - p, 1), 1.0)
    limit = variance * float(stats.f.ppf(LEVEL, 1, max(n - p, 1)))
    root = np.sqrt(np.maximum(rise, 0) / limit) * np.sign(np.array(order) - middle)
    steps = np.maximum.accumulate(root)
    ends = (float(np.interp(z, steps, order, -np.inf, np.inf)) for z in (-1, 1))
    lowest, highest = (
        value(end + side * abs(float(found.shift[place]))) if isfinite(end) else end
        for side, end in zip((-1, 1), ends, strict=True)
    )
    return Profile(name, tuple(points), tuple(map(float, rise / limit)), lowest, highest)


def is_near(residuals: Array, jacobian: Array) -> bool:
    """Return whether the solution is near: by the relative offset, or by the linear step.

    Args:
        residuals: Shape (n,); the offset needs more than p of them.
        jacobian: Their derivatives by the scaled parameters that may move, shape (n, p).
    """
    n, p = jacobian.shape
    if not p or (n > p and offset(residuals, jacobian) <= NEAR):
        return True
    step = np.linalg.lstsq(jacobian, residuals, rcond=1e-6)[0]
    return bool(np.abs(step).max() <= LEAST_STEP)


def offset(residuals: Array, jacobian: Array) -> float:
    """Return the relative offset of Bates and Watts of n residuals by p < n parameters."""
    n, p = jacobian.shape
    basis, _ = np.linalg.qr(jacobian)
    along = basis.T @ residuals
    rest = residuals @ residuals - along @ along
    return float(np.sqrt((along @ along / p) / max(float(rest) / (n - p), 1e-300)))


def discretisation_error(
    fit: Fit, as_said: Evaluation, coarse: Evaluation, finer: Evaluation | None = None
) -> tuple[float, Array]:
    """Return the estimated error by cells and steps, and by how much it moves scaled parameters.

    The error is the root mean square over the largest force, of rows that all runs resolve. It has
    its sign along the curve: what it moves parameters by is its least-squares solution. Three sizes
    tell the order at which it falls, two of them only the distance: the order is then taken as the
    lowest. Nan and zeros where files give cells and steps, so that nothing changes.

    Args:
        fit: The fit.
        as_said: Runs of the cases.
        coarse: Coarse runs with the same values.
        finer: Finer ones, whose error is wanted; None for that of the runs of the cases.
    """
    best = as_said if finer is None else finer
    rows = as_said.resolved & coarse.resolved & best.resolved
    counted = rows & as_said.counted
    larger = _distance(as_said, coarse, counted)
    if not larger:
        return np.nan, np.zeros(best.jacobian.shape[1])
    if finer is None:
        less, factor = coarse, float(COARSE ** ORDERS[0] - 1)
    else:
        change = larger / _distance(finer, as_said, counted)
        order = exponent(COUNTS, change, fastest=ORDERS[1], slowest=ORDERS[0])
        less, factor = as_said, float(FINER**-order - 1)
    weights = best.weights(fit)
    moved = np.where(rows, weights * (best.residuals - less.residuals) / factor, 0.0)
    shift = np.linalg.lstsq(weights[:, None] * best.jacobian, moved, rcond=1e-6)[0]
    return _distance(best, less, counted) / factor, np.asarray(-shift)


def _distance(a: Evaluation, b: Evaluation, rows: NDArray[np.bool_]) -> float:
    """Return the root mean square distance of two computed curves over the largest force.

    That of figures is over each measured one.
    """
    pairs = zip(a.comparisons, b.comparisons, strict=True)
    parts = [(x.computed - y.computed) / x.size for x, y in pairs]
    return float(np.sqrt(np.mean(np.concatenate(parts)[rows] ** 2)))
