"""What measured curves tell of parameters: intervals, correlations, and what stays unknown.

Everything follows from the residuals r (distances over the error of a force) at the solution and
their derivatives J by the scaled parameters q, which are logarithms where the search steps by
factors. The covariance of q is s^2 (J^T J)^-1 with s^2 = r^T r/(n - p), or 1 if that is less or
there are no more rows than parameters (Seber and Wild, Nonlinear Regression, 1989,
doi:10.1002/0471725315). Rows that the steps of the runs do
not resolve weigh less: n is the sum of squared weights. Intervals are wider by what the error of
cells and steps moves the parameters by: it is the same for all rows of a curve, so that more rows
do not reduce it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from wovenfab.case.specimen import bias_extension_of
from wovenfab.study.fit.fit_file import Fit, FitParameter, FittedTest, MeasuredTest
from wovenfab.study.fit.objective import weights
from wovenfab.study.fit.response import Comparison

Array = NDArray[np.float64]
#: Probability of intervals.
LEVEL = 0.95
#: Ratio of an interval's ends to its middle above which a parameter is not determined.
UNKNOWN = 3.0
#: Share of the largest singular value below which one is zero: there is no effect at all. Least
#: part of a parameter in the direction of such a value that counts.
LEAST, PART = 1e-6, 1e-3
#: Correlation from which two parameters are named together.
CORRELATED = 0.95
#: Part of an interval by cells and steps, over that by the scatter, from which it is said.
SAID = 0.1
#: Share of the bounds' range that counts as at a bound.
AT_BOUND = 1e-3
#: Signs that a curve keeps too long to be noise: probability of so few runs.
TOO_FEW_RUNS = 0.01


@dataclass(frozen=True)
class ConfidenceInterval:
    """A parameter with its interval.

    Attributes:
        name: As in the fit file.
        unit: SI unit.
        value, low, high: The value and the ends of its interval; infinite, or zero of a parameter
            that is found by factors, where nothing limits it.
        half: Half of the interval in scaled parameters, by the scatter alone.
        shift: What cells and steps add to it on each side.
        determined: Whether the curves determine it.
        at_bound: ``"lower"`` or ``"upper"`` where it is at that bound, else empty.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    half: float
    determined: bool
    at_bound: str = ""
    shift: float = 0.0


@dataclass(frozen=True)
class JointUncertainty:
    """How far the values of all parameters may be off together, to first order, in their units.

    Attributes:
        covariance: Of the values, without the combinations that no curve tells, shape (p, p).
        quantile: Half of an interval of 95 % over the standard deviation.
        shift: By how much cells and steps move the values, shape (p,).
        unseen: Changes of the values that no curve tells, one a row, shape (m, p): each by a factor
            of e, or by the range of the bounds of a parameter that is sought by differences.
    """

    covariance: Array
    quantile: float
    shift: Array
    unseen: Array


@dataclass(frozen=True)
class Misfit:
    """How well the model follows one curve; of figures and fields there is the misfit alone.

    Attributes:
        misfit: Root mean square of the distances over the largest measured force.
        noise: The same of the measured curve's scatter, from its second differences.
        runs, expected: Number of runs of the residual's sign, and that of random signs.
        probability: Of so few runs by chance.
        part_at: Displacement (m) of the first loading from which on the distance is more than twice
            the error of a force; None if it never is.
        angle: Shear angle there (rad), or at its end, if the test is a bias extension.
    """

    misfit: float
    noise: float = 0.0
    runs: int = 0
    expected: float = 0.0
    probability: float = 1.0
    part_at: float | None = None
    angle: float | None = None

    @property
    def is_model_error(self) -> bool:
        """Whether the distances are too regular for noise."""
        return self.probability < TOO_FEW_RUNS


@dataclass(frozen=True)
class Identifiability:
    """What is known after a fit.

    Attributes:
        intervals: Of each parameter.
        correlations: Of the scaled parameters, shape (p, p).
        joint: Of the values.
        singular_values: Of the derivatives of the residuals by the scaled parameters.
        directions: Right singular vectors, one a row: combinations of scaled parameters.
        scatter: s, the residuals' size over that of the stated errors.
        misfits: Of each test.
        bic: Bayesian information criterion n ln(r^T r/n) + p ln n (Schwarz, Ann. Statist. 6 (1978)
            461-464, doi:10.1214/aos/1176344136): of two models for the same curves, that with the
            smaller one is worth its parameters.
        points: Number of rows.
        unresolved: Of these, in each test, where the steps do not resolve the curve.
    """

    intervals: tuple[ConfidenceInterval, ...]
    correlations: Array
    joint: JointUncertainty
    singular_values: Array
    directions: Array
    scatter: float
    misfits: tuple[Misfit, ...]
    bic: float
    points: int
    unresolved: tuple[int, ...] = ()


