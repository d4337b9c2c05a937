"""``wovenfab accuracy`` and ``wovenfab effects``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from wovenfab.case import CaseError, read_case
from wovenfab.cli.console import (
    BAD_INPUT,
    FAILED_STEP,
    INTERRUPTED,
    Console,
    duration,
    is_first_rank,
    is_launched,
)
from wovenfab.simulation.progress import Progress

if TYPE_CHECKING:
    from wovenfab.study.accuracy.settings import Setting
    from wovenfab.study.accuracy.study import Run, Study


#: Folder of the results of single runs.
RUNS = "runs"
#: Runs that take longer (s) are announced.
_LONG = 10.0


def study_accuracy(
    path: Path, output: Path | None, overrides: Sequence[str], minutes: float
) -> int:
    """Make the study of a case, write its table and draw it; return the exit code."""
    console = Console()
    if is_launched():
        console.problem("accuracy measures one process at a time: start it without mpirun")
        return BAD_INPUT
    case = read_case(path, overrides)
    if not case.discretisation.mesh_size:
        remedy = "For example 'mesh_size: 50 mm'."
        problem = "a study starts from a mesh size"
        raise CaseError([case.problem("discretisation", problem, remedy)])
    from wovenfab.report.study_pictures import draw_work_precision
    from wovenfab.study.accuracy.measure import StoredRuns
    from wovenfab.study.accuracy.strategy import run_study
    from wovenfab.study.accuracy.study import answers, tables, write_table

    directory = output or Path("results") / f"{case.name}-accuracy"
    directory.mkdir(parents=True, exist_ok=True)
    monitor = _Monitor(console, 60 * minutes)
    runner = StoredRuns(case, directory / RUNS, monitor.progress)
    try:
        with console:
            study = run_study(case, runner, 60 * minutes, monitor.report)
    except KeyboardInterrupt:
        console.problem(f"interrupted; to go on, repeat the command ({directory} has what is done)")
        return INTERRUPTED
    if runner.stored:
        console.say(f"{runner.stored} of {runner.asked} runs were there already")
    write_table(study, directory)
    if not study.space:
        console.problem(f"every run failed; the reasons are in {directory}")
        return FAILED_STEP
    text = f"{answers(study)}\n\n{tables(study)}\n"
    (directory / "accuracy.md").write_text(text, encoding="utf-8")
    draw_work_precision(study, directory)
    console.say(f"\n{answers(study)}\n\ntables and diagrams: {directory}")
    return 0


class _Monitor:
    """Shows the progress of a study, and each run."""

    def __init__(self, console: Console, budget: float) -> None:
        self._console, self._budget, self._spent = console, budget, 0.0

    def progress(self, seconds: float) -> None:
        """Show the time spent with the present run, which has taken so many seconds."""
        done = min((self._spent + seconds) / self._budget, 1.0)
        self._console.progress(Progress("accuracy", done))

    def report(self, study: Study, setting: Setting, expected: float, run: Run | None) -> None:
        """Announce a run that takes long, or print the results of a run."""
        self._spent = study.spent
        left = f"at most {duration(max(self._budget - self._spent, 0))} left"
        self.progress(0.0)
        if run is None:
            if expected > _LONG:
                time = duration(expected)
                self._console.say(f"  {setting.label} will take about {time} ({left})")
            return
        m = run.measured
        if m.failure:
            self._console.say(f"{setting.stage}: {setting.label} failed: {m.failure}")
            return
        compiled = f" after {m.compile:.0f} s to compile" if m.compile else ""
        values = ", ".join(f"{name} {value:.6g}" for name, value in m.values.items())
        self._console.say(
            f"{setting.stage}: {setting.label}: {m.unknowns} unknowns, {m.steps} steps, "
            f"{m.wall:.1f} s{compiled}, {values}; {left}"
        )


def study_effects(path: Path, output: Path | None, overrides: Sequence[str]) -> int:
    """Measure the scene with all effects, without each and with each alone; collective."""
    case = read_case(path, overrides)
    from mpi4py import MPI

    from wovenfab.report.study_pictures import draw_costs
    from wovenfab.study.effects import line, printed, study, write_table

    console = Console()
    rows = study(case, MPI.COMM_WORLD, lambda row: console.say(line(row)))
    if is_first_rank():
        directory = output or Path("results") / f"{case.name}-effects"
        directory.mkdir(parents=True, exist_ok=True)
        write_table(rows, directory / "effects.csv")
        (directory / "effects.md").write_text(printed(rows), encoding="utf-8")
        draw_costs(rows, directory / "effects.png")
        console.say(f"\n{printed(rows)}\ntable and chart: {directory}")
    return 0
