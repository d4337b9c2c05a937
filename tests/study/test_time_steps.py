"""Steps for an accuracy: their errors, and how trials choose their number."""

from __future__ import annotations

from math import exp, inf
from signal import SIGTERM
from types import SimpleNamespace

import pytest
from scipy.integrate import trapezoid

from tests.study.test_estimate import (
    ALONE,
    CONFIGS,
    CYCLE,
    DISSIPATED,
    SPIN,
    case_of,
    elements,
    sheet,
)
from wovenfab.case import Case, CyclesSection, RampSection, read_case
from wovenfab.case.program import program_of_case
from wovenfab.simulation.progress import InterruptedRunError
from wovenfab.solver.newton import NewtonSolver
from wovenfab.stepping.step import StepFailedError
from wovenfab.study.errors.elements import FEW, DegreeRefinement, response_with_degree
from wovenfab.study.errors.estimate import Estimate, worst
from wovenfab.study.errors.step_search import (
    StepSearch,
    TimeSteps,
    _reaches,
    adaptive_steps,
    equal_steps,
)
from wovenfab.study.errors.steps import StepRefinement, error_and_order
from wovenfab.study.response import (
    Budget,
    Response,
    TooLongError,
    breaks_of,
    response_of,
    trial_of,
    with_elements,
    with_steps,
)


@pytest.mark.parametrize("order", [0.4, 1.0, 1.7, 3.0])
def test_the_order_of_steps_is_what_three_numbers_show_but_not_more_than_the_schemes(
    order: float,
) -> None:
    counts = 12, 22, 50
    values = [4 + 3 * n**-order for n in counts]
    error, shown = error_and_order(counts, values, 3)
    assert error == pytest.approx(3 * 50**-order, rel=1e-6)
    assert shown == pytest.approx(order, rel=1e-6)
    error, shown = error_and_order(counts, values, 1.5)
    assert error >= 3 * 50**-order * (1 - 1e-9)
    assert shown <= 1.5
    assert error_and_order(counts, [4.0] * 3, 3) == (0.0, 3)


def test_errors_of_earlier_trials_are_their_distances_from_the_limit_but_not_by_chance() -> None:
    counts = 10, 20, 40, 80
    values = [4 + 3 * n**-2.0 for n in counts]
    made = [
        SimpleNamespace(count=n, figures={DISSIPATED: v})
        for n, v in zip(counts, values, strict=True)
    ]
    refinement = StepRefinement(made, 3)  # type: ignore[arg-type]
    for index, value in enumerate(values):
        error = refinement.errors_from(index)[DISSIPATED]
        true = (value - 4) / values[-1]
        assert true <= error <= true + 2.1 * (values[-1] - 4) / values[-1]
    made[0].figures[DISSIPATED] = 4.0
    by_chance = refinement.errors_from(0)[DISSIPATED]
    assert by_chance == refinement.errors_from(1)[DISSIPATED]


def test_an_earlier_trial_is_enough_where_a_finer_one_shows_that_it_was() -> None:
    """Its three did not, for losses that grow alike show no order."""
    values = {0.125: 0.9985, 0.25: 0.999, 0.5: 0.9997, 2.0: 0.99999}
    search = StepSearch(case_of("bias-1x3"), ALONE, str)
    curve = SimpleNamespace(
        peak_of_spline=lambda: (0.0, 1.0), missed_peak=lambda: 0.0, times=[], breaks=[]
    )
    made = {
        n: SimpleNamespace(
            count=int(80 * n),
            figures={DISSIPATED: v},
            curve=curve,
            outcome=SimpleNamespace(iterations=int(240 * n)),
        )
        for n, v in values.items()
    }
    first = {n: made[n] for n in (0.125, 0.25, 0.5)}
    assert search._least(adaptive_steps, first, 2e-3).estimated_error > 2e-3  # type: ignore[arg-type]
    assert search._least(adaptive_steps, made, 2e-3).number == 0.5  # type: ignore[arg-type]


@pytest.mark.parametrize(("over", "is_reached"), [(1e-12, True), (1e-3, False)])
def test_a_target_that_rounding_alone_misses_is_reached(over: float, is_reached: bool) -> None:
    steps = TimeSteps(equal_steps, 1.0, {DISSIPATED: 0.01}, 1.0, {DISSIPATED: 3.0})
    assert _reaches(steps, steps.estimated_error / (1 + over)) is is_reached


