"""``wovenfab report``."""

from __future__ import annotations

from pathlib import Path

from wovenfab.commands.voice import BAD_INPUT, Voice


def report_results(directory: Path) -> int:
    """Draw the pictures of a results directory and return the exit code."""
    from wovenfab.report.pictures import draw

    voice = Voice()
    if not (directory / "history.csv").is_file():
        voice.problem(f"{directory} holds no results of wovenfab (there is no history.csv)")
        return BAD_INPUT
    for picture in draw(directory):
        voice.say(str(picture))
    return 0