def knowledge(
    fit: Fit,
    values: Mapping[str, float],
    residuals: Array,
    jacobian: Array,
    comparisons: Sequence[Comparison],
    shift: Array | None = None,
) -> Identifiability:
    """Return what the curves tell.

    Args:
        fit: The fit.
        values: Of the parameters, in SI units.
        residuals: Distances over the error of a force, shape (n,).
        jacobian: Their derivatives by the scaled parameters, shape (n, p).
        comparisons: What was compared, by test.
        shift: By how much cells and steps move the scaled parameters, shape (p,); None for
            nothing.
    """
    weight = weights(fit, comparisons)
    residuals, jacobian = weight * residuals, weight[:, None] * jacobian
    n, p = float((weight**2).sum()), jacobian.shape[1]
    moved = np.zeros(p) if shift is None else shift
    freedom = max(n - p, 1.0)
    scatter = max(float(np.sqrt(residuals @ residuals / freedom)), 1.0)
    rows = np.vstack([jacobian, np.zeros((max(p - len(jacobian), 0), p))])  # all directions
    _, singular, directions = np.linalg.svd(rows, full_matrices=False)
    seen = singular > LEAST * max(singular[0], 1e-300)
    inverse = np.where(seen, 1 / np.where(seen, singular, 1.0), np.inf)
    # A parameter with any part in an unseen direction has an infinite variance.
    with np.errstate(invalid="ignore"):
        parts = np.where(
            seen[:, None] | (np.abs(directions) > PART), directions * inverse[:, None], 0.0
        )
    deviation = scatter * np.sqrt((parts**2).sum(axis=0))
    finite = np.where(np.isfinite(parts), parts, 0.0)
    covariance = finite.T @ finite
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    # Without a row to spare nothing tells the scatter, and the stated errors are known.
    quantiles = stats.t(freedom) if n - p >= 1 else stats.norm
    factor = float(quantiles.ppf((1 + LEVEL) / 2))
    slopes = np.array([u.slope(values[u.name]) for u in fit.unknowns])
    joint = JointUncertainty(
        scatter**2 * covariance * np.outer(slopes, slopes),
        factor,
        moved * slopes,
        directions[~seen] * slopes,
    )
    intervals = tuple(
        _interval(u, values[u.name], factor * float(d), abs(float(more)))
        for u, d, more in zip(fit.unknowns, deviation, moved, strict=True)
    )
    return Identifiability(
        intervals,
        covariance / np.outer(size, size),
        joint,
        singular,
        directions,
        scatter,
        tuple(_misfit(t, c) for t, c in zip(fit.tests, comparisons, strict=True)),
        float(n * np.log(max(float(residuals @ residuals), 1e-300) / n) + p * np.log(n)),
        len(weight),
        tuple(int(np.count_nonzero(~c.resolved)) for c in comparisons),
    )


def _interval(
    unknown: FitParameter, value: float, scatter: float, shift: float
) -> ConfidenceInterval:
    low, high = unknown.bounds
    half = scatter + shift
    if unknown.by_factors:
        with np.errstate(over="ignore"):
            ends = value * np.exp(-half), value * np.exp(half)
        width, place = np.log(high / low), np.log(value / low)
        determined = half < np.log(UNKNOWN)
    else:
        width, place = high - low, value - low
        ends = value - half * width, value + half * width
        determined = half < 0.5
    share = place / width
    at = "lower" if share < AT_BOUND else "upper" if share > 1 - AT_BOUND else ""
    a, b = (float(e) for e in ends)
    known = bool(determined) and not at
    return ConfidenceInterval(unknown.name, unknown.unit, value, a, b, scatter, known, at, shift)


def _misfit(test: FittedTest, comparison: Comparison) -> Misfit:
    if not isinstance(test, MeasuredTest):
        return Misfit(comparison.misfit)
    counted = comparison.resolved
    measured, rows = comparison.measured[counted], comparison.rows[counted]
    distance = comparison.computed[counted] - measured
    peak = float(np.abs(comparison.measured).max())
    second = np.diff(measured, 2)
    noise = float(np.sqrt(np.mean(second**2) / 6)) if second.size else 0.0
    runs, expected, probability = sign_runs(distance)
    loading = rows <= test.measured.branches()[0][-1]
    near = np.flatnonzero((np.abs(distance) <= 2 * test.errors[rows])[loading])
    u = test.measured.displacement[rows[loading]]
    first = 0 if not near.size else int(near[-1]) + 1
    part_at = float(u[first]) if first < u.size else None
    angle, sample = np.nan, bias_extension_of(test.case)
    if sample is not None and u.size:
        end = float(u[-1]) if part_at is None else part_at
        angle = float(sample.angle_at(np.array(end)))
    return Misfit(
        comparison.misfit, noise / peak, runs, expected, probability,
        part_at, float(angle) if np.isfinite(angle) else None,
    )  # fmt: skip