@pytest.mark.parametrize("friction", [(), (SPIN,)], ids=["slip", "slip and spin"])
def test_adaptive_steps_are_at_first_about_as_many_as_usual(friction: tuple[str, ...]) -> None:
    case = case_of("bias-1x3", CYCLE, *friction, elements(2, 0.15), "time={scheme: bdf3}")
    made = response_of(adaptive_steps(case, 1.0), sheet(case)).count
    print(f"\n{made} of {case.planned_steps} steps")
    assert 0.6 < made / case.planned_steps < 1.6


def test_steps_longer_than_friction_takes_to_follow_a_jump_are_known_to_be_too_long() -> None:
    """The loss then changes the more the shorter steps become, which shows no order."""
    counts = 12, 24, 48
    missed = [exp(-n / 100) for n in counts]
    error, order = error_and_order(counts, [1 - m for m in missed], 3)
    assert missed[-1] < -error < 2 * missed[-1]
    assert order < 1


def test_the_force_may_turn_where_the_velocity_jumps() -> None:
    ramps = "program=[{type: ramp, to: 5 mm, duration: 1 s}, {type: hold, duration: 2 s}]"
    assert breaks_of(case_of("bias-1x3", ramps)) == (0.0, 1.0)
    assert breaks_of(case_of("bias-1x3", CYCLE)) == ()


def _sum_to_the_largest_strain(response: Response) -> float:
    loop = response.tests[0].loop(response.history)
    end = int(loop.strain.argmax()) + 1
    return float(trapezoid(loop.force[:end], loop.strain[:end]))


def test_few_steps_are_enough_for_the_work_of_a_tension_test_and_their_error_is_judged() -> None:
    """Nothing is lost: the work is the energy stored, and the area under the curve of more steps.

    A sum over as many steps of a curve that bends is wrong by more.
    """
    table = "effects.stretch={law: table, table: {strain: '2, 4, 6 %', force: '60, 240, 540 N/m'}}"
    fabric = CONFIGS / "fabrics" / "unbalanced.yaml"
    test = read_case(CONFIGS / "tests" / "kes-tension.yaml", (table,), fabric)
    case = trial_of(with_elements(test, degree=2, mesh_size=0.1), 0.01)
    assert not case.needs.history
    chosen = StepSearch(case.model_copy(update={"accuracy": None}), ALONE, str).steps_for(0.01)
    assert chosen is not None
    response = response_of(chosen.of(case), sheet(case))
    more = response_of(with_steps(case, 2), sheet(case), model=response.model)
    by_sum, area = (_sum_to_the_largest_strain(r) for r in (response, more))
    true = response.figures["kes-tension: WT"] / area - 1
    print(f"\n{response.count} steps: WT {true:.2e}, sum {by_sum / area - 1:.2e}")
    assert by_sum > 1.005 * area
    assert abs(true) < 1e-3
    assert abs(chosen.errors["kes-tension: WT"]) < 1e-4
    assert response.figures["kes-tension: LT"] == pytest.approx(2 / 3, rel=0.02)
    assert response.figures["kes-tension: loop energy"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False])
