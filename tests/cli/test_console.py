"""What a run says of its progress in a log."""

from __future__ import annotations

import pytest

from wovenfab.cli.console import Console
from wovenfab.simulation.progress import Progress
from wovenfab.stepping.step import Step


def step(number: int, iterations: int, cutbacks: int) -> Step:
    return Step(number, 0.0, 0.002, {}, {}, {}, 0.0, iterations, cutbacks, None)


def test_a_log_tells_the_time_left_at_the_present_pace_once_it_can_be_known(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    voice = Console()
    voice.progress(Progress("stepping", unknowns=12))
    for clock[0], done, accepted in (
        (1.0, 0.0001, step(1, 1, 0)),  # too soon for another line
        (10.0, 0.001, step(2, 1, 1)),
        (20.0, 0.301, step(3, 3, 2)),  # 30 % in 10 s, whatever was before
    ):
        voice.progress(Progress("stepping", done, accepted))
    assert capsys.readouterr().out.splitlines() == [
        "stepping (12 unknowns)",
        "  0%  step 2: 2 mm, 1 iteration, cut back 1 time",
        " 30%  step 3: 2 mm, 3 iterations, cut back 2 times, 23 s left",
    ]
