"""What is told of a process that failed, and how processes are started and end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from wovenfab.study import runner
from wovenfab.study.runner import Command, Ended, execute, execute_all, here

RULE = "-" * 74
REFUSED = f"{RULE}\nThe launcher does not run\nas root.\n\nIt may be told to.\n{RULE}"


@pytest.mark.parametrize(
    ("output", "told"),
    [
        pytest.param("reading\nerror: no such file", "error: no such file", id="its last line"),
        pytest.param(
            f"error: no such file\n{RULE}\nOne process has failed.\n{RULE}",
            "error: no such file",
            id="not what the launcher says of it",
        ),
        pytest.param(REFUSED, "The launcher does not run as root.", id="why it was not launched"),
        pytest.param("", "exit code 3", id="the exit code of a silent one"),
    ],
)
@pytest.mark.parametrize("logged", [False, True])
def test_the_useful_line_is_told(output: str, told: str, logged: bool, tmp_path: Path) -> None:
    script = tmp_path / "fails.py"
    script.write_text(f"import sys\nprint({output!r}, file=sys.stderr)\nsys.exit(3)\n")
    log = tmp_path / "log" if logged else None
    assert execute(Command([str(script)], log=log)).failure == told


def test_a_command_ends_with_the_process_that_started_it_even_if_that_is_killed(
    tmp_path: Path,
) -> None:
    place = tmp_path / "pid"
    code = f"import os, time; open({str(place)!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    script = (
        f"from wovenfab.study.runner import Command, execute; execute(Command(['-c', {code!r}]))"
    )
    with subprocess.Popen([sys.executable, "-c", script]) as parent:
        until = time.monotonic() + 30
        while not (place.exists() and place.read_text()) and time.monotonic() < until:
            time.sleep(0.05)
        parent.kill()
    child = int(place.read_text())
    while is_running(child) and time.monotonic() < until:
        time.sleep(0.05)
    assert not is_running(child)


def is_running(process: int) -> bool:
    """Return whether a process is there, and no zombie that nobody has waited for."""
    with suppress(OSError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def ignored_signals(status: str) -> int:
    """Return the mask of ignored signals in the text of /proc/PID/status."""
    return int(next(x.split()[1] for x in status.splitlines() if x.startswith("SigIgn")), 16)


def test_a_command_has_its_own_number_and_the_usual_signals() -> None:
    """It is not a child of what was started: it became the command, with nothing more ignored."""
    code = (
        "import os, json; from pathlib import Path;"
        "print(json.dumps([os.getppid(), os.getpgid(0) == os.getpid(), "
        "Path('/proc/self/status').read_text()]))"
    )
    parent, leads, status = execute(Command(["-S", "-c", code])).result
    assert parent == os.getpid() and leads
    usual = subprocess.run(
        [sys.executable, "-S", "-c", code], capture_output=True, text=True, check=True
    )
    assert ignored_signals(status) == ignored_signals(json.loads(usual.stdout)[2])


def test_a_program_that_is_missing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "on_ranks", lambda _: ["no-such-launcher"])
    told = "no-such-launcher cannot be started: No such file or directory"
    assert execute(Command(["-c", ""])).failure == told


def test_a_command_has_time_to_end_when_it_is_told_to_and_one_that_does_not_is_killed(
    tmp_path: Path,
) -> None:
    tidies = "import signal, sys, time; signal.signal(signal.SIGTERM, lambda *_: sys.exit(tidy()));"
    tidies += f"tidy = lambda: (time.sleep(2), open({str(tmp_path / 'tidy')!r}, 'w')) and 7;"
    stays = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN);"
    ends: dict[int, Ended] = {}
    execute_all(
        [Command(["-S", "-c", f"{code} time.sleep(60)"], limit=1.0) for code in (tidies, stays)],
        here(2),
        ends.__setitem__,
    )
    assert (tmp_path / "tidy").exists() and ends[0].code == 7
    assert ends[1].code == -signal.SIGKILL and ends[1].seconds < 30


def test_who_waits_hears_of_it_several_times_a_second() -> None:
    heard: list[float] = []
    execute(Command(["-S", "-c", "import time; time.sleep(2)"]), heard.append)
    assert 4 <= len(heard) <= 30


def test_results_that_another_process_leaves_are_waited_for_longer_than_its_end_can_take(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A command ends within two periods of grace; one that never does is not waited for."""
    now = [0.0]
    monkeypatch.setattr(runner, "is_in_use", lambda _: True)
    monkeypatch.setattr(runner.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(runner.time, "sleep", lambda s: now.__setitem__(0, now[0] + s))
    runner._await(tmp_path, lambda: False)
    assert 2 * (2 * runner._GRACE) < now[0] < 600
