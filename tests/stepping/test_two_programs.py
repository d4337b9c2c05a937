"""Two programs side by side: planned times, closed forms, energy, and what is refused."""

from __future__ import annotations

from itertools import pairwise
from math import cos, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from wovenfab import CaseError, read_case, simulate
from wovenfab.case import Case
from wovenfab.case.objects import differentiate, sheet_of, simulation_of
from wovenfab.case.program import program_of_case, steps_of_case
from wovenfab.forms.effect import Target
from wovenfab.stepping.program import Piece, cycle, ramp
from wovenfab.stepping.program import side_by_side as beside
from wovenfab.stepping.stability import StabilityLostError
from wovenfab.stepping.step import Step, StepFailedError

CONFIGS = Path(__file__).parents[2] / "configs"
SIDE, STIFFNESS = 0.2, (1.27e8, 0.45e8)
PULLED = {
    "left": {"displacement": [0, "free"]},
    "right": {"displacement": ["program", "free"]},
    "bottom": {"displacement": ["free", 0]},
    "top": {"displacement": ["free", "second_program"]},
}
ELASTIC = {
    "stretch": {"stiffness": ["1.27e8 N/m", "0.45e8 N/m"]},
    "shear": {"stiffness": "400 N/m"},
    "bending": {"stiffness": "254.1 N*m"},
}
SLIP = {"coupling": {"stiffness": "6e7 N/m^3"}, "slip_friction": {"strength": 2e5, "slope": 70}}
ONE = {"left": "clamp", "right": {"displacement": ["program", 0]}}
#: Each pulled edge holds its own family alone, so that the other slides.
SLIDING = PULLED | {
    "right": {"displacement": ["program", 0], "family": 1},
    "top": {"displacement": [0, "second_program"], "family": 2},
}
TURN = [
    {"type": "hold", "duration": 1, "steps": 2},
    {"type": "ramp", "to": "3 mm", "duration": 2, "steps": 3},
]


def square(**sections: Any) -> Case:
    """Return a square sheet with yarns along its sides, pulled in both directions."""
    base = {
        "sheet": {"length": SIDE, "width": SIDE, "fibres": ["0 deg", "90 deg"]},
        "effects": ELASTIC,
        "boundary": PULLED,
        "program": {"type": "ramp", "to": "2 mm", "duration": 1, "steps": 4},
        "second_program": TURN,
        "discretisation": {"degree": 2, "mesh_size": 0.1, "mesh": "crossed"},
    }
    return Case(**{k: v for k, v in (base | sections).items() if v is not None})


def steps_of(case: Case, *targets: Target) -> list[Step]:
    with simulation_of(case, sheet_of(case, MPI.COMM_WORLD)) as simulation:
        if targets:
            differentiate(simulation, case, targets)
        return list(simulation.steps())


def lengths(first: list[Piece], second: list[Piece]) -> list[tuple[float, int]]:
    return [(round(s.duration, 12), s.steps) for s in beside(first, second)[0]]


def test_planned_times_are_the_ends_of_both_with_the_steps_of_the_finer() -> None:
    first = [ramp(0.0, 1.0, 1.0, 4), ramp(1.0, 0.0, 2.0, 2)]
    assert lengths(first, [ramp(0.0, 1.0, 1.5, 3)]) == [(1.0, 4), (0.5, 1), (1.5, 2)]
    assert lengths([ramp(0.0, 1.0, 1.5, 3)], first) == [(1.0, 4), (0.5, 1), (1.5, 2)]
    assert lengths(first, [ramp(0.0, 1.0, 3.0, 60)]) == [(1.0, 20), (2.0, 40)]


def test_a_short_ramp_beside_a_long_hold_is_not_lost() -> None:
    short, day = [ramp(0.0, 1.0, 1e-3, 1)], [ramp(0.0, 0.0, 86400.0, 10)]
    for pieces in (beside(short, day), beside(day, short)):
        assert [(p.steps, p.duration) for p in pieces[0]] == [(1, 1e-3), (10, 86400.0 - 1e-3)]
        ends = {(one.path(one.duration, 0.0), then.path(0.0, 0.0)) for one, then in pieces}
        assert ends == {(0.0, 0.0), (1.0, 1.0)}


