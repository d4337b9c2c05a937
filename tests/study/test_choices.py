"""What is chosen for an accuracy: with too few steps, without losses."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import wovenfab.study.errors.choice as plan_module
from tests.record.test_standard_tests import SHEAR
from tests.study.test_estimate import ALONE, SPIN, case_of, elements, sheet
from wovenfab.case import Case
from wovenfab.case.objects import simulation_of
from wovenfab.record.history import ERRORS
from wovenfab.sheet.sheet import Sheet
from wovenfab.solver.problem import SolveResult
from wovenfab.stepping.step import Step, StepFailedError
from wovenfab.study.errors import report
from wovenfab.study.errors.choice import Plan, plan
from wovenfab.study.errors.elements import FEW, response_with_degree
from wovenfab.study.errors.estimate import SAFETY
from wovenfab.study.errors.report import NO_LOSS, report_errors
from wovenfab.study.response import Response, response_of

RAMP = "program={type: ramp, to: 20 mm, steps: 8}"
#: Limit as in tests/verification/test_few_unknowns.py, N.
FORCE = 122.1105
#: Of a fabric that is two hundred thousand times softer in shear than along its yarns.
SOFT = (
    "effects.stretch.stiffness=1.261e6 N/m",
    "effects.shear.stiffness=6.277 N/m",
    "effects.bending.stiffness=12.74 N*m",
    "effects.spin_friction={law: coulomb, strength: 12.7 N/m}",
    "sheet={length: 0.5355, width: 0.3564, fibres: [45 deg, -45 deg]}",
    "program={type: ramp, to: 15.83 mm, steps: 6, velocity: 17 mm/s}",
)


STICKING = (
    "effects.coupling.stiffness=1e5 N/m^3",
    "program={type: ramp, to: 20 mm, steps: 4, duration: 1}",
    "time=null",
)


def elastic(*overrides: str) -> Case:
    return case_of("elastic-1x3", "accuracy=1 %", "discretisation=null", RAMP, *overrides)


def planned(case: Case) -> tuple[Plan, list[str]]:
    """Return the plan for a case, and the lines on its trials."""
    lines: list[str] = []
    return plan(case, ALONE, lines.append), lines


@pytest.mark.slow
def test_a_degree_that_is_accurate_enough_is_not_confirmed_by_a_higher_one() -> None:
    chosen, lines = planned(elastic("accuracy=0.4 %"))
    assert chosen.case.discretisation.degree == 4
    assert any(line.startswith("degree 4: error") for line in lines)
    assert not any("degree 5" in line for line in lines)
    assert chosen.estimate is not None
    force = response_of(chosen.case, chosen.sheet).figures["peak_force_N"]
    assert abs(force / FORCE - 1) < chosen.estimate.worst <= 4e-3


REPEATED = "once more with twice the steps, for they cannot be made"


@pytest.mark.slow
def test_trials_of_an_elastic_sheet_whose_steps_cannot_be_made_are_not_repeated() -> None:
    """Its steps have no error, so that they are cut."""
    few = "solver.max_iterations=2", "solver.predictor=none", "solver.factor=renewed"
    ramp = "program={type: ramp, to: 80 mm, steps: 40}"
    case = case_of("elastic-1x3", *few, ramp, "accuracy=5 %", "discretisation=null", "time=null")
    chosen, lines = planned(case)
    assert REPEATED not in lines
    assert not chosen.shortfall


@pytest.mark.slow
def test_trials_whose_few_steps_cannot_be_made_are_repeated_with_more_for_all_degrees(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[tuple[int, float]] = []

    def response(case: Case, sheet: Sheet, degree: int, share: float, *more: Any) -> Response:
        """Pretend that degree 3 cannot be tried with few steps."""
        tried.append((degree, share))
        if (degree, share) == (3, FEW):
            raise StepFailedError(0.0, 0.0, 1.0, SolveResult(False, "REFUSED", 1, 1.0), 0)
        return response_with_degree(case, sheet, degree, share, *more)

    monkeypatch.setattr(plan_module, "response_with_degree", response)
    ramp = "program={type: ramp, to: 20 mm, steps: 8, velocity: 0.1 m/s}"
    case = case_of("bonded-1x3", ramp, SPIN, "accuracy=2 %", "discretisation=null", "time=null")
    chosen, lines = planned(case)
    assert lines.count(REPEATED) == 1
    assert tried[:5] == [(2, FEW), (3, FEW), *((degree, 2 * FEW) for degree in (2, 3, 4))]
    assert not chosen.shortfall


@pytest.mark.parametrize(("most", "is_cut"), [(5, False), (2, True)])
def test_a_step_that_a_guess_misleads_is_solved_without_it_and_so_are_shorter_ones(
    most: int, is_cut: bool
) -> None:
    ramp = "program={type: ramp, to: 20 mm, steps: 2}"
    case = case_of("elastic-1x3", ramp, elements(2, 0.15))
    plain, asked = response_of(case, sheet(case)), Counter[float]()
    few = case.changed(f"solver.max_iterations={most}")
    with simulation_of(few, sheet(case)) as simulation:
        size = simulation.model.field.x.array.size
        wrong = 1e-3 * np.random.default_rng(1).standard_normal(size)

        def guess(time: float) -> NDArray[np.float64] | None:
            asked[time] += 1
            return wrong if time in plain.times else None

        simulation.stepper.start_from(guess)
        steps: list[Step] = []
        outcome = simulation.run(steps.append)
    assert outcome.failure is None
    assert (outcome.cutbacks > 0) == is_cut
    assert [asked[time] for time in plain.times[1:]] == [1] * plain.count
    assert steps[-1].force == pytest.approx(plain.forces[-1], rel=1e-6)


@pytest.mark.parametrize(("size", "most"), [(1e-3, 5), (10.0, 0)])
def test_a_guess_that_misleads_costs_few_iterations_and_one_that_cannot_be_none(
    size: float, most: int
) -> None:
    """Before the stress of friction is at points, the step has another start; 10 m cross yarns."""
    ramp = "program={type: ramp, to: 20 mm, steps: 4, duration: 1}"
    case = case_of("bias-1x3", ramp, elements(2, 0.15), "time=null", "solver.max_iterations=5")
    plain, iterations = response_of(case, sheet(case)), Counter[bool]()
    with simulation_of(case, sheet(case)) as simulation:
        states = simulation.model.field.x.array.size
        wrong = size * np.random.default_rng(1).standard_normal(states)
        solver = simulation.solver

        def watch() -> None:
            iterations[solver.problem.model is solver.model] += 1

        solver.newton.on_iteration = watch
        simulation.stepper.start_from(lambda time: wrong if time == plain.times[2] else None)
        steps: list[Step] = []
        simulation.run(steps.append)
    needed = sum(step.iterations + 1 for step in steps[1:])
    assert not iterations[False]  # none with its stress at points
    assert needed <= iterations.total() <= needed + most + bool(most)
    assert (iterations.total() > needed) == bool(most)
    afresh = [s.iterations for s in plain.steps]
    assert most or [s.iterations for s in steps] == afresh  # also extrapolated, as usual
    assert [s.force for s in steps] == pytest.approx(plain.forces, rel=1e-6)


@pytest.mark.parametrize(
    "law",
    [
        pytest.param("law: coulomb", id="Coulomb", marks=pytest.mark.slow),
        pytest.param("slope: 1e3 s/m", id="smooth", marks=pytest.mark.slow),
    ],
)
def test_a_fabric_whose_yarns_stick_gets_a_graded_mesh(
    law: str,
) -> None:
    friction = f"effects.slip_friction={{{law}, strength: 1e9 N/m^2}}"
    wanted = "accuracy=8 %", "discretisation=null", friction, *STICKING
    chosen, lines = planned(case_of("bias-1x3", *wanted))
    print(f"\n{chosen.case.discretisation}", *lines, sep="\n")
    assert not chosen.shortfall
    assert chosen.case.discretisation.graded
    assert any("graded" in line for line in lines)


def test_the_error_of_a_loss_that_coarse_elements_do_not_have_counts_as_not_known() -> None:
    """Steps are judged with coarse elements, of which all points may stick."""
    errors = {
        "wanted": 0.01,
        "shortfall": NO_LOSS,
        "elements": {"peak_force_N": 1e-3, "dissipated_J": 2e-3},
        "steps": {"peak_force_N": 1e-3},
    }
    summary = {"peak_force_N": 1.0, "dissipated_J": 2.0}
    history = {"time_s": np.arange(3.0), "force_N": np.arange(3.0)}
    lines: list[str] = []
    said = report_errors(errors, case_of("bias-1x3"), summary, history, None, lines.append)[
        "accuracy"
    ]
    loss, force = (said["figures"][name] for name in ("dissipated_J", "peak_force_N"))
    assert loss["error_of_steps"] is loss["relative_error"] is loss["error"] is None
    assert loss["error_of_elements"] == pytest.approx(2 * 2e-3)
    assert force["error_of_steps"] == pytest.approx(1e-3)
    assert said["shortfall"] == NO_LOSS and NO_LOSS in lines[-1]
    assert "dissipated: its error is not known" in lines


def test_steps_that_could_not_be_judged_are_told_before_the_run_without_an_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = case_of("bias-1x3", "accuracy=1 %", "discretisation=null", "time=null")
    lines: list[str] = []
    space = {"peak_force_N": 1e-3, "dissipated_J": 2e-3, "test: width": 1e-3}
    for left_out, told in (("", ""), ("dissipated_J", NO_LOSS), ("test: width", "test: width")):
        judged = {name: error for name, error in space.items() if name != left_out}
        estimate = SimpleNamespace(space=space, time=judged, worst=4e-3, resolved=True)
        found = Plan(case, sheet(case), estimate)  # type: ignore[arg-type]
        monkeypatch.setattr(report, "plan", lambda *_, found=found, **__: found)
        shortfall = report.choose(case, sheet(case), lines.append, str).shortfall
        assert bool(shortfall) == bool(left_out) and told in shortfall and told in lines[-1]
    assert "estimated error" not in lines[-1]


@pytest.mark.parametrize(("phase", "missed"), [(0.0, False), (0.5, True)])
def test_a_peak_that_falls_between_the_steps_of_the_run_counts(phase: float, missed: bool) -> None:
    t = np.arange(-20, 20) + phase
    forces = 1 - t**2 / 4000
    errors = {
        "wanted": 6e-5,
        "shortfall": "",
        "elements": {"peak_force_N": 1e-6},
        "steps": {"peak_force_N": -2e-6},
    }
    summary, lines = {"peak_force_N": float(forces.max())}, list[str]()
    history = {"time_s": t, "force_N": forces}
    said = report_errors(errors, case_of("bias-1x3"), summary, history, None, lines.append)[
        "accuracy"
    ]
    error = said["figures"]["peak_force_N"]["relative_error"]
    assert error >= 1 - forces.max()
    assert error == pytest.approx(SAFETY * (1e-6 + 2e-6) + 1 / forces.max() - 1)
    assert bool(said["shortfall"]) == missed
    assert any("missed the peak" in line for line in lines) == missed


@pytest.mark.parametrize("figure", ["peak_force_N", "dissipated_J"])
@pytest.mark.parametrize(("measured", "counts"), [(0.0, 2e-3), (1e-3, 2e-3), (-5e-3, 5e-3)])
def test_larger_errors_of_steps_that_the_run_measures_itself_count(
    measured: float, counts: float, figure: str
) -> None:
    """Steps are chosen with coarse elements, with which a fabric may be stiffer and slower."""
    errors = {
        "wanted": 0.005,
        "shortfall": "",
        "elements": {figure: 1e-3},
        "steps": {figure: 2e-3},
    }
    rising = np.linspace(0.0, 4.0, 30)
    history = dict.fromkeys(("time_s", "force_N", "dissipated_J"), rising)
    history |= dict.fromkeys(ERRORS, measured * rising)
    summary, case = {figure: 4.0}, case_of("bias-1x3")
    said = report_errors(errors, case, summary, history, None, lambda _: None)["accuracy"]
    error = said["figures"][figure]
    assert error["relative_error"] == pytest.approx(SAFETY * (1e-3 + counts))
    assert bool(said["shortfall"]) == (error["relative_error"] > errors["wanted"])


def test_friction_that_nowhere_slides_has_no_loss_to_be_judged() -> None:
    stuck = "effects.slip_friction={law: coulomb, strength: 1e9 N/m^2}"
    case = case_of("bias-1x3", stuck, elements(2, 0.15), "time=null", RAMP[:-1] + ", duration: 1}")
    response = response_of(case, sheet(case))
    assert response.figures["dissipated_J"] == 0.0
    assert abs(response.figures["peak_force_N"]) > 1.0


@pytest.mark.parametrize(("strength", "width"), [(None, 0.0), (150.0, 0.0098)])
def test_a_loop_that_only_curves_between_few_steps_open_is_not_judged(
    strength: float | None, width: float
) -> None:
    """An elastic sheet has none; between steps its two branches differ by a few millionths."""
    effects = {k: v for k, v in SHEAR["effects"].items() if k != "spin_friction"}
    if strength:
        effects["spin_friction"] = {"law": "coulomb", "strength": strength}
    ways = [
        {"type": "ramp", "to": to, "steps": steps}
        for to, steps in ((0.05, 20), (-0.05, 41), (0.0, 20))
    ]
    case = Case(**SHEAR | {"effects": effects, "program": ways})
    response = response_of(case, sheet(case))
    (test,) = response.tests
    largest = test.loop(response.history).size("N/m")
    said = {name: value / largest for name, value in response.figures.items() if "2HG5" in name}
    assert list(said.values()) == [pytest.approx(width, rel=0.05)]


@pytest.mark.slow
def test_friction_at_its_bound_takes_few_iterations_on_a_fabric_that_is_soft_in_shear() -> None:
    case = case_of("bonded-1x3", *SOFT, elements(3, 0.15), "time=null")
    outcome = response_of(case, sheet(case)).outcome
    print(f"\n{outcome.iterations} tangents in {outcome.steps} steps")
    assert not outcome.cutbacks
    assert outcome.iterations <= 8 * outcome.steps
