"""A command in the environment behaves as if it ran on the machine itself."""

from __future__ import annotations

import os
import pwd
import shutil
import signal
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from tests.environment.conftest import Machine

pytestmark = pytest.mark.slow

TRIES = {
    "bwrap": ["bwrap", "--ro-bind", "/", "/", "--dev", "/dev", "--unshare-pid", "--proc", "/proc"],
    "proot": ["proot", "-r", "/"],
    "native": [],
}


@pytest.fixture(params=TRIES)
def way(request: pytest.FixtureRequest) -> str:
    """Each way in that works on this machine."""
    attempt = subprocess.run([*TRIES[request.param], "/usr/bin/true"], capture_output=True)
    if attempt.returncode != 0:
        pytest.skip(f"{request.param} is refused here")
    return str(request.param)


@pytest.mark.parametrize("code", [0, 3, 200])
def test_the_exit_code_is_the_commands(machine: Machine, way: str, code: int) -> None:
    assert machine.enter("sh", "-c", f"exit {code}", WOVENFAB_ENTER=way).returncode == code


def test_an_unknown_command_is_reported_as_by_a_shell(machine: Machine, way: str) -> None:
    assert machine.enter("no-such-command", WOVENFAB_ENTER=way).returncode == 127


def test_input_and_output_pass_through(machine: Machine, way: str) -> None:
    run = machine.enter("sh", "-c", "cat; echo aside >&2", given="warp\nweft\n", WOVENFAB_ENTER=way)
    assert run.stdout == "warp\nweft\n"
    assert "aside\n" in run.stderr


def test_arguments_arrive_unchanged(machine: Machine, way: str) -> None:
    words = ["a b", "", "*", "$HOME", "--flag", "x=1"]
    run = machine.enter("sh", "-c", 'printf "%s|" "$@"', "-", *words, WOVENFAB_ENTER=way)
    assert run.stdout == "|".join(words) + "|"


def test_paths_mean_the_same_inside(machine: Machine, way: str) -> None:
    script = f"pwd; echo 1 >result; echo 2 >'{machine.folder}/absolute result'"
    run = machine.enter("sh", "-c", script, WOVENFAB_ENTER=way)
    assert Path(run.stdout.strip()) == machine.folder.resolve()
    assert (machine.folder / "result").read_text() == "1\n"
    assert (machine.folder / "absolute result").read_text() == "2\n"


@pytest.mark.parametrize("kind", ["TERM", "HUP", "USR1"])
def test_a_signal_reaches_the_command(machine: Machine, way: str, kind: str) -> None:
    script = f"trap 'echo saved; exit 11' {kind}; echo up; while true; do sleep 0.05; done"
    process = machine.start("sh", "-c", script, WOVENFAB_ENTER=way)
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    subprocess.run(["kill", "-s", kind, str(process.pid)], check=True)
    out, _ = process.communicate(timeout=20)
    assert (out, process.returncode) == ("saved\n", 11)


def test_caches_are_found_again_at_the_next_start(machine: Machine, way: str) -> None:
    machine.enter("sh", "-c", 'echo kernel >"$XDG_CACHE_HOME/jit"', WOVENFAB_ENTER=way)
    run = machine.enter("sh", "-c", 'cat "$XDG_CACHE_HOME/jit"', WOVENFAB_ENTER=way)
    assert run.stdout == "kernel\n"


def test_runs_with_the_projects_settings(machine: Machine, way: str) -> None:
    run = machine.enter(
        "env", WOVENFAB_ENTER=way, OMP_NUM_THREADS="8", PETSC_OPTIONS="-snes_monitor"
    )
    inside = dict(line.split("=", 1) for line in run.stdout.splitlines() if "=" in line)
    assert inside["OMP_NUM_THREADS"] == "1"
    assert inside["PETSC_OPTIONS"] == "-snes_monitor"
    assert inside["PATH"].startswith(f"{machine.project}/env/bin:/usr/bin:")
    assert inside["PYTHONPATH"] == str(machine.project)


@pytest.mark.parametrize("way", ["bwrap", "proot"], indirect=True)
def test_the_machines_own_settings_stay_outside_a_root(machine: Machine, way: str) -> None:
    foreign = {"PYTHONHOME": "/opt/python", "LD_PRELOAD": "", "OMPI_COMM_WORLD_RANK": "3"}
    run = machine.enter("env", WOVENFAB_ENTER=way, **foreign)
    assert run.returncode == 0
    assert not any(name in run.stdout for name in foreign)


@pytest.mark.parametrize("way", ["bwrap"], indirect=True)
def test_a_bwrap_root_is_read_only(machine: Machine, way: str) -> None:
    for place in ("/lost", "/usr/lost", "/var/lost"):
        run = machine.enter("touch", place, WOVENFAB_ENTER=way)
        assert run.returncode == 1
        assert "Read-only" in run.stderr


def test_nothing_stays_mounted(machine: Machine, way: str) -> None:
    before = Path("/proc/self/mounts").read_text()
    assert machine.enter("true", WOVENFAB_ENTER=way).returncode == 0
    assert Path("/proc/self/mounts").read_text() == before


@pytest.mark.parametrize("way", ["bwrap", "proot"], indirect=True)
def test_a_running_command_keeps_its_root(machine: Machine, way: str) -> None:
    process = machine.start("sh", "-c", "echo up; cat", WOVENFAB_ENTER=way)
    assert process.stdout is not None
    process.stdout.readline()
    assert "a command runs in it" in machine.enter("--remove").stderr
    process.communicate("", timeout=20)
    assert process.returncode == 0


def test_an_unknown_way_in_is_refused(machine: Machine) -> None:
    run = machine.enter("true", WOVENFAB_ENTER="docker")
    assert run.returncode == 125
    assert "native, bwrap or proot" in run.stderr


def test_without_home_the_cache_is_in_the_home_folder_of_the_systems_list(machine: Machine) -> None:
    script = f". '{machine.project}/env/lib/say.sh'; . '{machine.project}/env/lib/root.sh'; "
    run = subprocess.run(
        ["bash", "-ec", script + "home_folder"], env={}, capture_output=True, text=True
    )
    assert (run.returncode, run.stdout.strip()) == (0, pwd.getpwuid(os.getuid()).pw_dir)


def test_a_home_folder_that_is_not_there_is_not_made(machine: Machine) -> None:
    home = machine.folder / "nowhere"
    run = machine.enter("true", WOVENFAB_ENTER="bwrap", XDG_CACHE_HOME="", HOME=str(home))
    assert run.returncode == 125
    assert "there is no home folder" in run.stderr
    assert not home.exists()


def test_a_colon_in_the_projects_path_is_refused(machine: Machine) -> None:
    project = machine.folder / "a:b"
    shutil.copytree(machine.project / "env", project / "env")
    run = replace(machine, project=project).enter("true")
    assert run.returncode == 125
    assert "has a colon" in run.stderr


def test_an_interrupt_from_a_program_reaches_the_command_once(machine: Machine, way: str) -> None:
    script = "n=0; trap 'n=$((n+1))' INT; echo up; sleep 1 & wait; wait; echo $n"
    process = machine.start("sh", "-c", script, WOVENFAB_ENTER=way)
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    os.kill(process.pid, signal.SIGINT)
    out, _ = process.communicate(timeout=20)
    assert (out, process.returncode) == ("1\n", 0)