@pytest.mark.parametrize("sections", [{}, {"second_program": None, "boundary": ONE}])
def test_steps_end_at_extra_times_and_are_about_as_long_as_before(sections: Any) -> None:
    cycles = {"type": "cycles", "amplitudes": ["2 mm", "4 mm"], "frequency": "1 Hz"}
    usual = square(program=cycles, **sections)
    case = usual.changed({"time.extra_times": ["0.3 s", "1.255 s", "9 s"]})
    before, program = program_of_case(usual), program_of_case(case)
    planned, times = (np.array([m.time for m in p.milestones]) for p in (before, program))
    assert {0.3, 0.5, 1.0, 1.255, 1.5, 2.0} <= set(times)
    assert 9.0 not in times
    assert steps_of_case(case) == len(times) - 1 <= len(planned) + 1
    assert np.diff(times).max() <= np.diff(planned).max() + 1e-12
    np.testing.assert_allclose(program.cycles, before.cycles, rtol=1e-6)
    for t in times:
        assert program.value(t) == pytest.approx(before.value(t), abs=1e-17)
        assert program.second(t) == pytest.approx(before.second(t), abs=1e-17)


def test_ends_that_rounding_parts_are_one() -> None:
    thirds = [ramp(i / 10, (i + 1) / 10, 0.1, 1) for i in range(3)]
    assert sum(s.duration for s in thirds) != 0.3
    assert lengths(thirds, [ramp(0.0, 1.0, 0.3, 3)]) == [(0.1, 1)] * 3


def test_both_are_hit_exactly_and_the_shorter_one_stays() -> None:
    case = square(
        program={"type": "cycles", "amplitudes": ["2 mm", "4 mm"], "frequency": "0.7 Hz"},
        second_program=TURN,
    )
    program = program_of_case(case)
    other, alone = (
        program_of_case(square(program=segments, second_program=None, boundary=ONE))
        for segments in (case.program, TURN)
    )
    times = [m.time for m in program.milestones]
    assert steps_of_case(case) == len(times) - 1
    for end in (1.0, 3.0, *(i / 1.4 for i in range(5))):
        assert min(abs(t - end) for t in times) < 1e-12
    for t in (*times, *np.linspace(0, 3, 77)):
        assert program.second(t) == pytest.approx(alone.value(t), abs=1e-17)
        assert program.value(t) == pytest.approx(other.value(t), abs=1e-17)
    assert program.second(3.0) == program.second(9.0) == 3e-3
    np.testing.assert_allclose(program.cycles, other.cycles, rtol=1e-6)
    assert {round(t, 9) for t in program.reversals} == {round(t, 9) for t in other.reversals}
    jumps = [m.time for m in program.milestones if m.jump]
    assert jumps == pytest.approx([0.0, 1.0, 4 / 1.4])  # where the first begins to rest
    steps = np.diff(times)
    assert steps[:-1].max() / steps.min() < 3


def test_a_cycle_cut_in_pieces_is_the_same_motion() -> None:
    first = cycle(0.0, 1.0, 1.0, 20)
    pieces, _ = beside(first, [ramp(0.0, 1.0, 0.3, 3), ramp(1.0, 0.0, 0.9, 3)])
    assert [(p.starts_cycle, p.ends_cycle) for p in pieces] == [
        (True, False), (False, False), (False, True), (False, False)
    ]  # fmt: skip
    assert [p.jump for p in pieces] == [True, True, False, True]
    start = 0.0
    for piece in pieces[:3]:
        for t in np.linspace(0, piece.duration, 5):
            assert piece.path(t, 0.0) == pytest.approx((1 - cos(2 * pi * (start + t))) / 2)
        start += piece.duration
    for one, after in pairwise(pieces):
        assert one.path(one.duration, 0.0) == pytest.approx(after.path(0.0, 0.0), abs=1e-15)


