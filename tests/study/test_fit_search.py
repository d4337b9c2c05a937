"""The search for parameters, with curves in closed form: its ends, its cost, its estimates."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.study.test_fit_machine import SPAN, UNKNOWNS, fit_to
from wovenfab.forms.effect import Target
from wovenfab.measured.curve import Measured
from wovenfab.study.fit.fit_file import Fit, FitParameter
from wovenfab.study.fit.identifiability import knowledge
from wovenfab.study.fit.objective import Objective
from wovenfab.study.fit.response import ResponseCurve, TrialError
from wovenfab.study.fit.search import Found, offset, profile, search, share_done

Array = NDArray[np.float64]
SHEAR, STRETCH = "shear.stiffness", "stretch.stiffness"
START = {SHEAR: 60.0, STRETCH: 300.0}
TWO = (
    replace(UNKNOWNS[0], bounds=(1, 1e4)),
    FitParameter(
        STRETCH, "N/m", Target("stretch", "stiffness"), START[STRETCH], False, (1, 1e5), True
    ),
)


@dataclass(frozen=True)
class Cells:
    """A stiffening spring in series with a linear one, and the error by cells.

    Attributes:
        size: Share by which the stiffnesses are too large.
        order: At which this falls.
        stiffening: Of the first spring, 1/m^2.
    """

    size: float
    order: float = 2.0
    stiffening: float = 2e4

    def force(
        self, u: Array, shear: complex, stretch: complex, scale: float
    ) -> NDArray[np.complex128]:
        """Return the force."""
        error = self.size * scale**self.order
        s = shear * (1 + error * (1 + 0.3 * np.log(stretch / shear)))
        k = stretch * (1 + 0.5 * error)
        x = u * k / (k + s) + 0j
        for _ in range(60):
            x = x - (x + s * (x + self.stiffening * x**3) / k - u) / (
                1 + s * (1 + 3 * self.stiffening * x**2) / k
            )
        return np.asarray(s * (x + self.stiffening * x**3))

    def curve(self, values: Mapping[str, float], scale: float = 1.0) -> ResponseCurve:
        """Return force and derivatives, by complex steps."""
        u = np.linspace(0, SPAN, round(20 / scale) + 1)
        at = np.array([values[SHEAR], values[STRETCH]])
        ways = at + 1e-30j * np.eye(2)
        slopes = [self.force(u, *way, scale).imag / 1e-30 for way in ways]
        force = self.force(u, *at, scale).real
        return ResponseCurve(u, force, 0 * u, np.stack(slopes, axis=1), (0, len(u) - 1), 0.0)


class Springs(Objective):
    """Runs in closed form, of which those with too large a stiffness fail."""

    cells = Cells(0.05)
    most: Mapping[str, float] = dict.fromkeys(START, np.inf)

    def _curves(self, values: Mapping[str, float], scale: float) -> list[ResponseCurve]:
        if any(values[name] > most for name, most in self.most.items()):
            raise TrialError("no convergence")
        return [self.cells.curve(values, scale)]


def fit_of(curve: ResponseCurve, noise: float, generator: np.random.Generator) -> Fit:
    """Return the fit to a curve with noise (of the largest force)."""
    largest = float(curve.force.max())
    force = curve.force + noise * largest * generator.standard_normal(curve.force.size)
    fit = fit_to(Measured(Path("twin.csv"), curve.displacement, force, None))
    test = replace(fit.tests[0], error=max(noise, 0.002) * largest)
    return replace(fit, unknowns=TWO, tests=(test,))


@dataclass(frozen=True)
class Searched:
    """A search for known parameters."""

    found: Found
    truth: Mapping[str, float]
    fit: Fit

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of coarse and of fine runs."""
        coarse = sum(trial.coarse for trial in self.found.trials)
        return coarse, len(self.found.trials) - coarse

    @property
    def error(self) -> float:
        """Largest error of a parameter."""
        return max(abs(np.log(self.found.values[n] / v)) for n, v in self.truth.items())

    @property
    def offset(self) -> float:
        """Of the relative offset, at the end."""
        e = self.found.evaluation
        weights = e.weights(self.fit)
        return offset(weights * e.residuals, weights[:, None] * e.jacobian)


def searches(
    folder: Path, noise: float, cells: Cells = Springs.cells, most: float = np.inf, count: int = 20
) -> Iterator[Searched]:
    """Yield searches for parameters up to five times as large or small as the first ones.

    Runs fail from ``most`` times the right stiffness on, but not near the first ones.
    """
    generator = np.random.default_rng(5)
    for _ in range(count):
        factors = np.exp(generator.uniform(-1.5, 1.5, 2))
        truth = {n: v * float(f) for (n, v), f in zip(START.items(), factors, strict=True)}
        fit = fit_of(cells.curve(truth), noise, generator)
        with Springs(fit, folder) as objective:
            objective.cells = cells
            objective.most = {n: max(most * truth[n], 1.5 * START[n]) for n in truth}
            yield Searched(search(objective, fit), truth, fit)