def test_steps_learn_how_the_response_with_other_elements_differs(
    known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With finer elements the sheet is softer, and friction lets go later."""
    chosen = CYCLE, "time.scheme=bdf3", elements(2, 0.15)
    case = trial_of(case_of("bias-1x3", *chosen), 1e-3)
    on = sheet(case)
    search = StepSearch(case, ALONE, str)
    before = search.steps_for(0.01)
    # On another mesh the trial of these steps is made anew.
    mesh = on if known else sheet(with_elements(case, mesh_size=0.1))
    made: list[Case] = []
    monkeypatch.setattr(search, "_run", lambda c, run=search._run: made.append(c) or run(c))
    responses = tuple(response_with_degree(case, mesh, degree) for degree in (2, 3, 4))
    search.learn(Estimate(DegreeRefinement((2, 3, 4), responses), 4), FEW)
    assert len(made) == (not known)
    monkeypatch.undo()
    after = search.steps_for(0.01)
    coarse = response_of(with_elements(case, degree=2), on)
    fine = response_of(with_elements(case, degree=4), mesh)
    true = fine.curve.peak_of_spline()[0] - coarse.curve.peak_of_spline()[0]
    print(f"\n{1e3 * search._delay:.3g} ms later, true {1e3 * true:.3g} ms")
    assert search._delay == pytest.approx(true, rel=0.3)
    assert true > 0
    ratio = coarse.figures[DISSIPATED] / fine.figures[DISSIPATED]
    assert search._larger[DISSIPATED] == pytest.approx(ratio, rel=0.05)
    assert ratio > 1.1
    assert before is not None
    assert after is not None
    assert after.number >= before.number


COULOMB = (
    "effects.slip_friction={law: coulomb, strength: 1e5 N/m^2}",
    "effects.spin_friction={law: coulomb, strength: 12.7 N/m}",
)
WEAR = CONFIGS.parent / "docs" / "examples" / "wear.yaml"


SHARP = ("effects.slip_friction.slope=1e7 s/m",)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["smooth", "sharp", "set-valued", "with a memory"])
def test_a_model_that_was_run_gives_the_same_response_as_a_new_one(kind: str) -> None:
    """Sharp friction has its stress at points in some steps, for which others' forms are solved."""
    if kind == "with a memory":
        case = trial_of(read_case(WEAR), 1e-3)
    else:
        more = {"sharp": SHARP, "set-valued": COULOMB}.get(kind, ())
        case = case_of("bias-1x3", CYCLE, "time.scheme=bdf3", elements(2, 0.15), *more)
    on = sheet(case)
    few, more_steps = with_steps(case, 0.1), with_steps(case, 0.2)
    new = response_of(more_steps, on)
    again = response_of(more_steps, on, model=response_of(few, on).model)
    assert list(again.forces) == list(new.forces)
    assert list(again.dissipated) == list(new.dissipated)
    assert new.figures[DISSIPATED] > 0
    assert not any(step.stored for step in again.steps)


def test_a_trial_is_given_up_once_its_steps_take_more_tangents_than_another_kind_needs() -> None:
    case = trial_of(case_of("bias-1x3", CYCLE, "time.scheme=bdf3", elements(2, 0.15)), 1e-3)
    lines, on = list[str](), sheet(case)
    search = StepSearch(case, ALONE, lines.append)
    assert search._enough(adaptive_steps, 0.001, least=10, number=0.125) is None
    assert search._enough(adaptive_steps, 0.001, least=inf, number=0.25) is None
    assert not lines  # no trial got to its end, and none of more steps was begun
    with pytest.raises(TooLongError, match=r"more than 10 tangents in [1-9] steps"):
        response_of(case, on, tangents=10)


def test_what_trials_take_is_told_by_their_tangents_and_not_by_a_clock() -> None:
    case = case_of("elastic-1x3", "program={type: ramp, to: 20 mm, steps: 4}", elements(2, 0.15))
    on, twice = sheet(case), [Budget(), Budget()]
    runs = [response_of(case, on, budget=budget) for budget in twice]
    assert twice[0].spent == twice[1].spent > 0
    least = Budget()
    least.spend(runs[0].outcome.iterations, runs[0].model.unknowns)
    assert least.spent <= twice[0].spent * (1 + 1e-9)
    short = Budget(twice[0].spent / 2)
    with pytest.raises(TooLongError, match=r"after [1-3] steps"):
        response_of(case, on, budget=short)
    assert short.limit < short.spent < twice[0].spent


def test_what_a_trial_that_fails_has_taken_counts_too() -> None:
    case = case_of(
        "elastic-1x3", "program={type: ramp, to: 20 mm, steps: 1}", elements(2, 0.15),
        "time.smallest_step=1.0", "solver.max_iterations=2",
    )  # fmt: skip
    budget = Budget()
    with pytest.raises(StepFailedError):
        response_of(case, sheet(case), budget=budget)
    assert budget.spent > 0


def test_a_trial_that_a_signal_ends_is_no_response(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its steps so far were compared with all of the others, and the worse mesh was taken."""
    case = case_of("elastic-1x3", "program={type: ramp, to: 20 mm, steps: 4}", elements(2, 0.15))
    formed, form = [0], NewtonSolver.form_tangent

    def interrupted(self: NewtonSolver, x: object) -> None:
        formed[0] += 1
        if formed[0] == 3:
            raise InterruptedRunError(SIGTERM)
        form(self, x)

    monkeypatch.setattr(NewtonSolver, "form_tangent", interrupted)
    with pytest.raises(InterruptedRunError):
        response_of(case, sheet(case))


def test_trials_with_as_many_steps_as_before_are_not_compared() -> None:
    """A ramp of few steps, whose first trials have the fewest that there are."""
    ramp = "{type: ramp, to: 5 mm, duration: 0.1 s, steps: 8}"
    case = case_of("bias-1x3", f"program={ramp}", elements(2, 0.15), "time=null")
    lines: list[str] = []
    chosen = StepSearch(trial_of(case, 0.05), ALONE, lines.append).steps_for(0.05)
    counts = [int(t.split(",")[0].removeprefix("equal steps: ")) for t in lines]
    assert counts[0] == counts[1] < counts[-1]
    assert len(set(counts)) >= 3
    assert chosen is not None
    assert abs(worst(chosen.errors)) <= 0.05


def test_equal_steps_are_whole_again_after_shorter_first_ones() -> None:
    time = "time={scheme: bdf3, steps_per_cycle: 24, tolerance: 0.5}"
    case = case_of("bias-1x3", CYCLE, time, elements(2, 0.15))
    assert 24 < response_of(case, sheet(case)).count <= 28


@pytest.mark.parametrize("target", [0.004, pytest.param(0.001, marks=pytest.mark.slow)])
def test_equal_steps_meet_the_peak(target: float) -> None:
    case = trial_of(case_of("bias-1x3", CYCLE, "time.scheme=bdf3", elements(2, 0.15)), target)
    search = StepSearch(case, ALONE, str)
    chosen = search.steps_for(target)
    assert chosen is not None
    assert chosen.words == "equal steps"
    response = response_of(chosen.of(case), sheet(case))
    missed = response.curve.missed_peak()
    print(f"\n{response.count} steps: missed {missed:.2e}, expected {chosen.missed:.2e}")
    assert missed < target
    assert missed < 2 * chosen.missed + target / 20


def test_one_more_step_ends_at_the_peak_of_every_largest_cycle() -> None:
    """The trial is one cycle; the run has two of that amplitude, and a smaller one."""
    cycles = "{type: cycles, amplitudes: '60, 30, 60 mm', max_velocity: 0.5 m/s}"
    case = case_of("bias-1x3", f"program={cycles}", "time.scheme=bdf3", elements(2, 0.15))
    trial = trial_of(case, 0.01)
    coarse = response_of(with_steps(trial, 0.3), sheet(trial))
    search = StepSearch(trial, ALONE, str)
    missed, extra = search._missed(with_steps(trial, 0.15), coarse)
    assert len(extra) == 1
    steps = TimeSteps(equal_steps, 0.15, {}, 0.0, {}, missed, extra)
    chosen = steps.of(case)
    first, small, _ = (end for _, end in program_of_case(case).cycles)
    assert chosen.time.extra_times == pytest.approx((extra[0], small + extra[0]))
    with_own = steps.of(case.changed("time.extra_times=50 ms"))
    assert with_own.time.extra_times == (0.05, *chosen.time.extra_times)
    assert small > first > extra[0]
    met, not_met = (
        r.curve.missed_peak()
        for r in (response_of(c, sheet(trial)) for c in (steps.of(trial), with_steps(trial, 0.15)))
    )
    print(f"\nmissed {met:.2e} with a step more, {not_met:.2e} without, expected {missed:.2e}")
    assert met < not_met / 5


def test_no_step_is_added_close_to_a_planned_one() -> None:
    case = trial_of(case_of("bias-1x3", CYCLE, "time.scheme=bdf3", elements(2, 0.15)), 0.01)
    response = response_of(with_steps(case, 0.3), sheet(case))
    search = StepSearch(case, ALONE, str)
    peak = response.curve.peak_of_spline()[0]
    search._delay = response.times[-1] / 2 - peak  # the largest force at the reversal
    assert search._missed(with_steps(case, 0.15), response)[1] == ()


def test_steps_are_thinned_alike_in_all_segments() -> None:
    cycles = "{type: cycles, amplitudes: [20 mm], frequency: 1 Hz}"
    hold = "{type: hold, duration: 1 s, steps: 20}"
    case = case_of("bias-1x3", "time.steps_per_cycle=80", f"program=[{cycles}, {hold}]")
    assert case.planned_steps == 100
    assert with_steps(case, 0.25).planned_steps == 25


def test_where_nothing_depends_on_the_past_a_trial_is_the_way_to_the_largest_displacement() -> None:
    elastic = case_of("bias-1x3", "effects.slip_friction=null", "program.amplitudes=[10 mm, 30 mm]")
    (segment,) = trial_of(elastic, 1e-2).program
    assert isinstance(segment, RampSection) and segment.to == pytest.approx(0.03)
    (segment,) = trial_of(case_of("bias-1x3"), 1e-2).program
    assert isinstance(segment, CyclesSection) and segment.amplitudes == (0.06,)
