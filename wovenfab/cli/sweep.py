"""``wovenfab sweep``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from wovenfab.case import refusal
from wovenfab.cli.console import FAILED_STEP, INTERRUPTED, Console, duration
from wovenfab.simulation.progress import Progress
from wovenfab.study.members import Member, members_of
from wovenfab.study.sweep import Run, Sweep, sweep
from wovenfab.study.table import printed, write_table
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
    voice = Console()
    try:
        runs = run_members(members, directory, jobs, voice)
    except KeyboardInterrupt:
        voice.problem(f"interrupted; to go on, repeat the command ({directory} has what is done)")
        return INTERRUPTED
    voice.say(f"\n{printed(runs)}\n\ntable and picture: {directory}")
    _draw([run for run in runs if run.has_results], directory)
    return exit_code(runs)


def run_members(
    members: Sequence[Member], directory: Path, jobs: int | None, voice: Console
) -> list[Run]:
    """Run members side by side, tell how it goes and keep their table up to date."""
    jobs = jobs or len(os.sched_getaffinity(0))
    phase = f"{len(members)} runs, {jobs} side by side"

    def tell(now: Sweep, run: Run | None) -> None:
        ended = sum(r.state not in ("waiting", "running") for r in now.runs)
        voice.progress(Progress(phase, now.share))
        if run is None:
            return
        write_table(now.runs, directory)
        if run.state == "failed":
            voice.problem(f"{run.member.name} failed: {run.problem} (all it said: {run.log})")
        if run.state != "kept" and now.left is not None:
            left = f", about {duration(now.left)} left" if ended < len(now.runs) else ""
            voice.say(
                f"{ended} of {len(now.runs)}: {run.member.name} took {duration(run.seconds)}{left}"
            )

    with voice:
        runs = sweep(members, directory, jobs, tell)
    if kept := sum(run.state == "kept" for run in runs):
        voice.say(f"{kept} of {len(runs)} runs were there already")
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
