"""A user's machine for env/enter: a cache of its own and a builder that takes no time."""

from __future__ import annotations

import os
import shutil
import subprocess
import tarfile
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).parents[2]
COMMANDS = ("sh", "env", "cat", "sleep", "touch", "true", "pwd")


def tiny_root(folder: Path) -> Path:
    """Return a tar file of a root that can run a few commands.

    Args:
        folder: An empty folder to work in.
    """
    files = {Path(shutil.which(name) or name) for name in COMMANDS}
    for file in list(files):
        loaded = subprocess.run(["ldd", file], capture_output=True, text=True, check=True).stdout
        files |= {Path(word) for word in loaded.split() if word.startswith("/")}
    archive = folder / "tiny.tar"
    with tarfile.open(archive, "w", dereference=True) as tar:
        for name in sorted({str(_in_usr(file)) for file in files}):
            tar.add(name, arcname=f".{name}")
        tar.add("/etc/passwd", arcname="./etc/passwd")
        for link in ("bin", "lib", "lib64"):
            entry = tarfile.TarInfo(f"./{link}")
            entry.type, entry.linkname = tarfile.SYMTYPE, f"usr/{link}"
            tar.addfile(entry)
    return archive


def _in_usr(file: Path) -> Path:
    """Return the file's path below /usr, into which /bin and /lib are links."""
    return file if file.is_relative_to("/usr") else Path("/usr") / file.relative_to("/")


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
    def built(self) -> int:
        """How often the builder was started."""
        log = self.folder / "built"
        return len(log.read_text().splitlines()) if log.exists() else 0

    def builder(self, script: str = "") -> Path:
        """Put a builder in place; it logs its start, runs the script, hands over the root.

        Args:
            script: Lines of sh; an ``exit`` in them ends the builder.
        """
        path = self.folder / "builder"
        lines = ["#!/bin/sh", f"echo x >>'{self.folder}/built'", script, f"cat '{self.archive}'"]
        path.write_text("\n".join(lines) + "\n")
        path.chmod(0o755)
        return path

    def variables(self, **changes: str) -> dict[str, str]:
        """Return the variables of a start, without the surrounding environment's own."""
        kept = {k: v for k, v in os.environ.items() if not k.startswith("WOVENFAB_")}
        own = {
            "XDG_CACHE_HOME": str(self.folder / "cache"),
            "TMPDIR": str(self.folder),
            "WOVENFAB_MMDEBSTRAP": str(self.folder / "builder"),
        }
        return kept | own | changes

    def start(self, *arguments: str | Path, **changes: str) -> subprocess.Popen[str]:
        """Start env/enter in a process group of its own."""
        return subprocess.Popen(
            [self.project / "env" / "enter", *arguments],
            env=self.variables(**changes),
            cwd=self.folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def enter(
        self, *arguments: str | Path, given: str = "", **changes: str
    ) -> subprocess.CompletedProcess[str]:
        """Run env/enter to its end.

        Args:
            arguments: The command.
            given: Its standard input.
            changes: Variables.
        """
        process = self.start(*arguments, **changes)
        out, err = process.communicate(given, timeout=60)
        return subprocess.CompletedProcess(arguments, process.returncode, out, err)

    def root(self) -> Path:
        """Return the root's folder, made with the builder in place."""
        run = self.enter("--where")
        assert run.returncode == 0, run.stderr
        return Path(run.stdout.strip())
