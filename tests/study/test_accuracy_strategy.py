"""Which runs an accuracy study makes, and what it believes: on answers given by formulas."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field

import pytest

from benchmarks.accuracy_page import ROOT, STUDIES
from wovenfab.case import Case, read_case
from wovenfab.stepping.schemes import SCHEMES
from wovenfab.study.accuracy.errors import (
    Best,
    Combined,
    Forecast,
    Pair,
    Refinement,
    best_of,
    forecast,
)
from wovenfab.study.accuracy.measure import DISSIPATED, PEAK_FORCE, Measured
from wovenfab.study.accuracy.settings import Setting
from wovenfab.study.accuracy.strategy import MethodState, run_study
from wovenfab.study.accuracy.study import TARGETS, Run, Study

EXACT = {PEAK_FORCE: 344.0, DISSIPATED: 3.16}
SLIP = next(shown for shown in STUDIES if shown.name == "slip")


@dataclass
class Formula:
    """A runner whose errors are powers of mesh size and step, and a multiple of their product.

    Aligned elements that may jump have the order of their degree, others order one.
    """

    mixed: float
    ran: Counter[tuple[str, ...]] = field(default_factory=Counter)
    stages: list[str] = field(default_factory=list)

    def __call__(self, setting: Setting) -> Measured:
        """Return what the formula says of a setting."""
        self.ran[setting.overrides] += 1
        self.stages.append(setting.stage)
        case = read_case(ROOT / SLIP.case, (*SLIP.settings, *setting.overrides))
        mesh, step = self.errors(case)
        h = case.discretisation.mesh_size
        assert h is not None
        unknowns = round(200 * (0.1 * case.discretisation.degree / h) ** 2)
        steps = self.steps(case)
        return Measured(
            values={
                name: value * (1 + share * mesh + step + self.mixed * share * mesh * step)
                for (name, value), share in zip(EXACT.items(), (1.0, 3.0), strict=True)
            },
            unknowns=unknowns,
            steps=steps,
            iterations=3 * steps,
            tangents=3 * steps,
            stepping=2e-5 * unknowns * steps,
        )

    @staticmethod
    def errors(case: Case) -> tuple[float, float]:
        """Return the relative errors for a case's mesh and steps alone."""
        numerics = case.discretisation
        good = numerics.mesh == "fibres" and numerics.jumps is not False
        size = (numerics.mesh_size or 0.0) / 0.15
        mesh = 0.06 * 3.0 ** (2 - numerics.degree) * size ** (numerics.degree if good else 1)
        order = SCHEMES[case.time.scheme].order
        if case.time.tolerance:
            return mesh, 2.1 * case.time.tolerance
        # Not 0.04: then an error is just 1 %, and round-off decides whether it is within.
        return mesh, 0.0401 * (10 / case.time.steps_per_cycle) ** order

    @staticmethod
    def steps(case: Case) -> int:
        """Return the number of steps; adaptive ones are more for the same error."""
        tolerance = case.time.tolerance
        return round(30 * (0.02 / tolerance) ** 0.5) if tolerance else case.time.steps_per_cycle


def studied(runner: Formula, budget: float = 300.0) -> Study:
    return run_study(read_case(ROOT / SLIP.case, SLIP.settings), runner, budget, lambda *_: None)


@pytest.mark.parametrize("mixed", [0.0, 4.0, -8.0])
def test_every_accuracy_is_proven_and_the_errors_are_true_bounds(mixed: float) -> None:
    runner = Formula(mixed)
    study = studied(runner)
    for name, exact in EXACT.items():
        best = study.best["both"][name]
        assert abs(best.value - exact) <= best.error < 1e-3 * exact
    for target in TARGETS:
        run = study.chosen[target]
        assert run is not None
        for name, exact in EXACT.items():
            assert abs(run.measured.values[name] / exact - 1) <= target
    walls = [run.measured.wall for run in study.chosen.values() if run]
    assert walls == sorted(walls)
    assert study.spent <= 300


def test_time_goes_to_methods_that_get_there() -> None:
    runner = Formula(1.0)
    study = studied(runner, 400.0)
    runs = Counter(run.setting.method for run in study.runs if run.setting.stage != "both")
    assert runs["backward-euler"] == runs["P2 crossed"] == runs["P3 on fibres, no jumps"] == 3
    assert max(runs["bdf2"], runs["bdf3"]) > 5 and runs["P4 on fibres"] >= 3
    assert set(runner.ran.values()) == {1}, "no setting is paid for twice"


