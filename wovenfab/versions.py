"""The versions of wovenfab and of what computes, however it was installed."""

from __future__ import annotations

import platform
import sys
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from typing import Any

from wovenfab.mpi import version_of

#: Distributions that bring dolfinx: its own name, and PyPI's wheel.
DOLFINX = ("fenics-dolfinx", "dolfinx-solver-real")
UNKNOWN = "unknown"


def versions() -> dict[str, str]:
    """Return the versions of wovenfab, dolfinx, PETSc, MPI and Python; loads none of them.

    MPI has its name before its version; it is unknown where it is not loaded.
    """
    import wovenfab

    petsc: Any = sys.modules.get("petsc4py.PETSc")
    mpi = sys.modules.get("mpi4py.MPI")
    return {
        "wovenfab": wovenfab.__version__,
        "dolfinx": dolfinx(),
        "petsc": ".".join(map(str, petsc.Sys.getVersion())) if petsc else _loaded("petsc4py"),
        "mpi": version_of(mpi) if mpi else UNKNOWN,
        "python": platform.python_version(),
    }


def dolfinx() -> str:
    """Return the version of dolfinx, loaded or not."""
    if (loaded := _loaded("dolfinx")) != UNKNOWN:
        return loaded
    return _first(DOLFINX) or _first(packages_distributions().get("dolfinx", ())) or UNKNOWN


def installed() -> dict[str, str]:
    """Return the versions in a process that does nothing else: MPI is loaded and not started."""
    try:
        import mpi4py

        mpi4py.rc.initialize = False
        import petsc4py  # noqa: F401 - loads MPI, which tells its version
    except ImportError:
        pass
    return versions()


def _loaded(module: str) -> str:
    return str(getattr(sys.modules.get(module), "__version__", UNKNOWN))


def _first(names: Any) -> str:
    for name in names:
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return ""
