"""Where results and pictures come from: the command and the commit that made them."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

#: Variable in which ``env/enter`` tells the commit of the code, ``+`` after it if changed.
COMMIT = "WOVENFAB_COMMIT"
#: Variable in which a command that starts others tells them what the user typed.
COMMAND = "WOVENFAB_COMMAND"


@dataclass(frozen=True)
class Provenance:
    """What made a file.

    Attributes:
        command: The command line; two that made it together have ``"; "`` between.
        commit: Commit of the code (several likewise), ``+`` after it where the code had
            changes that were not committed; empty where it is not known.
    """

    command: str
    commit: str

    def then(self, later: Provenance) -> Provenance:
        """Return what made a file for which one command used the results of another."""
        return Provenance(
            _together(self.command, later.command), _together(self.commit, later.commit)
        )


def this_process(ranks: int = 1) -> Provenance:
    """Return the command that the user typed for this process, and the commit of its code.

    Args:
        ranks: Number of MPI ranks that the command was started on.
    """
    commit = os.environ.get(COMMIT, "")
    if os.environ.get(COMMAND):
        return Provenance(os.environ[COMMAND], commit)
    spec = getattr(sys.modules.get("__main__"), "__spec__", None)
    module = spec.name.removesuffix(".__main__") if spec else ""
    program = ["python3", "-m", module] if module else [Path(sys.argv[0]).name]
    if module == "wovenfab":
        program = [module]
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    return Provenance(shlex.join([*launcher, *program, *sys.argv[1:]]), commit)


def of_summary(summary: Mapping[str, object]) -> Provenance | None:
    """Return what made a run, from its summary; None where that does not say it."""
    command = summary.get("command")
    return Provenance(str(command), str(summary.get("commit") or "")) if command else None


def _together(first: str, second: str) -> str:
    """Return both texts, or one where the other is empty or the same."""
    parts = dict.fromkeys([*first.split("; "), *second.split("; ")])
    return "; ".join(part for part in parts if part)
