"""Machines with a spring and slack: intervals where friction turns within a step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from wovenfab.case import read_case
from wovenfab.forms.effect import Target
from wovenfab.measured.curve import Measured
from wovenfab.measured.replicates import replicates_of
from wovenfab.study.fit.fit_file import Fit, FitParameter, MeasuredTest
from wovenfab.study.fit.identifiability import knowledge
from wovenfab.study.fit.objective import Objective
from wovenfab.study.fit.response import ResponseCurve, compared, unresolved
from wovenfab.study.fit.search import search_with_slack

ROOT = Path(__file__).parents[2]
Array = NDArray[np.float64]
#: Stiffness (N/m) and Coulomb friction (N) of a sample, and what its machine adds.
TRUTH = {
    "shear.stiffness": 80.0,
    "spin_friction.strength": 0.8,
    "machine.compliance": 1e-4,
    "machine.displacement": 0.3e-3,
    "machine.force": 0.05,
}
UNKNOWNS = (
    FitParameter(
        "shear.stiffness", "N/m", Target("shear", "stiffness"), 60.0, False, (1, 1e3), True
    ),
    FitParameter(
        "spin_friction.strength", "N", Target("spin_friction", "strength"), 0.6, False,
        (1e-2, 1e2), True,
    ),
    FitParameter("machine.compliance", "m/N", None, 2e-5, False, (1e-6, 1e-2), True),
    FitParameter("machine.displacement", "m", None, 0.0, False, (-1e-3, 1e-3), False),
    FitParameter("machine.force", "N", None, 0.0, False, (-1.0, 1.0), False),
)  # fmt: skip
SPAN, ERROR = 20e-3, 0.01


def curve(values: Mapping[str, float], scale: float = 1.0) -> ResponseCurve:
    """Return force and derivatives of a stiffening sample whose friction reverses at once."""
    stiffness, friction = values["shear.stiffness"], values["spin_friction.strength"]
    half = round(20 / scale)
    u = SPAN / 2 * (1 - np.cos(np.pi * np.arange(2 * half + 1) / half))
    u[-1] = 0.0
    shape = u + 2e3 * u**3
    sign = np.where(np.arange(u.size) <= half, 1.0, -1.0)
    sign[0] = 0.0
    slopes = np.stack([shape, sign], axis=1)
    return ResponseCurve(
        u, stiffness * shape + friction * sign, 0 * u, slopes, (0, half, 2 * half), 0.0
    )


def measured(noise: Array | float = 0.0) -> Measured:
    made = curve(TRUTH)
    x = made.displacement + TRUTH["machine.compliance"] * made.force
    x += TRUTH["machine.displacement"]
    return Measured(Path("twin.csv"), x, made.force + TRUTH["machine.force"] + noise, None)


def fit_to(curve: Measured) -> Fit:
    case = read_case(ROOT / "configs" / "bias-1x3.yaml")
    return Fit(
        "",
        "twin",
        (MeasuredTest(case, replicates_of([curve]), ERROR, 1.0, -np.inf),),
        UNKNOWNS,
        False,
    )


class Closed(Objective):
    """Of curves in closed form: nothing is run."""

    def _curves(self, values: Mapping[str, float], scale: float) -> list[ResponseCurve]:
        return [curve(values, scale)]


def test_a_step_in_which_friction_turns_is_seen_and_a_stiffening_one_is_not() -> None:
    u = np.linspace(0, 1, 9)
    jump = 2.0 * (u > 0)
    assert unresolved(u, u + jump, 0.01) == 1
    assert unresolved(u, u + jump, 3.0) == 0  # less than the error of a force
    assert unresolved(u, u**6, 0.01) == unresolved(u, u, 0.01) == 0
    back = u[::-1]
    assert unresolved(back, back**3 - np.minimum(jump, [0, 1.5, *7 * [2.0]]), 0.01) == 2


def test_derivatives_by_the_machine_are_those_of_the_rows_that_are_compared(tmp_path: Path) -> None:
    fit = fit_to(measured())
    with Closed(fit, tmp_path) as objective:
        q = objective.scaled({**TRUTH, "machine.displacement": 0.2e-3})
        at = objective.evaluate(objective.values(q))
        for k, step in enumerate(1e-6 * np.eye(len(q))):
            ends = [objective.evaluate(objective.values(q + s * step)).residuals for s in (1, -1)]
            difference = (ends[0] - ends[1]) / 2e-6
            size = np.abs(difference).max()
            assert np.abs(at.jacobian[:, k] - difference).max() < 1e-5 * size


def test_intervals_of_all_kinds_of_parameters_hold_the_truth_as_often_as_they_say(
    tmp_path: Path,
) -> None:
    # Of the linearised problem: a row that the steps do not resolve has a larger error.
    fit = fit_to(measured())
    with Closed(fit, tmp_path) as objective:
        objective.choose_rows(TRUTH, 1.0)
        e, q = objective.evaluate(TRUTH), objective.scaled(TRUTH)
        weights = e.weights(fit)
        generator, hits, repeats = np.random.default_rng(7), np.zeros(5), 400
        for _ in range(repeats):
            noise = generator.standard_normal(weights.size)
            weighted = weights[:, None] * e.jacobian
            step = np.linalg.lstsq(weighted, noise, rcond=None)[0]
            rest = (noise - weighted @ step) / weights
            known = knowledge(fit, objective.values(q + step), rest, e.jacobian, e.comparisons)
            hits += [i.low <= TRUTH[i.name] <= i.high for i in known.intervals]
    assert weights.min() < 0.1
    assert ((hits / repeats >= 0.90) & (hits / repeats <= 0.99)).all()


def test_no_row_decides_the_spring_whatever_the_noise(tmp_path: Path) -> None:
    generator, hits, halves = np.random.default_rng(3), [], []
    for _ in range(20):
        fit = fit_to(measured(ERROR * generator.standard_normal(41)))
        with Closed(fit, tmp_path) as objective:
            found = search_with_slack(objective, fit)
            assert not objective.choose_rows(found.values, found.scale)  # all that are reached
        e = found.evaluation
        known = knowledge(fit, found.values, e.residuals, e.jacobian, e.comparisons)
        hits.append([i.low <= TRUTH[i.name] <= i.high for i in known.intervals])
        halves.append([i.half for i in known.intervals] * objective.slopes(found.values))
    widths = np.array(halves)
    assert (widths.max(axis=0) < 5 * widths.min(axis=0)).all()
    assert (np.sum(hits, axis=0) >= 17).all()  # fewer of 20 have a probability of 0.003


def test_what_cells_and_steps_move_parameters_by_widens_intervals(tmp_path: Path) -> None:
    fit = fit_to(measured())
    with Closed(fit, tmp_path) as objective:
        e = objective.evaluate(TRUTH)
    shift = np.array([0.0, 0.3, 0.0, 0.0, 0.2])
    plain, wide = (
        knowledge(fit, TRUTH, e.residuals, e.jacobian, e.comparisons, s).intervals
        for s in (None, shift)
    )
    assert [w.half for w in wide] == [p.half for p in plain]
    assert wide[0].high == plain[0].high
    assert wide[1].high / plain[1].high == pytest.approx(np.exp(0.3))
    assert wide[1].low / plain[1].low == pytest.approx(np.exp(-0.3))
    assert wide[4].high - plain[4].high == pytest.approx(0.4)  # of bounds 2 N apart


def test_an_error_of_all_rows_moves_parameters_as_a_fit_to_it_would(tmp_path: Path) -> None:
    # Coarse runs are 2 % too stiff: by the lowest order the fine ones are, too.
    class Stiff(Closed):
        def _curves(self, values: Mapping[str, float], scale: float) -> list[ResponseCurve]:
            factor = 1 + 0.02 * (scale > 1)
            one = curve({**values, "shear.stiffness": factor * values["shear.stiffness"]})
            return [replace(one, slopes=one.slopes * [factor, 1.0])]

    fit = replace(fit_to(measured()), unknowns=UNKNOWNS[:2])
    made = curve(TRUTH)
    still = Measured(Path("twin.csv"), made.displacement, made.force, None)
    fit = replace(fit, tests=(replace(fit.tests[0], replicates=replicates_of([still])),))
    with Stiff(fit, tmp_path) as objective:
        found = search_with_slack(objective, fit)
    assert found.shift == pytest.approx([0.02, 0.0], abs=5e-4)


def test_curves_of_a_machine_without_spring_and_slack_are_those_of_the_sample() -> None:
    made = curve(TRUTH)
    plain = Measured(Path("twin.csv"), made.displacement, made.force, None)
    assert compared(plain, made, error=ERROR).misfit < 1e-14


def test_a_soft_spring_before_a_sample_that_locks_is_followed_to_the_row() -> None:
    """Each iteration brings the force nearer by one e-folding only."""
    half = np.linspace(0, 1, 401)
    u = SPAN * np.concatenate([half, half[-2::-1]])
    force = np.exp(20 * u / SPAN)
    ends = (0, half.size - 1, u.size - 1)
    sample = ResponseCurve(u, force, 0 * u, np.zeros((u.size, 0)), ends, 0.0)
    compliance = 1e4 * SPAN / force.max()
    x = u + compliance * force
    behind = Measured(Path("twin.csv"), x, force, None)
    machine = {"machine.compliance": compliance}
    made = compared(behind, sample, values=machine, reference=machine, error=ERROR)
    assert made.misfit < 1e-6
