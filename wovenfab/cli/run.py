"""``wovenfab run``."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from math import inf
from pathlib import Path
from signal import Signals
from typing import Any

from wovenfab.case import CaseError, read_case, units
from wovenfab.case.errors import CaseProblem
from wovenfab.case.programs import effect_programs, geometry_programs
from wovenfab.cli.console import (
    BAD_INPUT,
    CANNOT_WRITE,
    FAILED_STEP,
    SIGNALLED,
    Console,
    configure_log,
    is_first_rank,
    is_launched,
    require_log,
)
from wovenfab.lacking import LackingError
from wovenfab.mpi import PetscStartError, on_ranks, start_petsc
from wovenfab.parallel import ending_with_parent
from wovenfab.record.results import NothingToResumeError, ResultsExistError, has_checkpoint
from wovenfab.simulation.progress import Interruption, Progress, Stopwatch, signal_behind

SLOW_BLAS = (
    "warning: no tuned BLAS is loaded, so factorisation will be several times slower; "
    "install OpenBLAS (Debian: libopenblas0-pthread)"
)
#: Part of the path of every BLAS that is fast enough.
FAST_BLAS = ("openblas", "mkl", "blis", "libflexiblas")
#: Time between two signals from which the second one ends a run at once, s.
TWICE = 0.5


def launch(ranks: int, arguments: Sequence[str]) -> int:
    """Run a command of this program by mpirun and return its exit code.

    mpirun kills its ranks half a second after SIGINT or SIGTERM, but hands SIGUSR1 on to them:
    that is what it gets, and the exit code is that of the signal.

    Args:
        ranks: Number of MPI ranks.
        arguments: Arguments of the program.
    """
    received: list[tuple[int, float]] = []

    def hand_on(number: int, _: object) -> None:
        now = time.monotonic()
        is_second = bool(received) and now - received[0][1] > TWICE
        received.append((number, now))
        process.send_signal(signal.SIGTERM if is_second else signal.SIGUSR1)

    command = [*on_ranks(ranks), sys.executable, "-P", "-m", "wovenfab", *arguments]
    if shutil.which(command[0]) is None:
        Console().problem(
            f"mpirun is neither in {Path(sys.executable).parent} nor in PATH: install the MPI that "
            "dolfinx was built with, or leave --ranks out"
        )
        return BAD_INPUT
    process = subprocess.Popen(
        ending_with_parent(command),
        env={"OMP_NUM_THREADS": "1", **os.environ},
        stdin=subprocess.DEVNULL,
        start_new_session=True,
    )
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1):
        signal.signal(number, hand_on)
    code = process.wait()
    return SIGNALLED + received[0][0] if received and code else code


def run_case(
    path: Path,
    output: Path | None,
    overrides: Sequence[str],
    *,
    fabric: Path | None = None,
    overwrite: bool = False,
    resume: bool = False,
    until: str | None = None,
    petsc: Sequence[str] = (),
    verbosity: int = 0,
    log_file: Path | None = None,
) -> int:
    """Run a case file, in ``results/<its name>`` by default; return the exit code; collective.

    Arguments are those of the command: ``until`` is a time with its unit, ``verbosity`` 0 to 2.
    """
    started, console, watch = time.perf_counter(), Console(), Stopwatch()
    if resume:
        given = path, overrides, fabric
        for program in (*effect_programs(*given), *geometry_programs(*given)):
            console.say(f"{path} runs {program}")
    case, end = read_case(path, overrides, fabric), _seconds(until)
    directory = output or Path("results") / case.name
    if log_file is not None:
        require_log(log_file, directory)
    with Interruption(is_launched()) as interruption, console:
        try:
            open_log = configure_log(verbosity, log_file, console.log, is_first_rank())
            console.progress(Progress("loading"))
            start_petsc(petsc)  # before anything else does
            from wovenfab.interface import Listener, execute

            watch.seconds["import"] = time.perf_counter() - started
            if not _blas_is_fast():
                console.say(SLOW_BLAS)
            run = execute(
                case,
                directory,
                overwrite,
                listener=Listener(console.say, console.progress, open_log),
                watch=watch,
                resume=resume,
                until=end,
                interruption=interruption,
            )
        except (PetscStartError, ResultsExistError, NothingToResumeError) as error:
            console.problem(str(error))
            return BAD_INPUT
        except LackingError:
            with suppress(OSError):  # the log says why
                open_log()
            raise
        except OSError as error:
            console.problem(_cannot_write(error, directory, _has_begun(watch)))
            return CANNOT_WRITE if _has_begun(watch) else BAD_INPUT
        except BaseException as error:
            if not (number := signal_behind(error)):
                raise
            console.problem(f"{Signals(number).name} before the first step; nothing was written")
            return SIGNALLED + number
    go_on = f"'wovenfab resume {directory}' goes on"
    if run.outcome.signal:
        name = Signals(run.outcome.signal).name
        ends = is_launched() and run.outcome.signal != Signals.SIGUSR1
        console.problem(f"{name} after step {run.outcome.steps}; {go_on}", ends)
        return SIGNALLED + run.outcome.signal
    if run.outcome.failure is not None:
        console.problem(f"{run.outcome.failure}; the results before that are in {directory}")
        return FAILED_STEP
    if run.outcome.paused:
        console.say(f"paused after step {run.outcome.steps} as asked; {go_on}")
        return 0
    _report(console, run.summary, directory)
    return 0


def _seconds(text: str | None) -> float:
    """Return a time as it is written on the command line, s; infinite without one."""
    if text is None:
        return inf
    try:
        return units.parse(text, "s")
    except ValueError as error:
        message, remedy = f"expected a time, got {error}", "For example --until '12 s'."
        raise CaseError([CaseProblem("--until", None, "", message, remedy)]) from error


def _cannot_write(error: OSError, directory: Path, begun: bool) -> str:
    """Return what could not be written, why, and what can be done."""
    what = f"{error.filename or directory} cannot be written: {error.strerror or error}"
    if not begun:
        return what
    if not has_checkpoint(directory):
        return f"{what}. The results before that are in {directory}; there was no checkpoint yet"
    return (
        f"{what}. The results and the checkpoint before that are in {directory}; make room, then "
        f"'wovenfab resume {directory}' goes on"
    )


def _has_begun(watch: Stopwatch) -> bool:
    """Return whether a step was tried."""
    return "first step" in watch.seconds


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
