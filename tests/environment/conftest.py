"""A user's machine for env/enter: a cache of its own and a builder that takes no time."""

from __future__ import annotations

import os
import shutil
import subprocess
import tarfile
from dataclasses import dataclass
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2]
COMMANDS = ("sh", "env", "cat", "sleep", "touch", "true", "pwd")


@pytest.fixture(scope="session")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tar file of a root that can run a few commands."""
    files = {shutil.which(name) or name for name in COMMANDS}
    loaded = subprocess.run(["ldd", *files], capture_output=True, text=True, check=True).stdout
    files |= {word for word in loaded.split() if word.startswith("/") and word[-1] != ":"}
    archive = tmp_path_factory.mktemp("tiny") / "tiny.tar"
    with tarfile.open(archive, "w", dereference=True) as tar:
        # In /usr, into which /bin and /lib are links
        for file in sorted({Path(file).parent.resolve() / Path(file).name for file in files}):
            tar.add(file, arcname=f".{file}")
        tar.add("/etc/passwd", arcname="./etc/passwd")
        for link in ("bin", "lib", "lib64"):
            entry = tarfile.TarInfo(f"./{link}")
            entry.type, entry.linkname = tarfile.SYMTYPE, f"usr/{link}"
            tar.addfile(entry)
    return archive


@dataclass(frozen=True)
class Machine:
    """A cache folder, a builder in mmdebstrap's place, and starts of env/enter.

    Attributes:
        folder: Where everything lies.
        archive: Tar file that the builder hands over.
        project: Folder whose env/enter is started.
    """

    folder: Path
    archive: Path
    project: Path = PROJECT

    @property
    def roots(self) -> Path:
        """Folder of the roots."""
        return self.folder / "cache" / "wovenfab" / "roots"

    @property
    def packages(self) -> Path:
        """List of packages."""
        return self.project / "env" / "packages.txt"

    @property
    def built(self) -> int:
        """How often the builder was started."""
        log = self.folder / "built"
        return len(log.read_text().splitlines()) if log.exists() else 0

    def builder(self, script: str = "") -> None:
        """Put a builder in place; it logs its start, runs lines of sh, hands over the root."""
        path = self.folder / "builder"
        lines = ["#!/bin/sh", f"echo x >>'{self.folder}/built'", script, f"cat '{self.archive}'"]
        path.write_text("\n".join(lines) + "\n")
        path.chmod(0o755)

    def variables(self, **changes: str) -> dict[str, str]:
        """Return the variables of a start, without the surrounding environment's own."""
        kept = {k: v for k, v in os.environ.items() if not k.startswith("WOVENFAB_")}
        own = {
            "XDG_CACHE_HOME": str(self.folder / "cache"),
            "TMPDIR": str(self.folder),
            "WOVENFAB_MMDEBSTRAP": str(self.folder / "builder"),
        }
        return kept | own | changes

    def start(self, *command: str, **changes: str) -> subprocess.Popen[str]:
        """Start env/enter in a process group of its own, with changed variables."""
        return subprocess.Popen(
            [self.project / "env" / "enter", *command],
            env=self.variables(**changes),
            cwd=self.folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def enter(
        self, *command: str, given: str = "", **changes: str
    ) -> subprocess.CompletedProcess[str]:
        """Run env/enter to its end with an input."""
        process = self.start(*command, **changes)
        out, err = process.communicate(given, timeout=60)
        return subprocess.CompletedProcess(command, process.returncode, out, err)

    def root(self, **changes: str) -> Path:
        """Return the root's folder, made with the builder in place."""
        run = self.enter("--where", **changes)
        assert run.returncode == 0, run.stderr
        return Path(run.stdout.strip())


@pytest.fixture
def machine(tmp_path: Path, archive: Path) -> Machine:
    """A machine with an empty cache."""
    machine = Machine(tmp_path, archive)
    machine.builder()
    return machine


@pytest.fixture
def clone(machine: Machine) -> Machine:
    """The same machine with a project folder whose package list may be changed."""
    project = machine.folder / "project"
    shutil.copytree(PROJECT / "env", project / "env")
    return Machine(machine.folder, machine.archive, project)
