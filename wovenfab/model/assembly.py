"""How sums of forms are compiled and assembled.

What stands on facets concerns one family. Its forms live on the space of that placement
alone, whose unknowns bear the same numbers, so that their small matrices go straight into
the large one and do not couple what the physics does not.
"""

from __future__ import annotations

import fcntl
import hashlib
import inspect
import logging
import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np
import ufl
from cffi import VerificationError
from dolfinx import default_scalar_type, fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx.jit import ffcx_jit
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy import sparse
from ufl.domain import extract_unique_domain

from wovenfab.compat import column_map, is_compared
from wovenfab.lacking import require_compiler
from wovenfab.parallel import lock, run_concurrently

logger = logging.getLogger(__name__)
if is_compared():
    from wovenfab.model import kernels

    #: Lets FFCx write kernels in another way, and what that way is known by.
    writing: Callable[[], AbstractContextManager[None]] = kernels.own_kernels
    way = inspect.getsource(kernels)
else:
    logger.warning("FFCx writes all kernels itself, since this version was not compared: slower")
    writing, way = nullcontext, "FFCx"
#: A sum of compiled forms by the names of its parts.
Sum = Mapping[str, fem.Form]
#: The part that lives on the space of all placements: what is inside the sheet, and loads.
SHEET = "sheet"


def assemble_scalar(forms: Sum, comm: MPI.Comm) -> float:
    """Return the value of a sum of scalar forms over all ranks; collective."""
    mine = sum(fem.assemble_scalar(form) for form in forms.values())
    return float(comm.allreduce(mine, op=MPI.SUM))


def assemble_vector(vector: Any, forms: Sum) -> None:
    """Overwrite a ghosted vector with a sum of linear forms; ghosts are not yet added."""
    with vector.localForm() as local:
        local.set(0.0)
    for form in forms.values():
        fem_petsc.assemble_vector(vector, form)


def assemble_matrix(matrix: Any, forms: Sum, bcs: Sequence[fem.DirichletBC] = ()) -> None:
    """Overwrite a matrix with a sum of bilinear forms; identity where prescribed; collective."""
    matrix.zeroEntries()
    for form in forms.values():
        fem_petsc.assemble_matrix(matrix, form, list(bcs))
        # Rows of the identity are set; PETSc must flush before more values are added.
        matrix.assemble(PETSc.Mat.AssemblyType.FLUSH)
    matrix.assemble()


def create_matrix(forms: Sum, upper: bool = False) -> Any:
    """Return a matrix that has just the entries of a sum of bilinear forms; collective.

    Args:
        forms: The forms, which are symmetric.
        upper: Store the upper half in blocks of x and y, as a Cholesky factorisation takes
            it; putting entries in costs half as much. Otherwise any solver takes it.
    """
    unknowns = forms[SHEET].function_spaces[0].dofmap
    entries = sum(_entries(form) for form in forms.values())
    block, first = unknowns.index_map_bs, unknowns.index_map.local_range[0]
    if upper:
        entries = sparse.csr_array(sparse.triu(entries, first))
    else:
        entries = sparse.csr_array(sparse.kron(entries, np.ones((block, block), dtype=np.int8)))
    entries.sort_indices()
    usual = fem_petsc.create_matrix(forms[SHEET])
    matrix = PETSc.Mat().create(usual.comm)
    matrix.setSizes(usual.getSizes(), bsize=block)
    matrix.setType("sbaij" if upper else "aij")
    csr = [part.astype(PETSc.IntType) for part in (entries.indptr, entries.indices)]
    matrix.setPreallocationCSR(csr)
    matrix.setLGMap(*usual.getLGMap())
    if upper:
        matrix.setOption(PETSc.Mat.Option.IGNORE_LOWER_TRIANGULAR, True)
    matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_LOCATION_ERR, True)
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    usual.destroy()
    return matrix


def _entries(form: fem.Form) -> Any:
    """Return the blocks that a bilinear form couples: own rows, columns of all ranks."""
    pattern = fem.create_sparsity_pattern(form)
    pattern.finalize()
    edges, offsets = pattern.graph
    rows, columns = pattern.index_map(0), column_map(pattern)
    offsets = offsets[: rows.size_local + 1]
    numbers = columns.local_to_global(np.asarray(edges[: offsets[-1]]))
    shape = (rows.size_local, columns.size_global)
    return sparse.csr_array((np.ones(len(numbers), dtype=np.int8), numbers, offsets), shape=shape)


#: Chosen by measurement on the default case: much quicker to compile than -O3, as fast to run.
#: -ffast-math removes NaN checks inside kernels; bad states are found on the vectors.
FLAGS = ("-O1", "-march=native", "-ffast-math", "-ftree-vectorize", "-g0")


def cache_folder() -> Path:
    """Return the folder of compiled kernels, one for each kind of processor and way to write them.

    Code made for one processor may not run on another that shares the home folder.
    """
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    kind = hashlib.sha256(f"{_processor()} {way}".encode()).hexdigest()[:10]
    return Path(base) / "wovenfab" / "kernels" / kind


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    keys = ("model name", "flags", "Features", "CPU part")
    kinds = {line for line in lines if line.startswith(keys)}
    return "\n".join(sorted(kinds)) or platform.machine()


def jit_options() -> dict[str, Any]:
    """Return the options of dolfinx's just-in-time compiler that are not its defaults."""
    return {"cffi_extra_compile_args": list(FLAGS), "cache_dir": str(cache_folder())}


def _options() -> dict[str, Any]:
    """Return the arguments of dolfinx's functions that compile."""
    return {
        "form_compiler_options": {"scalar_type": default_scalar_type},
        "jit_options": jit_options(),
    }


