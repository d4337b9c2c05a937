"""The band of a prediction: what a fit leaves open of its parameters, carried to another test.

To first order the parameters change a force by g dp, with g its derivatives, so that its variance
is g C g^T with the covariance C of the values that were found (Seber and Wild, Nonlinear
Regression, 1989, doi:10.1002/0471725315). Parameters that are determined only together add little
to a force that depends on them in the same combination. What cells and steps of the fit move the
values by, s, has its sign: it adds |g s| on both sides. Parameters of the machine have no
derivative: the band is then that of the other ones, whatever the machine's are.

The band holds what is not known of the parameters, neither an error of the model nor the scatter
of a new measurement.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isclose
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic_core import PydanticCustomError

from wovenfab.case import Case, CaseError, case_error
from wovenfab.case.errors import reason
from wovenfab.forms.effect import Target
from wovenfab.measured.curve import Measured
from wovenfab.record.history import index_of_peak
from wovenfab.study.effects import by_factor
from wovenfab.study.fit.fit_file import MACHINE_NAME, meaning_of, target_of, with_value
from wovenfab.study.fit.identifiability import JointUncertainty
from wovenfab.study.fit.response import BranchError, compared, curve_of_history
from wovenfab.study.fit.result import RESULT

Array = NDArray[np.float64]
#: Share of the largest force or energy that a change which no curve tells may make.
UNSEEN = 1e-3
#: Change of a parameter over its value from which derivatives do not reach to the band's ends.
FAR = 0.5
#: Columns with a band: of the value, of its derivatives, of the lower and the upper end.
QUANTITIES = {
    "force_N": ("d_force/d_", "force_low_N", "force_high_N"),
    "dissipated_J": ("d_dissipated/d_", "dissipated_low_J", "dissipated_high_J"),
}
#: Share of its variances by which a covariance may be asymmetric, or negative in a direction.
DAMAGED = 1e-6


@dataclass(frozen=True)
class FittedValues:
    """What a fit has found.

    Attributes:
        file: Where it is from.
        values: Of the parameters by name, in their units.
        at_bounds: Names of those at a bound.
        joint: How far they may be off together.
    """

    file: Path
    values: Mapping[str, float]
    at_bounds: tuple[str, ...]
    joint: JointUncertainty


@dataclass(frozen=True)
class FittedCase:
    """A case with the values of a fit.

    Attributes:
        case: It has these values.
        fitted: The fit.
        targets: The parameters by which it is differentiated, by their names in the fit.
        replaced: In words, what the case had before where it was something else.
    """

    case: Case
    fitted: FittedValues
    targets: Mapping[str, Target]
    replaced: tuple[str, ...]

    def slopes(self, columns: Mapping[str, Sequence[float]], prefix: str) -> Array:
        """Return derivatives by all parameters of the fit, in their units, shape (steps, p)."""
        fitted = self.fitted.values
        zero: Array = np.zeros(len(columns["time_s"]))
        found: list[Array] = []
        for name, value in fitted.items():
            if (target := self.targets.get(name)) is None:
                found.append(zero)
                continue
            slope = np.asarray(columns[f"{prefix}{target}"], dtype=float)
            found.append(slope / value if target.relative else slope)
        return np.stack(found, axis=1)


def read_fitted(path: Path) -> FittedValues:
    """Return what a fit has found, of its ``fit.json`` or of the folder that has it.

    Raises:
        CaseError: If there is none, or it is not one.
    """
    file = path / RESULT if path.is_dir() else path
    remedy = f"Give the {RESULT} that 'wovenfab fit' has written."
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise case_error(str(file), f"cannot be read: {error.strerror}", remedy) from error
    except (ValueError, RecursionError) as error:
        raise case_error(str(file), "is not the result of a fit", remedy) from error
    try:
        parameters, joint = data["parameters"], data["joint"]
        values = {str(name): float(one["value"]) for name, one in parameters.items()}
        bounds = tuple(name for name, one in parameters.items() if one["at_bound"])
        p = len(values)
        known = JointUncertainty(
            np.array(joint["covariance"], dtype=float).reshape(p, p),
            float(joint["quantile"]),
            np.array(joint["shift"], dtype=float).reshape(p),
            np.array(joint["unseen"], dtype=float).reshape(-1, p),
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        message = "does not tell how far its parameters may be off together"
        raise case_error(str(file), message, f"{remedy} Repeat a fit of before.") from error
    if not _is_possible(known):
        message = "has a covariance, a quantile or changes that no fit gives: it is damaged"
        raise case_error(str(file), message, f"{remedy} Repeat the fit.")
    return FittedValues(file, values, bounds, known)


def _is_possible(joint: JointUncertainty) -> bool:
    """Return whether all numbers are finite, and no variance is negative in any direction."""
    numbers = (joint.covariance, joint.quantile, joint.shift, joint.unseen)
    if not all(np.isfinite(part).all() for part in numbers) or joint.quantile <= 0:
        return False
    variances = np.diag(joint.covariance)
    sizes = np.sqrt(np.where(variances > 0, variances, 1.0))  # units differ by many powers of ten
    scaled = joint.covariance / np.outer(sizes, sizes)
    alike = np.abs(scaled - scaled.T).max(initial=0.0) < DAMAGED
    return bool(alike and np.linalg.eigvalsh(scaled).min(initial=0.0) > -DAMAGED)


def fitted_case(case: Case, fitted: FittedValues) -> FittedCase:
    """Return a case with the values of a fit, and by what it is to be differentiated.

    Raises:
        CaseError: It lacks an effect or parameter of the fit, or has a value out of range.
    """
    changed, problems, replaced = case, [], []
    targets: dict[str, Target] = {}
    for name, value in fitted.values.items():
        if name.partition(".")[0] == MACHINE_NAME:
            continue
        try:
            target = target_of(name, case)
            unit, before, _ = meaning_of(target, case)
        except PydanticCustomError as error:
            message, remedy = reason(error)
            problems.append(case.problem("effects", f"for {name} of the fit: {message}", remedy))
            continue
        changed = with_value(changed, target, value, unit)
        targets[name] = target
        if not isclose(before, value):  # but for round-off in files
            replaced.append(f"{name}: {value:.5g} {unit} of the fit in place of {before:.5g}")
    if problems:
        raise CaseError(problems)
    if not targets:
        message = "has parameters of the machine alone: nothing of it concerns another test"
        raise case_error(str(fitted.file), message)
    targets = {name: by_factor(target, changed) for name, target in targets.items()}
    return FittedCase(changed, fitted, targets, tuple(replaced))


def with_band(columns: Mapping[str, Sequence[float]], made: FittedCase) -> dict[str, list[float]]:
    """Return columns of sensitivities with the ends of the bands of 95 %.

    They are infinite where the case depends on what no curve of the fit tells.

    Args:
        columns: Of ``study.effects.sensitivities`` by the targets of the prediction.
        made: The prediction.
    """
    result = {name: [*column] for name, column in columns.items()}
    for name, (prefix, low, high) in QUANTITIES.items():
        values: Array = np.asarray(columns[name])
        half = half_width(made.slopes(columns, prefix), values, made.fitted.joint)
        result |= {low: [*map(float, values - half)], high: [*map(float, values + half)]}
    return result


def half_width(slopes: Array, values: Array, joint: JointUncertainty) -> Array:
    """Return half of the width of a band of 95 %, shape (n,).

    Args:
        slopes: Derivatives by the parameters of a fit, shape (n, p).
        values: What is predicted, shape (n,).
        joint: Of the fit.

    Returns:
        Infinite where a change that no curve of the fit tells would change the values by more than
        a thousandth of the largest one.
    """
    variance = np.einsum("np,pq,nq->n", slopes, joint.covariance, slopes)
    half = joint.quantile * np.sqrt(np.maximum(variance, 0.0)) + np.abs(slopes @ joint.shift)
    limit = UNSEEN * np.abs(values).max(initial=0.0)
    return np.where((np.abs(slopes @ joint.unseen.T) > limit).any(axis=1), np.inf, half)


def describe_prediction(columns: Mapping[str, Sequence[float]], made: FittedCase) -> list[str]:
    """Return sentences on the band: its half at the largest force, of the energy, and its limits.

    Args:
        columns: With their bands.
        made: The prediction.
    """
    fitted, lines = made.fitted, []
    force, energy = (np.asarray(columns[name]) for name in QUANTITIES)
    places = {"force_N": index_of_peak(force), "dissipated_J": int(np.abs(energy).argmax())}
    for name, (prefix, low, high) in QUANTITIES.items():
        at = places[name]
        value, unit = float(columns[name][at]), name[-1]
        half = (columns[high][at] - columns[low][at]) / 2
        what = "the largest force" if unit == "N" else "the dissipated energy"
        if not value:
            continue
        moved = 1e3 * columns["displacement_m"][at]
        if not np.isfinite(half):
            lines.append(f"At {moved:.4g} mm no band follows for {what}, {value:.4g} {unit}.")
            continue
        lines.append(
            f"At {moved:.4g} mm {what} is {value:.4g} +- {half:.2g} {unit} (95 %), "
            f"{100 * half / abs(value):.2g} % of it."
        )
        slope = made.slopes(columns, prefix)[at]
        lines += _too_far(slope, fitted, what)
    if not np.isfinite([columns[end] for _, *ends in QUANTITIES.values() for end in ends]).all():
        lines.append(
            f"The case depends on what the curves of {fitted.file} do not tell. Fit a test in "
            "which it does more work, too, or give it by hand and leave it out of the fit."
        )
    if machine := [name for name in fitted.values if name not in made.targets]:
        lines.append(
            f"{', '.join(machine)}: of the machine, not of the case. The band is that of the other "
            "parameters, whatever these are."
        )
    if fitted.at_bounds:
        lines.append(f"At a bound in the fit, and taken as free: {', '.join(fitted.at_bounds)}.")
    lines.append(
        "The band has what the fit leaves open of its parameters, neither errors of the model nor "
        "the scatter of a new measurement."
    )
    return lines


def measured_beside(columns: Mapping[str, Sequence[float]], measured: Measured) -> str:
    """Return in a sentence how many measured forces lie within the band, and how far they are.

    Args:
        columns: With their bands.
        measured: A measured curve of the test that is predicted.
    """
    u, name = np.asarray(columns["displacement_m"]), measured.file.name
    band = [np.asarray(columns[end]) for end in QUANTITIES["force_N"][1:]]
    try:
        found, low, high = (
            compared(measured, curve_of_history(u, np.nan_to_num(np.asarray(force))))
            for force in (columns["force_N"], *band)
        )
    except BranchError as error:
        return f"{name} is not compared with the band: {error}"
    within = (low.computed <= found.measured) & (found.measured <= high.computed)
    left_out = f"; {found.left_out}" if found.left_out else ""
    return (
        f"{name}: {np.count_nonzero(within)} of {within.size} measured forces lie within the band, "
        f"the distance is {100 * found.misfit:.2f} % of the largest force{left_out}."
    )


def _too_far(slope: Array, fitted: FittedValues, what: str) -> list[str]:
    """Return a sentence if the parameters at the ends of a band are far from those of the fit."""
    along = fitted.joint.covariance @ slope
    deviation = float(np.sqrt(max(float(slope @ along), 0.0)))
    if not deviation:
        return []
    move = fitted.joint.quantile * along / deviation  # the likeliest change that leads there
    pairs = zip(fitted.values.items(), move, strict=True)
    far = [
        f"{name} by {100 * abs(change / value):.0f} %"
        for (name, value), change in pairs
        if value and abs(change) > FAR * abs(value)
    ]
    if not far:
        return []
    return [
        f"The ends of the band of {what} change {', '.join(far)}: derivatives do not reach so far, "
        "and the band tells no more than that little is known."
    ]
