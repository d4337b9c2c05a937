"""Load programs: what is planned is hit exactly."""

from __future__ import annotations

from itertools import pairwise
from math import cos, pi
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from wovenfab.case import CyclesSection, HoldSection, RampSection, TableSection
from wovenfab.case.program import program_of_case
from wovenfab.case.schema import Time
from wovenfab.stepping.program import Program, cycle, program_of, ramp, table

AMPLITUDES = (0.02, 0.037, 0.0403)


def planned(*segments: object, steps: int = 40) -> Program:
    """Return the program of the segments of a case."""
    time = Time.model_validate({"steps_per_cycle": steps})
    return program_of_case(SimpleNamespace(programs={"program": segments}, time=time))  # type: ignore[arg-type]


def cycles(**speed: str) -> CyclesSection:
    amplitudes = [f"{a} m" for a in AMPLITUDES]
    return CyclesSection.model_validate({"type": "cycles", "amplitudes": amplitudes, **speed})


def ramp_to(to: str, steps: int, **speed: str) -> RampSection:
    return RampSection(type="ramp", to=to, steps=steps, **speed)


def hold(duration: str, steps: int) -> HoldSection:
    return HoldSection(type="hold", duration=duration, steps=steps)


@pytest.mark.parametrize(
    ("speed", "periods"),
    [
        ({"max_velocity": "0.5 m/s"}, [pi * a / 0.5 for a in AMPLITUDES]),
        ({"frequency": "0.7 Hz"}, [1 / 0.7] * 3),
    ],
    ids=["same velocity", "same frequency"],
)
def test_reversals_are_hit_bit_for_bit(speed: dict[str, str], periods: list[float]) -> None:
    program = planned(cycles(**speed))
    points = program.milestones
    assert len(points) == 3 * 40 + 1
    start = 0.0
    for i, (amplitude, period) in enumerate(zip(AMPLITUDES, periods, strict=True)):
        top, end = points[40 * i + 20], points[40 * i + 40]
        assert (top.time, top.value) == (start + period / 2, amplitude)
        begun, start = start, top.time + period / 2
        assert (end.time, end.value) == (start, 0.0)
        assert program.cycles[i] == (begun, start)
        for point in (top, end):
            assert program.value(point.time) == point.value


@pytest.mark.parametrize("speed", [{"max_velocity": "0.5 m/s"}, {"frequency": "0.7 Hz"}])
def test_cycles_have_their_largest_velocity_or_their_frequency(speed: dict[str, str]) -> None:
    program = planned(cycles(**speed), steps=4000)
    times, moved = np.array([(m.time, m.value) for m in program.milestones]).T
    peaks = (np.diff(moved) / np.diff(times)).reshape(3, 4000).max(axis=1)
    periods = np.diff(times[::4000])
    if "max_velocity" in speed:
        assert peaks == pytest.approx(0.5, rel=1e-6)
    else:
        assert 1 / periods == pytest.approx(0.7, rel=1e-12)
        assert peaks == pytest.approx(pi * 0.7 * np.array(AMPLITUDES), rel=1e-6)


def test_a_cycle_begins_where_its_segment_does() -> None:
    ramps = [ramp(0.0, 0.01, 0.25, 3), ramp(0.01, 0.02, 0.5, 3)]
    first, second = (cycle(base, 0.05, 2.0, 16) for base in (0.01, 0.02))
    program = program_of([ramps[0], *first, *first, ramps[1], *second])
    assert program.cycles == [(0.25, 2.25), (2.25, 4.25), (4.75, 6.75)]
    assert program_of(ramps).cycles == []


def test_a_cycle_follows_its_closed_form_and_starts_where_the_last_segment_ended() -> None:
    program = program_of([ramp(0.0, 0.01, 0.3, 3), *cycle(0.01, 0.05, 2.0, 16)])
    for t in np.linspace(0.3, 2.3, 101):
        expected = 0.01 + 0.025 * (1 - cos(2 * pi * (t - 0.3) / 2.0))
        assert program.value(t) == pytest.approx(expected, abs=1e-15)
    assert program.milestones[-1].value == 0.01
    assert program.value(99.0) == 0.01


