"""``wovenfab report``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from wovenfab.cli.console import BAD_INPUT, Console

#: Results are whole, but something of the report could not be drawn.
NOT_DRAWN = 1


def report_results(
    directories: Sequence[Path], output: Path | None, animation: bool = False
) -> int:
    """Report one run in its directory, or several on one page; return the exit code.

    Args:
        directories: The results directories.
        output: The page of several runs, if not in the folder that holds them.
        animation: Whether to draw one cycle in motion, too.
    """
    voice = Console()
    for directory in directories:
        if not (directory / "history.csv").is_file():
            voice.problem(f"{directory} holds no results of wovenfab (there is no history.csv)")
            return BAD_INPUT
    if animation and len(directories) > 1:
        voice.problem("--animation shows one run: name one directory")
        return BAD_INPUT
    if len(directories) > 1:
        return _compare(voice, directories, output)
    if output is not None:
        voice.problem("-o names the page of several runs; that of one is in its own directory")
        return BAD_INPUT
    return _report(voice, directories[0], animation)


def _report(voice: Console, directory: Path, animation: bool) -> int:
    from wovenfab.report.pictures import REPORT, ReportError, draw

    try:
        drawn, problem = draw(directory, (*REPORT, *(["animation"] if animation else []))), None
    except ReportError as error:
        drawn, problem = error.drawn, str(error)
    for path in drawn:
        voice.say(str(path))
    if problem is not None:
        voice.problem(problem)
    return 0 if problem is None else NOT_DRAWN


def _compare(voice: Console, directories: Sequence[Path], output: Path | None) -> int:
    from wovenfab.report.pages import default_place, write_comparison

    try:
        path = write_comparison(directories, output or default_place(directories))
    except (OSError, ValueError) as error:
        voice.problem(str(error))
        return BAD_INPUT
    voice.say(str(path))
    return 0