@pytest.mark.mpi
def test_each_direction_has_the_force_of_its_own_yarns() -> None:
    steps = steps_of(square())
    u, v = (np.array([getattr(s, name) for s in steps]) for name in ("displacement", "second"))
    assert [s.time for s in steps] == pytest.approx([0, 0.25, 0.5, 0.75, 1, 5 / 3, 7 / 3, 3])
    assert u == pytest.approx([0, 5e-4, 1e-3, 1.5e-3, *[2e-3] * 4], abs=1e-17)
    assert v == pytest.approx([*[0] * 5, 1e-3, 2e-3, 3e-3], abs=1e-17)
    x, y = ([s.reactions[edge][i] for s in steps] for i, edge in enumerate(("right", "top")))
    assert x == pytest.approx(STIFFNESS[0] * u, rel=1e-9, abs=1e-5)
    assert y == pytest.approx(STIFFNESS[1] * v, rel=1e-9, abs=1e-5)
    energy = (STIFFNESS[0] * u[-1] ** 2 + STIFFNESS[1] * v[-1] ** 2) / 2
    assert sum(steps[-1].stored.values()) == pytest.approx(energy, rel=1e-9)
    assert steps[-1].work == pytest.approx(energy, rel=1e-9)


@pytest.mark.slow
def test_derivatives_by_parameters_see_the_second_program() -> None:
    def of(strength: float, *targets: Target) -> Step:
        slip = {**SLIP, "slip_friction": {"strength": strength, "slope": 70}}
        edges = SLIDING | {"right": {"displacement": [0, 0], "family": 1}}
        hold = {"type": "hold", "duration": 1, "steps": 1}
        case = square(effects=ELASTIC | slip, boundary=edges, program=hold)
        return steps_of(case, *targets)[-1]

    derivatives = of(2e5, Target("slip_friction", "strength")).derivatives
    assert derivatives is not None
    more, less = (sum(of(s).dissipated.values()) for s in (2.02e5, 1.98e5))
    assert derivatives.dissipated[0] == pytest.approx((more - less) / 4e3, rel=1e-3)


@pytest.mark.parametrize("scheme", ["bdf2", pytest.param("midpoint", marks=pytest.mark.slow)])
def test_a_program_in_proportion_is_a_formula_of_the_first(scheme: str) -> None:
    def with_top(program: str, share: str) -> dict[str, Any]:
        force = [f"{share} kN/m * {program}/1 mm", 0]
        top = {"displacement": [0, program], "family": 2}
        bottom = {"displacement": ["free", 0], "force": force}
        return {**SLIDING, "top": top, "bottom": bottom}

    cycles = {"type": "cycles", "amplitudes": "2 mm", "frequency": "3 Hz"}
    halves = {"type": "cycles", "amplitudes": "1 mm", "frequency": "3 Hz"}
    more: dict[str, Any] = {
        **{"effects": ELASTIC | SLIP, "time": {"scheme": scheme, "steps_per_cycle": 12}},
        "program": cycles,
    }
    cases = (
        square(**more, second_program=None, boundary=with_top("0.5*program", "1")),
        square(**more, second_program=halves, boundary=with_top("second_program", "1")),
    )
    one, two = (simulate(case).history for case in cases)
    assert one["dissipated"][-1] > 0
    assert set(two) - set(one) == {"second_displacement_m"}
    # The force is conjugate to the first program, which moves the top edge in one of them only.
    for name in set(one) - {"newton_iterations", "force_N", "force_transverse_N"}:
        scale = np.abs(one["energy_J" if name.endswith("_J") else name]).max()
        assert np.abs(two[name] - one[name]).max() <= 1e-12 * max(scale, 1e-9), name
    for a, b in zip(*map(steps_of, cases), strict=True):
        size = max(abs(f) for pair in a.reactions.values() for f in pair)
        for edge, force in a.reactions.items():
            assert b.reactions[edge] == pytest.approx(force, rel=1e-9, abs=1e-9 * size + 1e-9)
        of_top = 0.5 * a.reactions["top"][1]
        assert a.force - of_top == pytest.approx(b.force, rel=1e-9, abs=1e-9 * size + 1e-9)


def test_energy_balances_while_both_edges_move_with_friction() -> None:
    def imbalance(steps: int) -> float:
        moves = {"type": "cycles", "amplitudes": "2 mm", "frequency": "3 Hz"}
        other = {"type": "cycles", "amplitudes": "3 mm", "frequency": "2 Hz"}
        case = square(
            effects=ELASTIC | SLIP, boundary=SLIDING, program=moves, second_program=other,
            time={"steps_per_cycle": steps},
        )  # fmt: skip
        history = simulate(case).history
        assert history["dissipated"][-1] > 0
        return float(np.abs(history["imbalance"]).max() / history["work"].max())

    coarse, fine = imbalance(20), imbalance(40)
    assert fine < coarse / 3 and fine < 1e-3