def sign_runs(residuals: Array) -> tuple[int, float, float]:
    """Return the number of runs of the sign, the expected one, and the probability of so few.

    Wald and Wolfowitz, Ann. Math. Stat. 11 (1940) 147-162, doi:10.1214/aoms/1177731909, by the
    normal approximation.
    """
    signs = np.sign(residuals[residuals != 0])
    up, down = int((signs > 0).sum()), int((signs < 0).sum())
    if not up or not down:
        return 1, 1.0, 0.5 ** max(len(signs) - 1, 0)
    runs = 1 + int((signs[1:] != signs[:-1]).sum())
    n = up + down
    expected = 1 + 2 * up * down / n
    variance = (expected - 1) * (expected - 2) / (n - 1)
    z = (runs + 0.5 - expected) / np.sqrt(variance) if variance > 0 else 0.0
    return runs, expected, float(stats.norm.cdf(z))


def describe_identifiability(known: Identifiability, fit: Fit) -> list[str]:
    """Return sentences on what the curves tell and what they do not."""
    lines = []
    if any(i.shift > SAID * i.half for i in known.intervals):
        shares = (
            f"{i.name} {100 * i.shift / (i.shift + i.half):.0f} %"
            for i in known.intervals
            if isfinite(i.half) and i.shift > SAID * i.half
        )
        lines.append(
            "Intervals contain what cells and steps may move the parameters by, which makes of "
            f"them: {', '.join(shares)}. Smaller cells and steps make them narrower."
        )
    for unknown in fit.unknowns:
        if unknown.target is not None and unknown.target.relative:
            lines.append(
                f"{unknown.name} is the value of the first family; that of the second keeps its "
                "ratio to it as in the case."
            )
    for test, count in zip(fit.tests, known.unresolved, strict=True):
        if count and isinstance(test, MeasuredTest):
            lie = "1 row lies" if count == 1 else f"{count} rows lie"
            lines.append(
                f"{test.name}: {lie} in steps in which friction reverses: this tells only within "
                "such a step where that is. Smaller steps resolve more."
            )
    lines += describe_unknown(known)
    for test, f in zip(fit.tests, known.misfits, strict=True):
        angle = "" if f.angle is None else f" (shear angle {np.degrees(f.angle):.0f} degrees)"
        if f.part_at is not None:
            lines.append(
                f"{test.name}: the curves part at {1e3 * f.part_at:.3g} mm{angle}; "
                "from there on they differ by more than twice the error of a force."
            )
        elif angle:
            lines.append(f"{test.name}: the curves agree as far as they are compared{angle}.")
        if f.is_model_error:
            lines.append(
                f"{test.name}: the distance is {100 * f.misfit:.2f} % of the largest "
                f"force and keeps its sign too long for noise ({f.runs} runs, {f.expected:.0f} "
                f"expected; scatter {100 * f.noise:.2f} %): it is an error of the model, so that "
                "intervals are a lower bound."
            )
    return lines


def describe_unknown(known: Identifiability) -> list[str]:
    """Return sentences on the parameters that the curves do not determine, or only together."""
    lines = []
    for i in known.intervals:
        if i.at_bound:
            lines.append(
                f"{i.name} is at its {i.at_bound} bound ({i.value:.4g} {i.unit}): the curves ask "
                "for more, or it has no effect."
            )
        elif not i.determined and i.high > 1e6 * i.value:
            lines.append(f"The curves do not depend on {i.name}.")
        elif not i.determined:
            lines.append(
                f"The curves do not determine {i.name}: {i.low:.3g} to {i.high:.3g} {i.unit} fit "
                "as well. A test in which it does more work would."
            )
    names = [i.name for i in known.intervals]
    for a in range(len(names)):
        for b in range(a):
            r = float(known.correlations[a, b])
            if abs(r) > CORRELATED:
                lines.append(
                    f"{names[b]} and {names[a]} are determined only together (correlation "
                    f"{r:+.2f}): one may be larger if the other is "
                    f"{'larger' if r > 0 else 'smaller'}."
                )
    return lines
