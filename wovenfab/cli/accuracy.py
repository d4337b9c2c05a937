"""``wovenfab accuracy``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from wovenfab.case import CaseError, read_case
from wovenfab.cli.console import BAD_INPUT, FAILED_STEP, INTERRUPTED, Console, duration, is_launched
from wovenfab.simulation.progress import Progress

#: Folder of the runs that have been made.
KEPT = "runs"
#: Runs that take longer (s) are announced.
_LONG = 10.0


def study_accuracy(
    path: Path, output: Path | None, overrides: Sequence[str], minutes: float
) -> int:
    """Make the study of a case, write its table and draw it; return the exit code."""
    voice = Console()
    if is_launched():
        voice.problem("accuracy measures one process at a time: start it without mpirun")
        return BAD_INPUT
    case = read_case(path, overrides)
    if not case.discretisation.mesh_size:
        remedy = "For example 'mesh_size: 50 mm'."
        problem = "a study starts from a mesh size"
        raise CaseError([case.problem("discretisation", problem, remedy)])
    from wovenfab.report.study_pictures import draw_work_precision
    from wovenfab.study.accuracy.runs import KeptRuns
    from wovenfab.study.accuracy.settings import Setting
    from wovenfab.study.accuracy.study import Run, Study, study
    from wovenfab.study.accuracy.table import answers, ladders, write_csv

    directory = output or Path("results") / f"{case.name}-accuracy"
    directory.mkdir(parents=True, exist_ok=True)
    budget, spent = 60 * minutes, 0.0

    def alive(seconds: float) -> None:
        voice.progress(Progress("accuracy", min((spent + seconds) / budget, 1.0)))

    def tell(now: Study, setting: Setting, expected: float, run: Run | None) -> None:
        nonlocal spent
        spent = now.spent
        left = f"at most {duration(max(budget - spent, 0))} left"
        voice.progress(Progress("accuracy", min(spent / budget, 1.0)))
        if run is None:
            if expected > _LONG:
                voice.say(f"  {setting.label} will take about {duration(expected)} ({left})")
            return
        m = run.measured
        if m.failure:
            voice.say(f"{setting.stage}: {setting.label} failed: {m.failure}")
            return
        compiled = f" after {m.compile:.0f} s to compile" if m.compile else ""
        values = ", ".join(f"{name} {value:.6g}" for name, value in m.values.items())
        voice.say(
            f"{setting.stage}: {setting.label}: {m.unknowns} unknowns, {m.steps} steps, "
            f"{m.wall:.1f} s{compiled}, {values}; {left}"
        )

    runner = KeptRuns(path, overrides, directory / KEPT, alive)
    try:
        with voice:
            found = study(path, overrides, runner, budget, tell)
    except KeyboardInterrupt:
        voice.problem(f"interrupted; to go on, repeat the command ({directory} has what is done)")
        return INTERRUPTED
    if runner.kept:
        voice.say(f"{runner.kept} of {runner.asked} runs were there already")
    write_csv(found, directory)
    if not found.space:
        voice.problem(f"every run failed; the reasons are in {directory}")
        return FAILED_STEP
    text = f"{answers(found)}\n\n{ladders(found)}\n"
    (directory / "accuracy.md").write_text(text, encoding="utf-8")
    draw_work_precision(found, directory)
    voice.say(f"\n{answers(found)}\n\ntables and diagrams: {directory}")
    return 0
