"""What the solver logs: each iteration on DEBUG, lasting decisions with their reason on INFO."""

from __future__ import annotations

import logging
import re

import pytest

from tests import scenes
from wovenfab.solver.back_off import BackOff
from wovenfab.solver.problem import Problem
from wovenfab.stepping.program import cycle, program_of

NEWTON, EQUILIBRIUM = "wovenfab.solver.newton", "wovenfab.solver.equilibrium"


@pytest.mark.parametrize(
    ("names", "placements"), [(scenes.BONDED, 1), (scenes.COUPLED, 2)], ids=["one", "two"]
)
def test_each_iteration_is_a_line_with_norms_step_potential_tangent_and_linear_solver(
    names: tuple[str, ...], placements: int, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG, logger="wovenfab")
    equilibrium = scenes.solver(scenes.model(scenes.sheet(), names, scenes.PROTOTYPE))
    equilibrium.problem.prescribe(0.02)
    result = equilibrium.solve()
    lines = [r.getMessage() for r in caplog.records if r.name == NEWTON]
    assert len(lines) == result.iterations + 1
    number = r"-?\d\.\d+e[+-]\d+"
    for iteration, line in enumerate(lines):
        norms = ", ".join(rf"\|r_{i}\| {number}" for i in range(1, placements + 1))
        head = rf" +{iteration} \|r\| {number} N \({norms}\), potential {number} J, "
        tail = (
            "start"
            if not iteration
            else r"step [\d.]+, tangent plain, (new factor|\d+ CG iterations)"
        )
        assert re.fullmatch(head + tail, line), line
    last = re.search(rf"\|r\| ({number})", lines[-1])
    assert last and float(last[1]) == pytest.approx(result.residual, rel=1e-5)
    squares = sum(float(n) ** 2 for n in re.findall(rf"\|r_\d\| ({number})", lines[-1]))
    assert squares**0.5 == pytest.approx(result.residual, rel=1e-3)
    equilibrium.destroy()


def test_nothing_is_evaluated_for_a_log_that_is_off(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(self: Problem) -> list[float]:
        raise AssertionError

    caplog.set_level(logging.INFO, logger="wovenfab")
    monkeypatch.setattr(Problem, "residual_norms", fail)
    equilibrium = scenes.solver(scenes.model(scenes.sheet(), scenes.BONDED, scenes.PROTOTYPE))
    equilibrium.problem.prescribe(0.02)
    assert equilibrium.solve().converged
    assert not [r for r in caplog.records if r.name == NEWTON]
    equilibrium.destroy()


def test_a_back_off_is_logged_with_its_reason_and_length(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger="wovenfab")
    back_off = BackOff("it fails")
    for length in (1, 2):
        back_off.fail()
        assert caplog.messages[-1] == f"it fails: not tried the next {length} times"


def test_a_change_to_stress_at_points_is_logged_with_its_reason_and_ends_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO, logger="wovenfab")
    sharp = {**scenes.TABLE_1, "slip_friction": {"strength": 199.2e3, "slope": 1e7}}
    names = (*scenes.COUPLED, "slip_friction")
    model = scenes.model(scenes.sheet(), names, scenes.PROTOTYPE, sharp)
    scenes.march(model, program_of(cycle(0.0, 0.04, 0.25, 8)))
    messages = [r.getMessage() for r in caplog.records if r.name == EQUILIBRIUM]
    assert 1 < len(messages) < 8
    assert all(re.search("stress at quadrature points: .* DIVERGED", m) for m in messages)
    tried = [r.args[1] for r in caplog.records if r.name == EQUILIBRIUM and r.args]
    assert len(tried) == len(messages) and max(tried) <= 12  # of 30 that a step may take
    waits = [m for m in caplog.messages if m.startswith("friction by its smooth law fails")]
    assert [int(re.findall(r"\d+", m)[0]) for m in waits] == [2**k for k in range(len(messages))]


def test_a_smooth_law_that_newton_solves_in_a_few_iterations_stays(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO, logger="wovenfab")
    model = scenes.model(scenes.sheet(), (*scenes.COUPLED, "slip_friction"), scenes.PROTOTYPE)
    steps = scenes.march(model, program_of(cycle(0.0, 0.04, 0.25, 8)))
    assert 4 < max(step.iterations for step in steps) < 12
    assert not [r for r in caplog.records if r.name == EQUILIBRIUM]
