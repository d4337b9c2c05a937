"""``wovenfab run``."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from wovenfab import log
from wovenfab.case import read_case
from wovenfab.cli.console import (
    BAD_INPUT,
    FAILED_STEP,
    INTERRUPTED,
    Console,
    is_first_rank,
    was_interrupted,
)
from wovenfab.record.results import ResultsExistError
from wovenfab.simulation.progress import Progress, Stopwatch

SLOW_BLAS = (
    "warning: no tuned BLAS is loaded, so factorisation will be several times slower; "
    "install OpenBLAS (Debian: libopenblas0-pthread)"
)
#: Part of the path of every BLAS that is fast enough.
FAST_BLAS = ("openblas", "mkl", "blis", "libflexiblas")


def run_case(
    path: Path,
    output: Path | None,
    overrides: Sequence[str],
    overwrite: bool,
    petsc: Sequence[str],
    verbosity: int = 0,
    log_file: Path | None = None,
) -> int:
    """Run a case file and return the exit code; collective.

    Args:
        path: The case file.
        output: The results directory; ``results/<name of the case>`` if None.
        overrides: Values that replace those of the file.
        overwrite: Replace the results of an earlier run there.
        petsc: Options for PETSc.
        verbosity: How much is logged on the screen: 0 to 2.
        log_file: Gets the whole log; None for no file.
    """
    started = time.perf_counter()
    case = read_case(path, overrides)
    directory, watch, console = output or Path("results") / case.name, Stopwatch(), Console()
    with console:
        try:
            log.configure(verbosity, log_file, console.log, is_first_rank())
            console.progress(Progress("loading"))
            _start_petsc(petsc)
            from wovenfab.interface import Listener, execute

            watch.seconds["import"] = time.perf_counter() - started
            if not _blas_is_fast():
                console.say(SLOW_BLAS)
            listener = Listener(console.say, console.progress)
            run = execute(case, directory, overwrite, listener=listener, watch=watch)
        except (ResultsExistError, OSError) as error:
            if _has_begun(watch):
                raise
            console.problem(str(error))
            return BAD_INPUT
        except BaseException as error:
            if not (was_interrupted(error) and _has_begun(watch)):
                raise
            console.problem(f"interrupted; the results so far are in {directory}")
            return INTERRUPTED
    if run.outcome.failure is not None:
        console.problem(f"{run.outcome.failure}; the results before that are in {directory}")
        return FAILED_STEP
    _report(console, run.summary, directory)
    return 0


def _has_begun(watch: Stopwatch) -> bool:
    """Return whether a step was tried."""
    return "first step" in watch.seconds


def _start_petsc(options: Sequence[str]) -> None:
    """Hand PETSc its command line before anything else starts it."""
    import petsc4py

    petsc4py.init([sys.argv[0], *options])


def _report(console: Console, summary: Mapping[str, Any], directory: Path) -> None:
    for loss in summary["losses_of_stability"]:
        console.say(
            f"stability lost at {1e3 * loss['displacement_m']:.6g} mm under "
            f"{loss['force_N']:.6g} N, branch followed"
        )
    if summary["saddles"]:
        console.say(
            f"warning: {summary['saddles']} of {summary['steps']} states are saddles, which no "
            "sheet would stay on (negative_eigenvalues in history.csv)"
        )
    console.say(
        f"done: {summary['steps']} steps, peak force {summary['peak_force_N']:.6g} N, "
        f"dissipated {summary['dissipated_J']:.6g} J, results in {directory}"
    )


def _blas_is_fast() -> bool:
    """Return whether a tuned BLAS is loaded; true where that cannot be known."""
    try:
        maps = Path("/proc/self/maps").read_text()
    except OSError:
        return True
    return any(name in maps for name in FAST_BLAS)
