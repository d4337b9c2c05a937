"""MPI, whichever it is: loaded first, started by its own launcher, ended on all ranks together.

PyPI's wheel of dolfinx has MPICH, Debian has Open MPI. The libraries of that wheel find MPI only
if mpi4py has loaded it before; with Debian's packages this order changes nothing.
"""

from __future__ import annotations

import itertools
import os
import re
import shutil
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from wovenfab.lacking import LackingError

#: Variables in which launchers tell how many ranks they have started: Open MPI's and MPICH's.
SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")
#: The module of PyPI's wheel that loads its MPI and refuses another petsc4py.
WHEEL = "dolfinx_solver"


def load() -> Any:
    """Return mpi4py.MPI, which starts MPI where it has not been started.

    Raises:
        LackingError: The ranks were not started by the launcher of this MPI, or PyPI's wheel is
            incomplete.
    """
    if find_spec(WHEEL):
        try:
            import_module(WHEEL)
        except ImportError as error:  # mpi4py is missing, or another petsc4py is there
            raise LackingError(
                f"PyPI's wheel of dolfinx cannot be used: {error}; make a new environment and "
                "pip install 'wovenfab[wheels]' there"
            ) from error
    from mpi4py import MPI

    if _started() > 1 and MPI.COMM_WORLD.size == 1:
        raise LackingError(_foreign("another MPI", version_of(MPI)))
    return MPI


def require_own_launcher() -> None:
    """Refuse a launcher with which the MPI of PyPI's wheels would end this process at its start.

    Raises:
        LackingError: It is that of Open MPI.
    """
    if SIZES[0] in os.environ and find_spec(WHEEL):
        raise LackingError(_foreign("Open MPI", "the MPICH of PyPI's wheels"))


def version_of(mpi: Any) -> str:
    """Return name and version of the library that mpi4py.MPI has loaded, as ``MPICH 5.0.2``."""
    words = re.split(r"[\s,:]+", mpi.Get_library_version())
    name = itertools.takewhile(lambda word: word != "Version" and not word[-1:].isdigit(), words)
    number = next((word for word in words if word[-1:].isdigit()), "")
    return " ".join([*name, number.removeprefix("v")]).strip()


def _started() -> int:
    """Return how many ranks the launcher of this process says to have started; 0 without one."""
    given = [os.environ[name] for name in SIZES if os.environ.get(name, "").isdigit()]
    return int(given[0]) if given else 0


def _foreign(launcher: str, library: str) -> str:
    own = shutil.which(mpirun() or "") or "the mpirun of that"
    return (
        f"the ranks were started by the mpirun of {launcher}, but dolfinx was built with "
        f"{library}: start them by {own}, or by --ranks"
    )


class PetscStartError(Exception):
    """PETSc cannot use the options of a command line."""


def start_petsc(options: Sequence[str] = ()) -> None:
    """Start PETSc with options of a command line, unless it has been started.

    Files of options (``.petscrc``, ``petscrc``) are left out: those in the current folder may have
    come with a case, and options can run code and write files.

    Raises:
        PetscStartError: PETSc cannot use the options.
    """
    if options and not options[0].startswith("-"):
        raise PetscStartError(
            f"there is an argument too many: {options[0]}; PETSc options follow after a double "
            "dash, and begin with a dash each"
        )
    import petsc4py

    try:
        petsc4py.init(["wovenfab", "-skip_petscrc", *options])
    except Exception as error:
        if not options:
            raise
        raise PetscStartError(
            f"PETSc does not start with {' '.join(options)}: it cannot use one of the values"
        ) from error


def command_of(name: str) -> str | None:
    """Return how a program is called that was installed beside Python, or else anywhere in PATH.

    Returns:
        Its name, if PATH leads to it; its path, if it lies beside Python in an environment that
        is not activated; None if there is none.
    """
    beside, found = Path(sys.executable).with_name(name), shutil.which(name)
    if os.access(beside, os.X_OK) and not (found and Path(found).samefile(beside)):
        return str(beside)
    return name if found else None


def mpirun() -> str | None:
    """Return the command that starts ranks with the MPI of this Python; None if there is none."""
    return command_of("mpirun")


def on_ranks(ranks: int) -> list[str]:
    """Return the words before a command that is to run on MPI ranks; none for one rank."""
    return [mpirun() or "mpirun", "-n", str(ranks)] if ranks > 1 else []


def abort() -> None:
    """End all ranks if there are others, which would wait for this one without end."""
    mpi: Any = sys.modules.get("mpi4py.MPI")
    if mpi and mpi.Is_initialized() and not mpi.Is_finalized() and mpi.COMM_WORLD.size > 1:
        sys.stdout.flush()
        sys.stderr.flush()
        mpi.COMM_WORLD.Abort(1)
