"""``wovenfab sweep``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from wovenfab.case import refusal
from wovenfab.cli.console import FAILED_STEP, INTERRUPTED, Console, duration
from wovenfab.simulation.progress import Progress
from wovenfab.study.sweep import Member, Run, Sweep, members_of, printed, sweep, write_table
from wovenfab.study.variations import Variation, grid, is_sweep_file, read_over, read_sweep_file


def run_sweep(
    paths: Sequence[Path],
    over: Sequence[str],
    overrides: Sequence[str],
    output: Path | None,
    jobs: int | None,
) -> int:
    """Run every member of a sweep, draw them together and return the exit code."""
    cases, variations = _varied(paths, over)
    members = members_of(cases, variations, overrides)
    directory = output or Path("results") / f"{paths[0].stem}-sweep"
    console = Console()
    try:
        runs = run_members(members, directory, jobs, console)
    except KeyboardInterrupt:
        console.problem(f"interrupted; to go on, repeat the command ({directory} has what is done)")
        return INTERRUPTED
    console.say(f"\n{printed(runs)}\n\ntable and picture: {directory}")
    _draw([run for run in runs if run.has_results], directory)
    return exit_code(runs)


def run_members(
    members: Sequence[Member], directory: Path, jobs: int | None, console: Console
) -> list[Run]:
    """Run members side by side; show the progress and update their table after each."""
    jobs = jobs or len(os.sched_getaffinity(0))
    phase = f"{len(members)} runs, {jobs} side by side"

    def report(state: Sweep, run: Run | None) -> None:
        ended, count = sum(r.ended for r in state.runs), len(state.runs)
        console.progress(Progress(phase, state.share))
        if run is None:
            return
        write_table(state.runs, directory)
        if run.state == "failed":
            console.problem(f"{run.member.name} failed: {run.problem} (its output: {run.log})")
        if run.state != "unchanged" and state.left is not None:
            left = f", about {duration(state.left)} left" if ended < count else ""
            console.say(f"{ended} of {count}: {run.member.name} took {duration(run.seconds)}{left}")

    with console:
        runs = sweep(members, directory, jobs, report)
    if unchanged := sum(run.state == "unchanged" for run in runs):
        console.say(f"{unchanged} of {len(runs)} runs were there already")
    return runs


def exit_code(runs: Sequence[Run]) -> int:
    """Return what a command ends with after some runs."""
    return FAILED_STEP if any(run.state == "failed" for run in runs) else 0


def _draw(runs: Sequence[Run], directory: Path) -> None:
    """Draw the loops of all runs over each other, as ``overlay.png`` and ``overlay.svg``."""
    from wovenfab.report.curves import loops
    from wovenfab.report.run_data import open_run_data
    from wovenfab.report.style import house_style, save

    if runs:
        with house_style():
            figure = loops([(run.member.label, open_run_data(run.directory)) for run in runs])
            for kind in ("png", "svg"):
                save(figure, directory / f"overlay.{kind}")


def _varied(
    paths: Sequence[Path], over: Sequence[str]
) -> tuple[Sequence[Path], Sequence[Variation]]:
    """Return case files, and what each is run with."""
    axes = [read_over(text) for text in over]
    if not any(is_sweep_file(path) for path in paths):
        return paths, grid(axes)
    if len(paths) > 1:
        raise refusal(str(paths[0]), "a sweep file stands alone, without other files")
    sweep_file = read_sweep_file(paths[0])
    return sweep_file.cases, grid([sweep_file.variations, *axes])
