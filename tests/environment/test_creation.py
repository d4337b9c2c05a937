"""The environment is made once, whole or not at all."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.environment.conftest import PROJECT, Machine

pytestmark = pytest.mark.slow


def wait_for(holds: Callable[[], bool]) -> None:
    """Wait until something holds, at most 20 s."""
    end = time.monotonic() + 20
    while not holds():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def test_is_made_once_and_reused(machine: Machine) -> None:
    first, second = machine.root(), machine.root()
    assert first == second
    assert machine.built == 1
    assert (first / "tree" / "usr" / "bin" / "sh").is_file()


def test_an_interrupted_creation_is_made_anew_and_what_it_left_removed(machine: Machine) -> None:
    half, given = machine.folder / "half", f"head -c 100000 '{machine.archive}'"
    machine.builder(f"touch \"$TMPDIR/left\"; {given}; touch '{half}'; exec sleep 60")
    process = machine.start("--where")
    wait_for(half.exists)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    assert not list(machine.roots.glob("*/ready"))
    (partial,) = machine.roots.glob("*.partial")
    scratch = Path((partial / "scratch").read_text().strip())
    assert (scratch / "left").exists()
    (partial / "tree" / "stale").touch()
    machine.builder()
    root = machine.root()
    assert (root / "tree" / "usr" / "bin" / "env").is_file()
    assert not (root / "tree" / "stale").exists()
    assert not scratch.exists()
    assert not partial.exists()
    assert machine.built == 2


@pytest.mark.parametrize("script", ["exit 1", "echo not a tar file; exit 0"])
def test_a_failed_creation_says_so_and_leaves_nothing(machine: Machine, script: str) -> None:
    machine.builder(script)
    run = machine.enter("--where")
    assert run.returncode == 125
    assert "could not be made" in run.stderr
    assert [p.suffix for p in machine.roots.iterdir()] == [".lock"]


def test_two_at_once_make_it_once_and_the_second_says_that_it_waits(machine: Machine) -> None:
    machine.builder(f"while [ ! -e '{machine.folder}/go' ]; do sleep 0.05; done")
    first = machine.start("--where")
    wait_for(lambda: machine.built == 1)
    second = machine.start("--where")
    assert second.stderr is not None
    assert "waiting" in second.stderr.readline()
    (machine.folder / "go").touch()
    answers = [process.communicate(timeout=60)[0].strip() for process in (first, second)]
    assert answers[0] == answers[1] == str(next(machine.roots.glob("*/ready")).parent)
    assert machine.built == 1


def test_another_package_list_is_another_environment_but_comments_and_order_are_not(
    clone: Machine,
) -> None:
    first, listed = clone.root(), clone.packages.read_text()
    lines = [line.split("#")[0] for line in listed.splitlines()]
    clone.packages.write_text("# other words\n\n" + "\n".join(reversed(lines)) + "\n")
    assert clone.root() == first
    clone.packages.write_text(listed + "hello  # one more\n")
    assert clone.root() != first
    assert clone.built == 2


def test_another_list_stands_beside_the_projects_own(machine: Machine) -> None:
    own, viewer = machine.root(), machine.folder / "viewer.txt"
    viewer.write_text("paraview  # looks at results\n")
    other = machine.root(WOVENFAB_PACKAGES=str(viewer))
    assert other != own
    assert (own / "ready").exists()
    assert (other / "ready").read_text() == "paraview\n"


def test_another_suite_is_another_environment_made_without_a_look_at_its_dates(
    machine: Machine,
) -> None:
    own = machine.root()
    machine.builder(f'printf "%s\\n" "$@" >\'{machine.folder}/asked\'')
    settings = {"WOVENFAB_SUITE": "sid", "WOVENFAB_MIRROR": "http://mirror/debian"}
    assert machine.root(**settings) != own
    asked = (machine.folder / "asked").read_text().splitlines()
    assert asked[-3:] == ["sid", "-", "deb [trusted=yes] http://mirror/debian sid main"]
    assert '--aptopt=Acquire::Check-Valid-Until "false"' in asked
    caches = [
        machine.enter("sh", "-c", 'echo "$XDG_CACHE_HOME"', WOVENFAB_ENTER="native", **suite).stdout
        for suite in ({}, settings)
    ]
    assert caches[1] == caches[0].strip() + "/sid\n"


def test_two_installations_at_once_wait_for_each_other(machine: Machine) -> None:
    script = f"""
        cache={machine.folder}; say() {{ :; }}; . '{PROJECT}/env/lib/tools.sh'
        apt-get() {{ mkdir {machine.folder}/busy && sleep 0.2 && rmdir {machine.folder}/busy; }}
        apt_install a & apt_install b & wait %1 && wait %2"""
    run = subprocess.run(["bash", "-euc", script], capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr


def test_an_environment_of_an_old_list_goes_after_30_days_without_use(clone: Machine) -> None:
    made = []
    for days in (31, 29, 0):
        clone.packages.write_text(f"unused for {days} days\n".replace(" ", "-"))
        made.append(clone.root())
        stamp = time.time() - days * 86400
        os.utime(made[-1] / "ready", (stamp, stamp))
    assert [root.exists() for root in made] == [False, True, True]


def test_says_what_to_install_where_it_cannot_work(machine: Machine) -> None:
    commands = machine.folder / "commands"
    commands.mkdir()
    hidden = {"mmdebstrap", "bwrap", "proot", "apt-get", "dpkg-query"}
    for file in Path("/usr/bin").iterdir():
        if file.name not in hidden:
            (commands / file.name).symlink_to(file)
    run = machine.enter("true", PATH=str(commands))
    assert run.returncode == 125
    assert "apt-get install mmdebstrap" in run.stderr
    assert "docker run" in run.stderr
    assert machine.built == 0