def test_parameters_of_exact_curves_are_found_to_a_thousandth_with_three_fine_runs(
    tmp_path: Path,
) -> None:
    made = [*searches(tmp_path, 0.0)]
    assert all(one.found.converged for one in made)
    assert max(one.error for one in made) < 1e-3
    coarse, fine = np.mean([one.counts for one in made], axis=0)
    assert coarse < 11
    assert fine < 3.1


def test_of_noisy_curves_the_search_ends_well_within_the_confidence_region(tmp_path: Path) -> None:
    made = [*searches(tmp_path, 0.01)]
    assert all(one.found.converged for one in made)
    assert max(one.offset for one in made) < 0.35
    coarse, fine = np.mean([one.counts for one in made], axis=0)
    assert coarse < 9
    assert fine < 2.5


def test_a_search_does_not_wander_along_a_valley_and_follows_one_that_falls(tmp_path: Path) -> None:
    """The less a spring stiffens, the less a curve tells of more than the sum of compliances."""
    unknown, hardly_known = (
        [*searches(tmp_path, noise, Cells(0.05, stiffening=stiffening), count=8)]
        for noise, stiffening in ((0.01, 20.0), (0.002, 200.0))
    )
    assert np.mean([one.counts[0] for one in unknown]) < 60
    assert all(one.found.converged for one in hardly_known)


def test_runs_that_fail_on_the_way_are_rejected_and_the_search_goes_on(tmp_path: Path) -> None:
    made = [*searches(tmp_path, 0.0, most=1.2, count=30)]
    failed = [any(trial.failure for trial in one.found.trials) for one in made]
    assert sum(failed) >= 3
    assert all(one.found.converged for one in made)
    assert max(one.error for one in made) < 1e-3


def test_a_search_whose_runs_all_fail_says_so(tmp_path: Path) -> None:
    fit = fit_of(Springs.cells.curve(START), 0.0, np.random.default_rng(5))
    with Springs(fit, tmp_path) as objective:
        objective.most = dict.fromkeys(START, 0.0)
        with pytest.raises(TrialError, match="no convergence"):
            search(objective, fit)


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0])
def test_the_error_by_cells_of_refined_runs_is_the_true_one(order: float, tmp_path: Path) -> None:
    for refine in (False, True):
        said, true = errors_by_cells(Cells(0.05, order), tmp_path, refine)
        if refine:
            assert said == pytest.approx(true, rel=0.1)
        else:  # two sizes do not tell the order: the lowest is safe
            assert 0.9 * true < said < 3.2 * true


def test_an_error_that_falls_faster_than_by_the_second_order_is_said_to_be_larger(
    tmp_path: Path,
) -> None:
    said, true = errors_by_cells(Cells(0.05, 3.0), tmp_path, refine=True)
    assert 1.5 * true < said < 3 * true


def errors_by_cells(cells: Cells, folder: Path, refine: bool) -> tuple[float, float]:
    """Return the error by cells of the curve that a search finds, as said and the true one."""
    fit = fit_of(cells.curve(START), 0.002, np.random.default_rng(3))
    with Springs(fit, folder) as objective:
        objective.cells = cells
        found = search(objective, replace(fit, refine=refine))
    assert found.converged
    assert (found.scale < 1) == refine
    exact, made = Cells(0.0).curve(found.values), cells.curve(found.values, found.scale)
    error = np.interp(exact.displacement, made.displacement, made.force) - exact.force
    return found.error, float(np.sqrt(np.mean(error**2)) / exact.force.max())


def test_cells_are_refined_where_their_error_is_a_tenth_of_the_misfit(tmp_path: Path) -> None:
    for size, wanted in ((0.0004, False), (0.0016, True)):  # about 0.05 and 0.2 of the misfit
        cells = Cells(size, 1.0)
        fit = replace(fit_of(cells.curve(START), 0.004, np.random.default_rng(3)), refine=True)
        with Springs(fit, tmp_path) as objective:
            objective.cells = cells
            found = search(objective, fit)
        assert (found.scale < 1) == wanted


def test_the_share_that_is_done_is_about_that_of_the_time(tmp_path: Path) -> None:
    for one in searches(tmp_path, 0.01, count=8):
        trials = [replace(t, seconds=1.0 if t.coarse else 4.0) for t in one.found.trials]
        ends = np.cumsum([t.seconds for t in trials])
        done = [share_done(trials[: n + 1], refine=False) for n in range(len(trials))]
        assert np.abs(done - ends / ends[-1]).max() < 0.35


def test_the_profile_of_a_nearly_linear_fit_is_its_interval(tmp_path: Path) -> None:
    fit = fit_of(Springs.cells.curve(START), 0.002, np.random.default_rng(3))
    with Springs(fit, tmp_path) as objective:
        found = search(objective, fit)
        e = found.evaluation
        known = knowledge(fit, found.values, e.residuals, e.jacobian, e.comparisons, found.shift)
        first = known.intervals[0]
        one = profile(objective, fit, found, first.name, first.half)
    assert one.rise == pytest.approx([2.25, 1, 0.25, 0, 0.25, 1, 2.25], rel=0.1, abs=1e-6)
    assert [one.low, one.high] == pytest.approx([first.low, first.high], rel=0.02)
