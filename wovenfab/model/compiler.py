"""How UFL becomes machine code: flags, cache folder and what it cost."""

from __future__ import annotations

import fcntl
import hashlib
import os
import platform
import time
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, TextIO

from dolfinx import default_scalar_type, fem
from dolfinx.jit import ffcx_jit
from mpi4py import MPI

from wovenfab.model.assembly import Sum
from wovenfab.parallel import agree

#: Chosen by measurement on the default case: much quicker to compile than -O3, as fast to run.
#: -ffast-math removes NaN checks inside kernels; bad states are found on the vectors.
FLAGS = ("-O1", "-march=native", "-ffast-math", "-ftree-vectorize", "-g0")


def cache_folder() -> Path:
    """Return the folder of compiled kernels, one for each kind of processor.

    Code made for one processor may not run on another that shares the home folder.
    """
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    kind = hashlib.sha256(_processor().encode()).hexdigest()[:10]
    return Path(base) / "wovenfab" / "kernels" / kind


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    keys = ("model name", "flags", "Features", "CPU part")
    kinds = {line for line in lines if line.startswith(keys)}
    return "\n".join(sorted(kinds)) or platform.machine()


@cache
def _join_users_of(folder: Path) -> TextIO:
    """Join the processes that use the cache; the first one clears what a killed one left.

    FFCx takes a kernel without its ``.cached`` mark for one that another process is
    compiling, and waits for it. With no other process there, nobody is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lock = (folder / "users.lock").open("w")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        pass
    else:
        for source in folder.glob("*.c"):
            if not source.with_suffix(".c.cached").exists():
                source.unlink(missing_ok=True)
    fcntl.flock(lock, fcntl.LOCK_SH)
    return lock


def jit_options() -> dict[str, Any]:
    """Return the options of dolfinx's just-in-time compiler."""
    _join_users_of(cache_folder())
    return {
        "cffi_extra_compile_args": list(FLAGS),
        "cache_dir": str(cache_folder()),
        "timeout": 600,  # another rank or process may be compiling the same kernel
    }


def compile_form(form: Any) -> fem.Form:
    """Return the compiled form; collective over the mesh's communicator."""
    return fem.form(form, jit_options=jit_options())


def compile_forms(forms: Sequence[Any], comm: MPI.Comm) -> list[fem.Form]:
    """Return the compiled forms, most expensive first; each rank compiles its share.

    The ranks that have less to do wait asleep: MPI's own waiting would keep a
    processor busy that the compiler of another rank could use.
    """
    if comm.size > 1:
        problem = None
        try:
            for form in forms[comm.rank :: comm.size]:
                options = {"scalar_type": default_scalar_type}
                ffcx_jit(MPI.COMM_SELF, form, options, jit_options())
        except Exception as error:
            problem = error
        _wait_asleep(comm)
        agree(comm, problem)
    return [compile_form(form) for form in forms]


def compile_sums(sums: Mapping[str, Sequence[Any]], comm: MPI.Comm) -> dict[str, Sum]:
    """Return sums of forms compiled under their names; collective."""
    compiled = iter(compile_forms([form for forms in sums.values() for form in forms], comm))
    return {name: tuple(next(compiled) for _ in forms) for name, forms in sums.items()}


def _wait_asleep(comm: MPI.Comm) -> None:
    request = comm.Ibarrier()
    while not request.Test():
        time.sleep(0.02)


def compile_expression(expression: Any, points: Any) -> fem.Expression:
    """Return a compiled expression at reference ``points``, shape (n, 2)."""
    return fem.Expression(expression, points, jit_options=jit_options())
