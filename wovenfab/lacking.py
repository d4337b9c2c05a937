"""What a machine lacks, told by what installs it where it is needed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sysconfig
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType

#: Debian's packages of what gmsh's wheel does not bring.
GMSH_LIBRARIES = "libglu1-mesa libgl1 libxrender1 libxcursor1 libxft2 libxinerama1"
#: A program that needs what a compiled form needs, and the packages without which it fails.
_NEEDS = (
    ("int main(void) { return 0; }", "cannot make programs", "gcc libc6-dev"),
    ("#include <complex.h>\n#include <math.h>\n", "lacks the headers of C", "gcc libc6-dev"),
    ("#include <Python.h>\n", "lacks Python's headers (Python.h)", "python3-dev"),
)


class LackingError(Exception):
    """Something that this machine lacks, or that does not fit; says what is to be done."""


def module_is_missing(error: ModuleNotFoundError) -> str:
    """Return a message about a module without which no command works."""
    return (
        f"the Python module {error.name} is missing: pip install 'wovenfab[wheels]', or see the "
        "ways to install in docs/install.md"
    )


def load(name: str, package: str, purpose: str) -> ModuleType:
    """Return a module that not every command needs.

    Args:
        name: Of the module.
        package: What pip installs.
        purpose: What needs it, for the message.

    Raises:
        LackingError: It is not installed, or a library that it needs is not there.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        raise LackingError(
            f"{purpose} needs {name}, which is missing: pip install {package}"
        ) from error
    except (ImportError, OSError) as error:  # by gmsh's ctypes, the latter
        remedy = f"install it, on Debian by apt-get install {GMSH_LIBRARIES}"
        if name != "gmsh":
            remedy = "install it"
        raise LackingError(
            f"{purpose} needs {name}, and that a library of the system: {error}; {remedy}"
        ) from error


def require_home() -> None:
    """Make sure of a home folder: Open MPI ends without, and dolfinx asks for it in any case.

    Raises:
        LackingError: Nothing tells a folder to keep compiled forms in.
    """
    try:
        Path.home()
    except RuntimeError as error:  # HOME is not set, and the system's list lacks this user
        if not (cache := os.environ.get("XDG_CACHE_HOME")):
            raise LackingError(
                "there is no home folder to keep compiled forms in: set HOME or XDG_CACHE_HOME"
            ) from error
        os.environ["HOME"] = cache


def compiler() -> list[str]:
    """Return the command of the C compiler by which Python compiles modules."""
    return (os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc").split()


def require_compiler() -> None:
    """Find out why forms cannot be compiled, after a compilation has failed.

    Raises:
        LackingError: There is no compiler, or it lacks headers.
    """
    command = compiler()
    named = f"CC={os.environ['CC']}" if os.environ.get("CC") else command[0]
    begin = "effects are compiled by a C compiler"
    if shutil.which(command[0]) is None:
        remedy = "name another or unset CC" if os.environ.get("CC") else _install("gcc libc6-dev")
        raise LackingError(f"{begin}, and {named} is not there: {remedy}")
    include = sysconfig.get_path("include")
    with TemporaryDirectory() as folder:
        source = Path(folder, "try.c")
        for code, what, packages in _NEEDS:
            source.write_text(code + "\n")
            kind = ["-o", f"{folder}/try"] if "main" in code else ["-c", "-o", f"{folder}/try.o"]
            tried = subprocess.run(
                [*command, f"-I{include}", str(source), *kind],
                stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace",
            )  # fmt: skip
            if tried.returncode:
                said = [line.strip() for line in tried.stderr.splitlines() if line.strip()]
                errors = [line.partition("error: ")[2] for line in said if "error: " in line]
                why = "".join((errors or said)[:1])
                remedy = _install(packages)
                if os.environ.get("CC"):
                    remedy = f"name another by CC, or {remedy}"
                raise LackingError(
                    f"{begin}, and {named} {what}{f' ({why})' if why else ''}: {remedy}"
                )


def _install(packages: str) -> str:
    return f"install it, on Debian by apt-get install {packages}"
