"""``wovenfab run``."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from wovenfab.case import read_case
from wovenfab.cli.console import BAD_INPUT, FAILED_STEP, INTERRUPTED, Console, was_interrupted
from wovenfab.cli.sheet import sheet_for
from wovenfab.cli.target_accuracy import plan_run, report_errors
from wovenfab.record.results import ResultsExistError, open_results, require_free
from wovenfab.report.subprocess import draw_in_subprocess
from wovenfab.simulation.progress import Progress, Stopwatch

SLOW_BLAS = (
    "warning: no tuned BLAS is loaded, so factorisation will be several times slower; "
    "install OpenBLAS (Debian: libopenblas0-pthread)"
)
#: Part of the path of every BLAS that is fast enough.
FAST_BLAS = ("openblas", "mkl", "blis", "libflexiblas")


def run_case(
    path: Path, output: Path | None, overrides: Sequence[str], overwrite: bool, petsc: Sequence[str]
) -> int:
    """Run the case file and return the exit code; collective."""
    started = time.perf_counter()
    case = read_case(path, overrides)
    voice = Console()
    with voice, ExitStack() as stack:
        voice.progress(Progress("loading"))
        _start_petsc(petsc)
        from wovenfab.simulation.run import run
        from wovenfab.simulation.simulation import Simulation

        watch = Stopwatch()
        watch.seconds["import"] = time.perf_counter() - started
        if not _blas_is_fast():
            voice.say(SLOW_BLAS)
        directory = output or Path("results") / case.name
        try:
            require_free(directory, overwrite)
            with watch.phase("mesh"):
                sheet = sheet_for(case, path, overrides)
            plan, accuracy = None, case.accuracy
            if accuracy is not None:
                with watch.phase("pilot"):
                    plan = plan_run(case, sheet, path, overrides, voice)
                case, sheet = plan.case, plan.sheet
            voice.progress(Progress("compiling the effects"))
            with watch.phase("compile"):
                simulation = stack.enter_context(Simulation(case, sheet))
            open_results(directory, overwrite)
        except (ResultsExistError, OSError) as error:
            voice.problem(str(error))
            return BAD_INPUT
        try:
            outcome, summary = run(simulation, directory, voice.progress, watch)
        except BaseException as error:
            if not was_interrupted(error):
                raise
            voice.problem(f"interrupted; the results so far are in {directory}")
            return INTERRUPTED
        if plan is not None and accuracy is not None:
            report_errors(plan, accuracy, summary, directory, voice)
    if case.output.pictures:
        warning = draw_in_subprocess(directory).warning
        if warning is not None:
            voice.say(f"warning: {warning}")
    if outcome.failure is not None:
        voice.problem(f"{outcome.failure}; the results before that are in {directory}")
        return FAILED_STEP
    _tell(voice, summary, directory)
    return 0


def _start_petsc(options: Sequence[str]) -> None:
    """Hand PETSc its command line before anything else starts it."""
    import petsc4py

    petsc4py.init([sys.argv[0], *options])


def _tell(voice: Console, summary: Mapping[str, Any], directory: Path) -> None:
    for loss in summary["losses_of_stability"]:
        voice.say(
            f"stability lost at {1e3 * loss['displacement_m']:.6g} mm under "
            f"{loss['force_N']:.6g} N, branch followed"
        )
    if summary["saddles"]:
        voice.say(
            f"warning: {summary['saddles']} of {summary['steps']} states are saddles, which no "
            "sheet would stay on (negative_eigenvalues in history.csv)"
        )
    voice.say(
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
