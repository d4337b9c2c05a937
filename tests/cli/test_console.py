"""What is printed: the progress in a log, and texts from outside as they are."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from tests.cli.test_commands import wovenfab
from wovenfab.cli.console import Console
from wovenfab.parallel import child_environment
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


#: Markup, sequences that set the title of a terminal, other controls, a change of direction.
NASTY = "tc[/b] [red]x \x1b]0;title\x07 \x9b31m \x00 \u202ert \u2028 \\[ :smile:"


def on_terminal(script: str) -> str:
    """Return what a script prints on a terminal."""
    code = f"from wovenfab.cli.console import Console\nNASTY = {NASTY!r}\n{script}"
    reader, terminal = pty.openpty()
    environment = child_environment() | {"COLUMNS": "200", "TERM": "dumb", "NO_COLOR": "1"}
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=terminal, stderr=terminal, env=environment
    )
    os.close(terminal)
    said = b""
    with suppress(OSError):  # the end of a terminal
        while part := os.read(reader, 4096):
            said += part
    os.close(reader)
    assert process.wait() == 0, said.decode()
    return said.decode()


def test_messages_show_as_they_are_and_control_no_terminal() -> None:
    calls = [f"c.{name}(NASTY)" for name in ("say", "problem", "log")]
    script = "\n".join(["c = Console()", *calls, "with c:", *(f"    {call}" for call in calls)])
    said = on_terminal(script)
    shown = r"tc[/b] [red]x \x1b]0;title\x07 \x9b31m \x00 \u202ert \u2028 \[ :smile:"
    assert said.count(shown) == 2 * len(calls)
    assert not {"\x07", "\x00", "\x9b", "\u202e"} & {*said} and "\x1b]" not in said


def test_names_and_phases_below_the_bar_are_plain() -> None:
    said = on_terminal(
        "from wovenfab.simulation.progress import Progress\n"
        "with Console() as c:\n    c.progress(Progress(NASTY, 0.5)); c.rows({NASTY: 0.5})\n"
    )
    assert said.count(r"tc[/b] [red]x \x1b]0;title\x07") >= 2
    assert "\x07" not in said and "\x1b]" not in said


def test_an_argument_with_control_characters_is_refused_and_spelled_out(tmp_path: Path) -> None:
    ended = wovenfab("report", "a\x1b]0;x\x07", cwd=tmp_path)
    assert ended.returncode == 2 and r"\x1b]0;x\x07" in ended.stderr
    assert "\x1b" not in ended.stderr + ended.stdout


@pytest.mark.parametrize(
    "word", ["[/x]", *(pytest.param(w, marks=pytest.mark.slow) for w in ("[x", "./case.yaml"))]
)
def test_a_word_that_is_no_command_is_bad_input(word: str, tmp_path: Path) -> None:
    ended = wovenfab(word, cwd=tmp_path)
    assert ended.returncode == 2 and not ended.stdout
    assert word in ended.stderr