def _compiled[T](compile_it: Callable[[], T]) -> T:
    """Return what is compiled, also where another process was killed while it compiled the same.

    FFCx waits for a kernel that is without its ``.cached`` mark. Every compiling process shares a
    lock, so that whoever has it alone knows that nobody works on such a kernel. A compiler that a
    signal has ended is started once more: the signal may have been meant for this process, which
    has its own way to end. On a file system without locks a kernel counts as unfinished once FFCx
    has waited for it in vain.
    """
    folder, killed = cache_folder(), False
    folder.mkdir(parents=True, exist_ok=True)
    while True:
        with (folder / "users.lock").open("w") as users:
            with suppress(BlockingIOError):
                if lock(users, fcntl.LOCK_EX | fcntl.LOCK_NB):
                    _remove_unfinished(folder)
            lock(users, fcntl.LOCK_SH)
            try:
                with writing(), _compiler_logged():
                    return compile_it()
            except TimeoutError:
                pass
            except VerificationError as error:
                if killed or "exit code -" not in str(error):
                    require_compiler()
                    raise
                killed = True
        with (folder / "users.lock").open("w") as users:
            lock(users, fcntl.LOCK_EX)
            _remove_unfinished(folder)


#: File descriptor of the error stream, which a compiler inherits.
_STDERR = 2


@contextmanager
def _compiler_logged() -> Iterator[None]:
    """Log what a compiler writes to the error stream, and note it on an error that ends this.

    On the terminal those lines would stand before the message that says what to install.
    """
    try:
        usual = os.dup(_STDERR)
    except OSError:  # the caller has closed it
        yield
        return
    with TemporaryFile() as file:
        os.dup2(file.fileno(), _STDERR)
        try:
            yield
        except Exception as error:
            error.add_note(_written(file))
            raise
        finally:
            os.dup2(usual, _STDERR)
            os.close(usual)
            if lines := _written(file):
                logger.info("the compiler wrote:\n%s", lines)


def _written(file: IO[bytes]) -> str:
    file.seek(0)
    return file.read().decode(errors="replace").rstrip()


def _remove_unfinished(folder: Path) -> None:
    """Remove the kernels that a killed process left unfinished, while no other one compiles."""
    with os.scandir(folder) as entries:  # one look at it: it may hold thousands of kernels
        names = {entry.name for entry in entries}
    for name in names:
        if name.endswith(".c") and f"{name}.cached" not in names:
            (folder / name).unlink(missing_ok=True)


def _precompile(symbols: Sequence[Any], comm: MPI.Comm) -> None:
    """Put kernels into the cache, each rank its share; collective.

    No two ranks compile the same kernel: FFCx would let one wait for the other in steps of a
    second.
    """

    def compile_share() -> None:
        for symbol in _shares(symbols, comm.size)[comm.rank]:
            _compiled(partial(ffcx_jit, MPI.COMM_SELF, symbol, **_options()))

    run_concurrently(comm, compile_share)


#: About how much longer a kernel takes to compile with one and with two arguments than with none,
#: and one of interior facets than one of cells.
ARGUMENTS, BOTH_SIDES = (1, 2, 8), 2


def _shares(symbols: Sequence[Any], count: int) -> list[list[Any]]:
    """Return forms and expressions with different kernels in shares of about equal work."""
    shares: list[list[Any]] = [[] for _ in range(count)]
    loads = [0] * count
    known = {s.signature() if isinstance(s, ufl.Form) else id(s): s for s in symbols}
    for symbol in sorted(known.values(), key=_work, reverse=True):
        least = loads.index(min(loads))
        shares[least].append(symbol)
        loads[least] += _work(symbol)
    return shares


def _work(symbol: Any) -> int:
    """Return about how long a form or an expression takes to compile, in a unit of its own."""
    if not isinstance(symbol, ufl.Form):
        return 1
    sides = [BOTH_SIDES if i.integral_type() == "interior_facet" else 1 for i in symbol.integrals()]
    return ARGUMENTS[len(symbol.arguments())] * sum(sides)


def compile_forms(forms: Sequence[Any], comm: MPI.Comm) -> list[fem.Form]:
    """Return the compiled forms; collective.

    Args:
        forms: The forms.
        comm: Communicator of their mesh.
    """
    if comm.size > 1:
        _precompile(forms, comm)
    return [_compiled(partial(fem.form, form, **_options())) for form in forms]


def compile_form(form: Any) -> fem.Form:
    """Return the compiled form; collective over the mesh's communicator."""
    return compile_forms([form], form.ufl_domain().ufl_cargo().comm)[0]


def compile_sums(sums: Mapping[str, Mapping[str, Any]], comm: MPI.Comm) -> dict[str, Sum]:
    """Return sums of forms compiled under their names and those of their parts; collective."""
    every = [form for parts in sums.values() for form in parts.values()]
    compiled = iter(compile_forms(every, comm))
    return {name: {part: next(compiled) for part in parts} for name, parts in sums.items()}


def compile_expression(expression: Any, points: NDArray[np.float64]) -> fem.Expression:
    """Return a compiled expression at reference ``points``, shape (n, 2); collective."""
    return compile_expressions([expression], points)[0]


def compile_expressions(
    expressions: Sequence[Any], points: NDArray[np.float64]
) -> list[fem.Expression]:
    """Return compiled expressions at reference ``points``, shape (n, 2); collective."""
    comm = extract_unique_domain(expressions[0]).ufl_cargo().comm
    if comm.size > 1:
        _precompile([(expression, points) for expression in expressions], comm)
    return [
        _compiled(partial(fem.Expression, expression, points, **_options()))
        for expression in expressions
    ]
