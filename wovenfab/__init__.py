"""wovenfab: how woven fabrics stretch, shear, bend, slip and dissipate.

Three lines in a notebook or a script, also under ``mpirun``::

    case = wovenfab.read_case("configs/bias-1x3.yaml", {"program.amplitudes": "40 mm"})
    run = wovenfab.simulate(case)
    run.history["force"]
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from wovenfab.case import Case, CaseError, read_case
    from wovenfab.interface import (
        History,
        Run,
        SolvedStep,
        StepOverError,
        read_results,
        simulate,
        steps,
    )

__all__ = [
    "Case",
    "CaseError",
    "History",
    "Run",
    "SolvedStep",
    "StepOverError",
    "__version__",
    "read_case",
    "read_results",
    "simulate",
    "steps",
]


class _MpiFirst:
    """Loads MPI before the first module that needs its library, and starts PETSc before dolfinx.

    It finds no module itself, and makes sure of what MPI and dolfinx need at their start.

    Only what Python has loaded by itself is imported before: with ``python -m`` the current folder
    is still the first in which modules are looked for.
    """

    waits = True

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> None:
        """Load MPI if a module needs it, and leave the search to others."""
        if name == "mpi4py.MPI":
            from wovenfab.lacking import require_home
            from wovenfab.mpi import require_own_launcher

            require_home()
            require_own_launcher()
        if self.waits and name in ("dolfinx", "petsc4py"):
            from wovenfab.mpi import load, start_petsc

            self.waits = False
            try:
                load()
            except BaseException:
                self.waits = True
                raise
            if name == "dolfinx":
                start_petsc()


sys.meta_path.insert(0, _MpiFirst())


def _version() -> str:
    """Return the version of the source tree this file lies in, or the installed one."""
    import tomllib
    from importlib.metadata import PackageNotFoundError, version

    project = Path(__file__).parent.parent / "pyproject.toml"
    if project.is_file():
        return str(tomllib.loads(project.read_text(encoding="utf-8"))["project"]["version"])
    try:
        return version("wovenfab")
    except PackageNotFoundError:
        return "unknown"


def __getattr__(name: str) -> Any:
    """Import the interface when it is first used: the command line needs only parts of it."""
    if name == "__version__":
        return _version()
    if name in __all__:
        return getattr(import_module("wovenfab.interface"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the names of the interface, too."""
    return sorted({*globals(), *__all__})
