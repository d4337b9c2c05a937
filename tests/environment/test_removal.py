"""Removing an environment removes nothing else."""

from __future__ import annotations

import fcntl
import os
import subprocess
from pathlib import Path

import pytest

from tests.environment.conftest import PROJECT, Machine

pytestmark = pytest.mark.slow

PRIVATE = ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "--mount", "--map-root-user"]
can_mount = pytest.mark.skipif(
    subprocess.run(
        [*PRIVATE, "mount", "-t", "tmpfs", "none", "/mnt"], capture_output=True
    ).returncode
    != 0,
    reason="private mounts are refused here",
)
# A bind mount from the same file system is what rm --one-file-system alone would cross.
MOUNTS = {"tmpfs": "mount -t tmpfs none {at}", "bind": "mount --bind {outside} {at}"}


def privately(script: str, machine: Machine) -> subprocess.CompletedProcess[str]:
    """Run a bash script in a mount namespace of its own."""
    command = [*PRIVATE, "bash", "-euc", script]
    settings = machine.variables()
    return subprocess.run(command, env=settings, capture_output=True, text=True, timeout=60)


def outside(machine: Machine) -> Path:
    """Make a folder of the user's with a file in it."""
    folder = machine.folder / "my data"
    folder.mkdir()
    (folder / "thesis").write_text("precious")
    return folder


@can_mount
@pytest.mark.parametrize("kind", MOUNTS)
@pytest.mark.parametrize("place", ["tree/mnt", "tree/a b\tc"])
def test_is_refused_while_something_is_mounted_below(
    machine: Machine, kind: str, place: str
) -> None:
    root, data = machine.root(), outside(machine)
    at = root / place
    at.mkdir()
    before = set(root.rglob("*"))
    mount = MOUNTS[kind].format(at=f"$'{at}'".replace("\t", "\\t"), outside=f"'{data}'")
    inside = f"$'{at / 'inside'}'".replace("\t", "\\t")
    run = privately(
        f"{mount}; touch {inside}; status=0\n"
        f"'{PROJECT}/env/enter' --remove || status=$?\n"
        f"test -e {inside} && echo intact; exit $status",
        machine,
    )
    assert (run.stdout, run.returncode) == ("intact\n", 1), run.stderr
    assert "unmount" in run.stderr
    assert str(at) in run.stderr
    assert set(root.rglob("*")) == before
    assert (data / "thesis").read_text() == "precious"
    assert machine.enter("--remove").returncode == 0
    assert not root.exists()


@can_mount
def test_half_made_one_is_not_removed_while_something_is_mounted_below(machine: Machine) -> None:
    root, data = machine.root(), outside(machine)
    root.rename(partial := root.with_suffix(".partial"))
    at = partial / "tree" / "mnt"
    at.mkdir()
    run = privately(f"mount --bind '{data}' '{at}'; '{PROJECT}/env/enter' --where", machine)
    assert run.returncode == 125
    assert "unmount" in run.stderr
    assert (partial / "tree" / "usr" / "bin" / "sh").exists()
    assert (data / "thesis").exists()
    assert machine.built == 1


@can_mount
def test_does_not_cross_a_file_system_even_where_the_mount_went_unseen(machine: Machine) -> None:
    at = machine.folder / "root" / "mnt"
    at.mkdir(parents=True)
    run = privately(
        f"mount -t tmpfs none '{at}'; touch '{at}/inside'\n"
        f". '{PROJECT}/env/lib/say.sh'; . '{PROJECT}/env/lib/remove.sh'\n"
        f"mounts_below() {{ :; }}\n"
        f"status=0; remove_tree '{at.parent}' || status=$?\n"
        f"test -e '{at}/inside' && echo intact; exit $status",
        machine,
    )
    assert (run.stdout, run.returncode) == ("intact\n", 1), run.stderr
    assert "could not remove all" in run.stderr


def test_leaves_no_root_and_no_cache_and_follows_no_links(machine: Machine) -> None:
    root, data = machine.root(), outside(machine)
    (root / "tree" / "data").symlink_to(data)
    jit = machine.roots.parent / "cache" / "fenics"
    jit.mkdir(parents=True)
    assert machine.enter("--remove").returncode == 0
    assert not root.exists()
    assert (data / "thesis").read_text() == "precious"
    assert [path.suffix for path in machine.roots.iterdir()] == [".lock"]
    assert not jit.exists()


def test_is_refused_for_a_link_in_the_place_of_the_folder(machine: Machine) -> None:
    root = machine.root()
    root.rename(elsewhere := machine.folder / "elsewhere")
    root.symlink_to(elsewhere)
    run = machine.enter("--remove")
    assert run.returncode == 1
    assert "is a link" in run.stderr
    assert (elsewhere / "tree" / "usr" / "bin" / "sh").exists()


def test_is_refused_while_a_command_runs_in_it(machine: Machine) -> None:
    root = machine.root()
    with (root / "ready").open() as use:
        fcntl.flock(use, fcntl.LOCK_SH)
        run = machine.enter("--remove")
        assert run.returncode == 1
        assert "a command runs in it" in run.stderr
        assert (root / "tree" / "usr" / "bin" / "sh").exists()
    assert machine.enter("--remove").returncode == 0
    assert not root.exists()
