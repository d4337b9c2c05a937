"""``wovenfab report``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from wovenfab.cli.console import BAD_INPUT, Console

#: Results are whole, but something of the report could not be drawn.
NOT_DRAWN = 1


def report_results(
    directories: Sequence[Path],
    output: Path | None,
    animation: bool = False,
    lab: Path | None = None,
) -> int:
    """Report one run in its directory, or several on one page; return the exit code.

    ``lab`` is a measured curve, over which the runs are drawn.
    """
    console = Console()
    for directory in directories:
        if not (directory / "history.csv").is_file():
            console.problem(f"{directory} holds no results of wovenfab (there is no history.csv)")
            return BAD_INPUT
    if animation and len(directories) > 1:
        console.problem("--animation shows one run: name one directory")
        return BAD_INPUT
    if lab is not None:
        return _measured(console, directories, output, lab)
    if len(directories) > 1:
        return _compare(console, directories, output)
    if output is not None:
        console.problem("-o names the page of several runs; that of one is in its own directory")
        return BAD_INPUT
    return _report(console, directories[0], animation)


def _report(console: Console, directory: Path, animation: bool) -> int:
    from wovenfab.report.pictures import REPORT, ReportError, draw

    try:
        drawn, problem = draw(directory, (*REPORT, *(["animation"] if animation else []))), None
    except ReportError as error:
        drawn, problem = error.drawn, str(error)
    for path in drawn:
        console.say(str(path))
    if problem is not None:
        console.problem(problem)
    return 0 if problem is None else NOT_DRAWN


def _compare(console: Console, directories: Sequence[Path], output: Path | None) -> int:
    from wovenfab.report.pages import default_place, write_comparison

    try:
        path = write_comparison(directories, output or default_place(directories))
    except (OSError, ValueError) as error:
        console.problem(str(error))
        return BAD_INPUT
    console.say(str(path))
    return 0


def _measured(console: Console, directories: Sequence[Path], output: Path | None, lab: Path) -> int:
    """Draw runs over a measured curve, and say how far they are from it."""
    from wovenfab.report.fit import LAB, draw_measured
    from wovenfab.report.pages import default_place, labels
    from wovenfab.report.run_data import open_run_data
    from wovenfab.study.fit.measured import read_measured
    from wovenfab.study.fit.response import BranchError

    measured = read_measured(lab)
    place = directories[0] / LAB if len(directories) == 1 else default_place(directories)
    path = output or place.with_name(LAB)
    try:
        runs = list(zip(labels(directories), map(open_run_data, directories), strict=True))
        misfits = draw_measured(runs, measured, path)
    except (OSError, ValueError, BranchError) as error:
        console.problem(str(error))
        return BAD_INPUT
    for name, misfit in misfits:
        console.say(f"{name}: {100 * misfit:.2f} % of the largest force from {lab.name}")
    console.say(str(path))
    return 0