def test_milestones_lie_on_the_program_bit_for_bit_whatever_went_before() -> None:
    program = planned(
        cycles(max_velocity="0.3 m/s"),
        ramp_to("31 mm", 7, duration="0.7 s"),
        hold("0.1 s", 3),
        ramp_to("-3 mm", 9, velocity="11 mm/s"),
    )
    for point in program.milestones:
        assert program.value(point.time) == point.value
    ends = [program.milestones[i] for i in (127, 130, 139)]
    assert [m.value for m in ends] == [0.031, 0.031, -0.003]
    assert ends[1].time - ends[0].time == pytest.approx(0.1, rel=1e-12)
    assert ends[2].time - ends[1].time == pytest.approx(0.034 / 0.011, rel=1e-12)


def test_a_hold_keeps_the_displacement_and_both_its_ends_are_jumps_of_the_velocity() -> None:
    program = planned(
        ramp_to("10 mm", 4, duration="1 s"), hold("2 s", 5), ramp_to("0 mm", 4, duration="1 s")
    )
    held = program.milestones[4:10]
    assert {m.value for m in held} == {0.01}
    assert [m.jump for m in program.milestones if m.jump] == [True] * 3
    assert [program.milestones[i].jump for i in (0, 4, 9)] == [True] * 3


def test_cycles_never_jump_in_velocity() -> None:
    assert not any(m.jump for m in planned(cycles(frequency="1 Hz")).milestones)


def test_a_table_is_hit_at_every_row_and_jumps_at_its_corners_only(tmp_path: Path) -> None:
    times = [0.5, 1.0, 1.25, 3.0, 3.5]
    moved = [0.010, 0.019, 0.0235, -0.01, -0.01]  # about 20, 18, 18 mm/s, back, at rest
    rows = "\n".join(f"{t},{d}" for t, d in zip(times, moved, strict=True))
    (tmp_path / "u.csv").write_text(f"time_s,displacement_m\n{rows}\n")
    row = {"type": "table", "file": "u.csv"}
    program = planned(TableSection.model_validate(row, context={"folder": tmp_path}))
    points = [(m.time, m.value) for m in program.milestones]
    assert points == [(0.0, 0.0), *zip(times, moved, strict=True)]
    assert [m.jump for m in program.milestones] == [True, False, False, True, True, False]
    assert program.value(0.75) == pytest.approx(0.0145, rel=1e-12)


def test_a_finely_sampled_smooth_curve_has_no_corner_after_its_start() -> None:
    times = np.linspace(0.0, 2.0, 81)
    moved = 0.02 * (1 - np.cos(pi * times))
    program = program_of(table(0.0, tuple(times), tuple(moved)))
    inner = [m.jump for m in program.milestones[2:-2]]
    reversal = 40 - 2  # there the velocity passes through zero
    assert not any(jump for i, jump in enumerate(inner) if abs(i - reversal) > 1)


def test_times_grow_strictly_over_all_kinds_of_segments() -> None:
    program = planned(cycles(max_velocity="0.5 m/s"), hold("1 ms", 7), cycles(frequency="3 Hz"))
    assert all(a.time < b.time for a, b in pairwise(program.milestones))


def test_reversals_are_where_the_motion_turns_back() -> None:
    program = planned(
        cycles(frequency="1 Hz"),
        ramp_to("10 mm", 3, velocity="0.1 m/s"),
        hold("1 s", 2),
        ramp_to("20 mm", 3, velocity="0.1 m/s"),
        hold("1 s", 2),
        ramp_to("0 mm", 3, velocity="0.1 m/s"),
    )
    assert sorted(program.reversals) == pytest.approx([0.5, 1, 1.5, 2, 2.5, 3, 5.2])
    assert program.reversals <= {m.time for m in program.milestones}