def test_the_force_of_the_first_may_be_prescribed_beside_the_displacement_of_the_second() -> None:
    force = {"type": "ramp", "to": "100 kN", "duration": 1, "steps": 4}
    steps = steps_of(square(program=force))
    held = [s.displacement for s in steps[4:]]
    assert held == pytest.approx([1e5 / STIFFNESS[0]] * 4, rel=1e-6)
    assert [s.force for s in steps[4:]] == pytest.approx([1e5] * 4, rel=1e-6)
    assert steps[-1].reactions["top"][1] == pytest.approx(STIFFNESS[1] * 3e-3, rel=1e-9)


def test_a_failed_step_names_the_displacements_of_both_programs() -> None:
    far = [{"type": "ramp", "to": to, "duration": 1, "steps": 1} for to in ("20 mm", "40 mm")]
    case = square(
        boundary={"left": "clamp", "right": {"displacement": ["program", "second_program"]}},
        program=far[0], second_program=far[1],
        solver={"max_iterations": 1}, time={"smallest_step": 0.6},
    )  # fmt: skip
    told = r"\(displacement 20 mm, of the second program 40 mm\) even with a step of 1 s"
    with pytest.raises(StepFailedError, match=told):
        steps_of(case)


def test_a_loss_of_stability_names_the_displacements_of_both_programs() -> None:
    """Of a column along the yarns, pushed by the first program and drawn across by the second."""
    case = square(
        sheet={"length": 0.9, "width": 0.3, "fibres": ["0 deg", "90 deg"]},
        boundary={"left": "clamp", "right": {"displacement": ["program", "second_program"]}},
        program={"type": "ramp", "to": "-40 mm", "duration": 1, "steps": 4},
        second_program={"type": "ramp", "to": "1e-9 m", "duration": 1, "steps": 4},
    )
    told = r"\(displacement -[\d.]+ mm, known to [\d.e-]+ mm; of the second program [\d.e-]+ mm\) "
    with pytest.raises(StabilityLostError, match=told) as lost:
        steps_of(case)
    loss = lost.value.loss
    assert loss.second == pytest.approx(1e-9 * loss.displacement / -40e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"second_program": None}, "boundary.top: follows second_program, which the case has not"),
        ({"boundary": PULLED | {"top": "clamp"}}, "second_program: no edge uses it. For example"),
        (
            {"second_program": [{"type": "ramp", "to": "5 N", "duration": 1}]},
            "second_program.0: prescribes displacements only, no force. Let 'program' prescribe",
        ),
        (
            {"second_program": [{"type": "hold", "duration": 1}, {"type": "ramp", "to": 0}]},
            "second_program.1.to: the displacement is 0 m already",
        ),
        (
            {"effects": ELASTIC | SLIP, "second_program": [{"type": "ramp", "to": "1 mm"}]},
            "second_program.0: a velocity or a duration is needed",
        ),
        (
            {"accuracy": "1 %", "discretisation": {}},
            "accuracy: steps are chosen for one program only. Leave this key out, or 'second_pro",
        ),
        (
            {"boundary": PULLED | {"top": {"displacement": ["second_program", "second_program"]}}},
            "boundary.top: moves away along x from 'left', which it meets in a corner",
        ),
        (
            {"boundary": PULLED | {"top": {"displacement": ["free", "log(second_program/1m)*1m"]}}},
            "boundary.top.displacement.1: has no finite value",
        ),
        ({"boundary": PULLED | {"top": "second"}}, "expected 'clamp', 'clamp: rotation'"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_words(change: dict[str, Any], words: str) -> None:
    with pytest.raises(CaseError) as refused:
        square(**change)
    assert words in str(refused.value)


def test_a_case_with_two_programs_is_written_and_read_again(tmp_path: Path) -> None:
    case = read_case(CONFIGS / "programs" / "biaxial-in-turn.yaml")
    (tmp_path / "case.yaml").write_text(case.to_yaml())
    again = read_case(tmp_path / "case.yaml")
    assert (again.programs, again.boundary) == (case.programs, case.boundary)
    assert list(again.programs) == ["program", "second_program"]
    assert case.boundary["top"][0].follows == {"second_program"}