def test_a_ladder_rests_where_two_others_are_ahead_of_its_next_run() -> None:
    run = Run(Setting("space", "P3", 3, "20 mm", (), ()), Measured(), 0.02)
    ahead, good, late = (MethodState(iter(()), [run] * 3, error=e) for e in (1e-4, 3e-4, 2e-3))
    all_of_them = [ahead, good, late]
    late.next_error, good.next_error = 4e-4, 1e-4
    assert not late.is_useful(all_of_them)
    assert good.is_useful(all_of_them)
    late.next_error = 2e-4
    assert late.is_useful(all_of_them)
    assert late.is_useful([ahead, late]), "the best answer needs a check"


def test_in_little_time_nothing_is_claimed_that_is_not_so() -> None:
    runner = Formula(4.0)
    study = studied(runner, 50.0)
    for target, run in study.chosen.items():
        for name, exact in EXACT.items():
            assert run is None or abs(run.measured.values[name] / exact - 1) <= target
    assert study.chosen[TARGETS[0]] is not None
    assert study.chosen[TARGETS[-1]] is None
    assert study.spent <= 50
    assert re.search("both (time|space) .*both", " ".join(runner.stages)), "it goes on"


def together(mixed: float, *points: tuple[float, float]) -> Combined:
    """Return the answers for V = 3 (1 + 0.02 h) (1 + 0.04 k) + mixed h k, at h = k = 1 first."""

    def value(h: float, k: float) -> float:
        return 3 * (1 + 0.02 * h) * (1 + 0.04 * k) + mixed * h * k

    sizes = tuple(0.5**n for n in range(8))
    space = best_of([Refinement("s", sizes, tuple(value(h, 1) for h in sizes), 1)])
    time = best_of([Refinement("t", sizes, tuple(value(1, k) for k in sizes), 1)])
    pairs = tuple(Pair(value(h, k), value(h, 1), value(1, k)) for h, k in points)
    return Combined(space, time, value(1, 1), pairs)


def test_both_errors_together_cover_the_answer_to_a_product_and_its_mixed_part() -> None:
    both = together(0.002).best
    assert abs(both.value - 3) <= both.error < 0.01


@pytest.mark.parametrize("mixed", [0.03, -0.03])
def test_a_pair_shows_a_mixed_part_that_studies_of_one_factor_cannot_see(mixed: float) -> None:
    alone, helped = together(mixed), together(mixed, (0.25, 0.25))
    assert abs(alone.best.value - 3) > 2 * alone.best.error
    assert abs(helped.best.value - 3) <= helped.best.error
    finer = together(mixed, (0.25, 0.25), (0.0625, 0.0625))
    assert abs(finer.best.value - 3) <= finer.best.error < helped.best.error / 2


def test_a_pair_at_the_base_changes_nothing() -> None:
    alone, helped = together(0.002), together(0.002, (1, 1))
    assert helped.best.value == pytest.approx(alone.best.value)
    assert helped.best.error == pytest.approx(alone.best.error)


def test_nothing_is_known_of_both_where_one_is_not_known() -> None:
    unknown = Best(3.0, float("inf"), "s")
    assert Combined(unknown, Best(3.0, 0.1, "t"), 3.1).best.error == float("inf")


def test_a_forecast_adds_the_times_of_the_runs_that_are_needed() -> None:
    best = [Best(1.0, 0.0, "other")]
    expected = forecast([Refinement("a", (1, 0.5, 0.25), (1.16, 1.04, 1.01), 2)], best)
    assert expected.error == pytest.approx(0.01)
    assert expected.time(0.01 / 4**3, 5.0, 3.0) == pytest.approx(5 + 15 + 45)
    assert expected.time(0.02, 5.0, 3.0) == 0
    away = forecast([Refinement("a", (1, 0.5), (1.01, 1.04), 2)], best)
    assert away.time(0.01, 5.0, 3.0) == float("inf")
    assert forecast([Refinement("a", (1,), (1.0,), 2)], best) == Forecast()


def test_a_coarser_pair_does_not_change_the_mixed_part() -> None:
    for mixed in (0.0, 0.03, -0.03):
        assert together(mixed, (2.0, 4.0)).mixed == together(mixed).mixed
        assert together(mixed, (0.25, 4.0)).mixed == together(mixed).mixed
